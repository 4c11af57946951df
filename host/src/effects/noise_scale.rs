//! Noise scale: gain or read noise differ from the calibrated values, while frames have the expected mean.
//!
//! `read noise -> read noise (1 + read_noise)` and `gain -> gain (1 + gain)` at the same mean in DN: a higher gain
//! means fewer electrons and a larger variance. The effect shows only in variances.

use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use crate::noise::NoiseModel;

/// The effect; its formula is in the documentation of the module.
pub(super) struct NoiseScale;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "noise_scale",
    stage: Stage::Electronics,
    summary: "read noise (1 + read_noise), gain (1 + gain) at the same mean: only the noise has changed",
    params: &[Param::strength("read_noise", "1", 0.1, -0.9, 100.0), Param::strength("gain", "1", 0.03, -0.9, 100.0)],
    lookalikes: &[
        Lookalike {
            id: "brighter_fatter",
            separate_by: "covariance of flats: a wrong gain does not correlate neighbours",
        },
        Lookalike { id: "row_noise", separate_by: "covariance within rows: read noise is uncorrelated" },
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
