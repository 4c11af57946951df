//! Row noise: each row of each frame has a random offset, the same for all pixels of the row.
//!
//! `y -> y + n_row` with normal offsets n of standard deviation `sigma_dn`, independent in each frame. The expected
//! frame does not change; the effect shows only in the covariance within rows.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use ndarray::Array2;
use rand_distr::{Distribution, StandardNormal};

/// The effect; its formula is in the documentation of the module.
pub(super) struct RowNoise;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "row_noise",
    stage: Stage::Electronics,
    summary: "y + a normal number for each row and frame: noise common to the pixels of a row",
    params: &[Param::square("sigma_dn", "DN", 0.3, 1e4)],
    lookalikes: &[
        Lookalike { id: "flicker_banding", separate_by: "darks: row noise is there without light" },
        Lookalike { id: "row_pattern", separate_by: "repeated frames: a pattern is the same in every frame" },
        Lookalike { id: "noise_scale", separate_by: "covariance within rows: read noise is uncorrelated" },
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
