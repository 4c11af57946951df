//! What the loop shows an effect that must guess its shape from the data: residuals beside the model's light.

use super::FrameContext;
use ndarray::Array2;

/// Residuals of one frame.
#[derive(Debug)]
pub struct EvidenceFrame<'a> {
    /// The frame.
    pub cx: FrameContext<'a>,
    /// Measured minus predicted, DN; 0 where a pixel is masked, [sensor rows, sensor cols].
    pub residual_dn: Array2<f32>,
    /// Expected light, electrons, [sensor rows, sensor cols].
    pub light_e: Array2<f32>,
    /// Inverse variance, DN^-2; 0 where a pixel is masked, [sensor rows, sensor cols].
    pub weight: Array2<f32>,
}

/// Residuals of the training frames.
#[derive(Debug, Default)]
pub struct Evidence<'a> {
    /// One a frame.
    pub frames: Vec<EvidenceFrame<'a>>,
}
