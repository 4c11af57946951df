//! Uneven excitation: the emitted light falls off from a centre on the object.
//!
//! `O(p) -> O(p) (1 - falloff rho^2)`, where rho is the distance from the centre over half the diagonal of the object:
//! the first order of a Gaussian lamp profile. Unlike vignetting, it is fixed to the object.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct ExcitationProfile;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "excitation_profile",
    stage: Stage::Object,
    summary: "O (1 - falloff rho^2): uneven excitation, fixed to the object",
    params: &[
        Param::strength("falloff", "1", 0.005, -1.0, 1.0),
        Param::shape("centre_row", "half heights", 0.0, 0.1, [-1.0, 1.0], &[0.0]),
        Param::shape("centre_col", "half widths", 0.0, 0.1, [-1.0, 1.0], &[0.0]),
    ],
    lookalikes: &[
        Lookalike {
            id: "vignetting",
            separate_by: "move the specimen: an excitation profile moves with it, vignetting does not",
        },
        Lookalike { id: "photobleaching", separate_by: "the same specimen early and late: only bleaching dims it" },
    ],
};

impl Effect for ExcitationProfile {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_object(&self, p: &[f64], object: &mut Array2<f32>, _cx: &FrameContext<'_>) {
        if p[0] == 0.0 {
            return;
        }
        let half = [object.nrows() as f64 / 2.0, object.ncols() as f64 / 2.0];
        let diagonal2 = half[0] * half[0] + half[1] * half[1];
        for ((r, c), v) in object.indexed_iter_mut() {
            let y = r as f64 + 0.5 - half[0] * (1.0 + p[1]);
            let x = c as f64 + 0.5 - half[1] * (1.0 + p[2]);
            *v *= (1.0 - p[0] * (y * y + x * x) / diagonal2).max(0.0) as f32;
        }
    }
}
