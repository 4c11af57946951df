//! Defocus: the specimen is at another depth than in the calibration.
//!
//! `h(z) -> h(z + z_um)`, where h(z) is the PSF at depth z. The model covers only the depths of its bead scan.

use super::context::{FrameContext, Ray, RayShift};
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;

/// The effect; its formula is in the documentation of the module.
pub(super) struct Defocus;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "defocus",
    stage: Stage::Geometry,
    summary: "h(z + z_um): the specimen is out of focus",
    params: &[Param::strength("z_um", "um", 2.0, -1000.0, 1000.0)],
    lookalikes: &[
        Lookalike { id: "charge_diffusion", separate_by: "depth scan: diffusion is the same at every depth" },
        Lookalike {
            id: "interpixel_capacitance",
            separate_by: "flats: capacitance correlates the noise of neighbours",
        },
        Lookalike {
            id: "field_curvature",
            separate_by: "depth scan at the centre and at the edge: only a curved field focuses at different depths",
        },
        Lookalike {
            id: "motion_blur",
            separate_by: "a specimen at rest, or a shorter exposure: motion blur disappears",
        },
    ],
};

impl Effect for Defocus {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn shift_ray(&self, p: &[f64], _ray: &Ray, _cx: &FrameContext<'_>) -> RayShift {
        RayShift::by_um(p[0])
    }
}
