//! Gamma of the camera: the values were bent on their way out, as for a screen.
//!
//! `y - black -> F ((y - black) / F)^gamma` for values above the black level, with the full scale F in DN. Values below
//! the black level, and full scale itself, stay.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct CameraGamma;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "camera_gamma",
    stage: Stage::Electronics,
    summary: "F (y / F)^gamma above the black level: the camera bends its values",
    params: &[Param::strength("gamma", "1", 0.001, 0.2, 5.0).off_at(1.0)],
    lookalikes: &[
        Lookalike { id: "nonlinearity", separate_by: "flats at many levels: a gamma bends most near the black level" },
        Lookalike { id: "saturation", separate_by: "flats at many levels: saturation acts near full scale alone" },
    ],
};

impl Effect for CameraGamma {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn bends_noise(&self) -> bool {
        true
    }

    fn on_electronics(&self, p: &[f64], frame_dn: &mut Array2<f32>, cx: &FrameContext<'_>) {
        let full = cx.full_scale_e * cx.gain_dn_per_e;
        if p[0] == 1.0 || full <= 0.0 {
            return;
        }
        frame_dn.mapv_inplace(|y| {
            let level = (f64::from(y) - cx.black_level_dn) / full;
            if level > 0.0 { (cx.black_level_dn + full * level.powf(p[0])) as f32 } else { y }
        });
    }
}
