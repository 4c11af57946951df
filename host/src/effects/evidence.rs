//! Residuals and the model's light, from which an effect guesses its shape parameters.

use super::FrameContext;
use ndarray::Array2;

/// Residuals of one frame.
#[derive(Debug)]
pub struct EvidenceFrame<'a> {
    /// Exposure, array and sensor of the frame.
    pub cx: FrameContext<'a>,
    /// Measured minus predicted frame, [sensor rows, sensor cols], DN; 0 for masked pixels.
    pub residual_dn: Array2<f32>,
    /// Expected light, [sensor rows, sensor cols], electrons.
    pub light_e: Array2<f32>,
    /// Inverse variance, [sensor rows, sensor cols], DN^-2; 0 for masked pixels.
    pub weight: Array2<f32>,
}

/// Residuals of the training frames.
#[derive(Debug, Default)]
pub struct Evidence<'a> {
    /// Residuals of each frame.
    pub frames: Vec<EvidenceFrame<'a>>,
}
