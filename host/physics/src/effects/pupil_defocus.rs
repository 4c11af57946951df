//! Own defocus of lenses that their pupils misjudge: no cause, but what a calibration leaves open of its pupils.
//!
//! `W_0 -> W_0 + e_l Z_4` in the pupil of lens l before any wavefront is added, with Noll's Z_4 and e_l in waves rms.
//! No calibrated PSF changes by it, only what an added wavefront makes of it: an added defocus d changes a PSF by about
//! `2 (c + e) d + d^2` where c is the defocus that the pupil has. PSFs of a lens that is nearly in focus change by no
//! more than `2 c e + e^2`, which hides e in their errors (`ommatidia_model::psf::pupils`). `close` fits it beside
//! effects on the wavefront, and it is in no catalogue. Source: Noll, J. Opt. Soc. Am. 66, 207 (1976).

use super::context::FrameContext;
use super::descriptor::{Descriptor, Param, Stage};
use super::effect::Effect;

/// What its formula is, the documentation of the module says.
pub(super) struct PupilDefocus;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "pupil_defocus",
    stage: Stage::Geometry,
    summary: "W_0 + e_l Z_4: the pupil of lens l has another defocus than its PSFs seem to show",
    params: &[Param::strength("waves", "waves", 0.002, -0.2, 0.2).per_lens()],
    lookalikes: &[],
};

impl Effect for PupilDefocus {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn misjudged_defocus(&self, p: &[f64], cx: &FrameContext<'_>) -> f64 {
        p.get(cx.lens).copied().unwrap_or(0.0)
    }
}
