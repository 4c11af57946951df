//! Lens gain: a lens transmits more or less light than calibrated, e.g. because of dirt, a finger print or a filter
//! edge.
//!
//! `mu_l -> (1 + change_l) mu_l`.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct LensGain;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "lens_gain",
    stage: Stage::Lens,
    summary: "(1 + change_l) mu_l: each lens transmits more or less light",
    params: &[Param::strength("change", "1", 0.005, -1.0, 10.0).per_lens()],
    lookalikes: &[
        Lookalike { id: "vignetting", separate_by: "flats: the gain of a lens changes in steps from image to image" },
        Lookalike { id: "dust", separate_by: "flats: dust on the sensor is the same for every lens" },
    ],
};

impl Effect for LensGain {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_lens(&self, p: &[f64], image_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        let change = p.get(cx.lens).copied().unwrap_or(0.0);
        if change != 0.0 {
            image_e.mapv_inplace(|v| v * (1.0 + change) as f32);
        }
    }

    /// A common factor of all lenses is the unknown light level of the session, so the median lens is defined as
    /// unchanged.
    fn gauge(&self, p: &mut [f64], live: &[bool]) -> f64 {
        let mut sorted: Vec<f64> = p.iter().zip(live).filter(|(_, live)| **live).map(|(v, _)| *v).collect();
        sorted.sort_by(f64::total_cmp);
        let common = 1.0 + sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
        if common > 0.0 {
            let living = p.iter_mut().zip(live).filter(|(_, live)| **live);
            living.for_each(|(v, _)| *v = (1.0 + *v) / common - 1.0);
        }
        common.max(f64::MIN_POSITIVE)
    }
}
