//! Backlash of the stage: the recorded positions of a bead scan lag behind the direction of travel.
//!
//! `s -> s + b sgn(travel)` along each axis, so a focus is displaced by `b px_per_um sgn(travel)`, equally in every
//! lens. The sign is counted from its mean over the scan: where the stage has its origin is a convention, and a scan
//! that always comes from the same side shows no backlash but in its first column. Source: the lost motion of a screw
//! and its nut (Slocum, Precision Machine Design, section 10.8).

use super::context::{FrameContext, Ray, RayShift};
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;

/// The effect; its formula is in the documentation of the module.
pub(super) struct StageBacklash;

/// Stages for microscopes have backlashes of some micrometres; more than 50 um is a stage that is broken.
const fn lost_motion(name: &'static str) -> Param {
    Param::strength(name, "um", 0.02, -50.0, 50.0)
}

static DESCRIPTOR: Descriptor = Descriptor {
    id: "stage_backlash",
    stage: Stage::Geometry,
    summary: "s + b sgn(travel), less its mean: the stage lags behind the direction in which a bead scan moves it",
    params: &[lost_motion("row_um"), lost_motion("col_um")],
    lookalikes: &[
        Lookalike {
            id: "thermal_drift",
            separate_by: "the same positions again in the opposite order: only a backlash changes sides",
        },
        Lookalike { id: "stage_scale", separate_by: "a bead scan that turns at the end of each row" },
        Lookalike { id: "array_shift", separate_by: "a bead scan that turns at the end of each row" },
    ],
};

impl Effect for StageBacklash {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn shift_ray(&self, p: &[f64], ray: &Ray, cx: &FrameContext<'_>) -> RayShift {
        let um = [p[0] * cx.travel[0], p[1] * cx.travel[1]];
        if um == [0.0, 0.0] {
            return RayShift::default();
        }
        RayShift::by_px(um.map(|um| um * ray.px_per_um))
    }

    fn is_of_bead_scans(&self) -> bool {
        true
    }
}
