//! Veiling glare: stray light over the whole sensor, in proportion to the total light.
//!
//! `mu -> mu + beta mean(mu)`: beta is the stray fraction of the total light, spread evenly over the sensor.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct VeilingGlare;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "veiling_glare",
    stage: Stage::Light,
    summary: "mu + beta mean(mu): stray light, even over the sensor",
    params: &[Param::strength("beta", "1", 0.0005, 0.0, 10.0)],
    lookalikes: &[
        Lookalike {
            id: "background",
            separate_by: "two light levels of the specimen: glare follows its light, background the lamp power",
        },
        Lookalike { id: "halo", separate_by: "a single bright bead: glare is even over the sensor" },
    ],
};

impl Effect for VeilingGlare {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_light(&self, p: &[f64], light_e: &mut Array2<f32>, _cx: &FrameContext<'_>) {
        if p[0] == 0.0 || light_e.is_empty() {
            return;
        }
        let mean = light_e.iter().map(|v| f64::from(*v)).sum::<f64>() / light_e.len() as f64;
        light_e.mapv_inplace(|v| v + (p[0] * mean) as f32);
    }
}
