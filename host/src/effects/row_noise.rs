//! Row noise: every reading of a row has an offset of its own, the same for all its pixels.
//!
//! `y -> y + n_row`, n normal of standard deviation `sigma_dn`, new in each frame. It changes no expected frame: only the
//! covariance within rows shows it. Catalogue 32.

use super::{Descriptor, Effect, FrameContext, Lookalike, Param, Stage};
use ndarray::Array2;
use rand_distr::{Distribution, StandardNormal};

/// See the module.
pub(super) struct RowNoise;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "row_noise",
    stage: Stage::Electronics,
    summary: "y + one normal number a row and frame: noise common to a row",
    params: &[Param::square("sigma_dn", "DN", 0.3, 1e4)],
    lookalikes: &[
        Lookalike { id: "flicker_banding", separate_by: "darks: noise of the rows needs no light" },
        Lookalike { id: "row_pattern", separate_by: "repeats: a pattern is the same in every frame" },
        Lookalike { id: "noise_scale", separate_by: "covariance within rows: read noise has none" },
    ],
};

impl Effect for RowNoise {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_reading(&self, p: &[f64], frame_dn: &mut Array2<f32>, _cx: &FrameContext<'_>, mut rng: &mut dyn rand::Rng) {
        if p[0] == 0.0 {
            return;
        }
        for mut row in frame_dn.outer_iter_mut() {
            let z: f64 = StandardNormal.sample(&mut rng);
            let offset = (p[0] * z) as f32;
            row.mapv_inplace(|v| v + offset);
        }
    }

    fn noise_only(&self) -> bool {
        true
    }

    fn is_of_the_grid(&self) -> bool {
        true
    }
}
