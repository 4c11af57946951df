//! Spectral shift: the specimen emits longer or shorter waves than the beads of the calibration.
//!
//! `h(x) -> h(x / (1 + change)) / (1 + change)^2`, where x is the distance from the focus and `1 + change` the ratio of
//! the wavelengths: patterns of diffraction grow in proportion to the wavelength (Born & Wolf, section 8.5), at the
//! same wavefront in waves. Foci stay where they are. A lens with dispersion also changes its focus and its
//! magnification, which are effects of their own.

use super::context::{FrameContext, Ray, RayShift};
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;

/// The effect; its formula is in the documentation of the module.
pub(super) struct SpectralShift;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "spectral_shift",
    stage: Stage::Geometry,
    summary: "h(x / (1 + change)) / (1 + change)^2: other waves, so that all PSFs grow or shrink about their foci",
    params: &[Param::strength("change", "1", 0.002, -0.3, 0.5)],
    lookalikes: &[
        Lookalike { id: "motion_blur", separate_by: "another emission filter: only a wavelength makes foci smaller" },
        Lookalike {
            id: "charge_diffusion",
            separate_by: "another emission filter: diffusion is nearly the same for all visible light",
        },
        Lookalike { id: "defocus", separate_by: "depth scan: out of focus on one side, the foci shrink on the other" },
        Lookalike { id: "magnification", separate_by: "bead scan: a changed gap moves foci as it makes them larger" },
        Lookalike {
            id: "rank_truncation",
            separate_by: "a model of higher rank: it removes a truncation, and no wavelength",
        },
    ],
};

impl Effect for SpectralShift {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn shift_ray(&self, p: &[f64], _ray: &Ray, _cx: &FrameContext<'_>) -> RayShift {
        RayShift { growth: p[0], ..RayShift::default() }
    }
}
