//! Noise scale: gain or read noise are not the calibrated ones, while frames have the expected mean.
//!
//! `read noise -> read noise (1 + read_noise)`, `gain -> gain (1 + gain)` at the same mean in DN: fewer electrons, and so a variance
//! that is larger by as much. Only variances show it. Catalogue 37.

use super::{Descriptor, Effect, Lookalike, Param, Stage};
use crate::noise::NoiseModel;

/// See the module.
pub(super) struct NoiseScale;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "noise_scale",
    stage: Stage::Electronics,
    summary: "read noise (1 + read_noise), gain (1 + gain) at the same mean: the noise has changed",
    params: &[Param::strength("read_noise", "1", 0.1, -0.9, 100.0), Param::strength("gain", "1", 0.03, -0.9, 100.0)],
    lookalikes: &[
        Lookalike { id: "brighter_fatter", separate_by: "covariance of flats: a wrong gain has none" },
        Lookalike { id: "row_noise", separate_by: "covariance within rows: read noise has none" },
    ],
};

impl Effect for NoiseScale {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_noise(&self, p: &[f64], noise: &mut NoiseModel) {
        noise.read_noise_e *= 1.0 + p[0];
        noise.gain_dn_per_e *= 1.0 + p[1];
    }

    fn noise_only(&self) -> bool {
        true
    }
}
