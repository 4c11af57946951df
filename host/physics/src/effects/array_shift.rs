//! Shifted array: every chief ray is displaced by the same amount.
//!
//! `anchor_l -> anchor_l + (row_px, col_px)`.

use super::context::{FrameContext, Ray, RayShift};
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use super::evidence::{Evidence, EvidenceFrame};
use super::place::far_displacement_px;
use ommatidia_session::Role;

/// The effect; its formula is in the documentation of the module.
pub(super) struct ArrayShift;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "array_shift",
    stage: Stage::Geometry,
    summary: "anchor_l + (row_px, col_px): the whole array is displaced",
    params: &[Param::strength("row_px", "px", 0.005, -50.0, 50.0), Param::strength("col_px", "px", 0.005, -50.0, 50.0)],
    lookalikes: &[
        Lookalike {
            id: "lens_decentre",
            separate_by: "bead scan: a shifted array moves the images of all lenses equally",
        },
        Lookalike {
            id: "thermal_drift",
            separate_by: "repeated frames of a bead at rest: only a drift grows with time",
        },
        Lookalike {
            id: "radial_distortion",
            separate_by: "bead scan over the field: distortion grows with the field angle",
        },
    ],
};

impl Effect for ArrayShift {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn shift_ray(&self, p: &[f64], _ray: &Ray, _cx: &FrameContext<'_>) -> RayShift {
        RayShift::by_px([p[0], p[1]])
    }

    /// No displacement, and where the frames lie beside the expected ones, if that is too far for a small change to
    /// show.
    fn guess(&self, evidence: &Evidence<'_>) -> Vec<Vec<f64>> {
        let pictured = |f: &&EvidenceFrame<'_>| matches!(f.cx.role, Role::Scene | Role::Bead);
        let far = far_displacement_px(evidence.frames.iter().filter(pictured));
        [vec![0.0, 0.0]].into_iter().chain(far.map(|d| d.to_vec())).collect()
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::effects::FrameContext;
    use crate::effects::place::testing::foci;
    use ndarray::Array2;

    fn evidence(moved: [f32; 2]) -> Evidence<'static> {
        let cx = FrameContext { role: Role::Scene, gain_dn_per_e: 1.0, ..FrameContext::default() };
        let light_e = foci([0.0; 2]);
        let residual_dn = foci(moved) - &light_e;
        Evidence { frames: vec![EvidenceFrame { cx, residual_dn, weight: Array2::ones(light_e.dim()), light_e }] }
    }

    #[test]
    fn a_large_displacement_is_a_start_and_a_small_one_is_not() {
        let starts = |moved| ArrayShift.guess(&evidence(moved));
        assert_eq!(starts([5.2, -3.1]), [[0.0, 0.0], [5.0, -3.0]]);
        assert_eq!(starts([-11.0, 7.0]), [[0.0, 0.0], [-11.0, 7.0]]);
        assert_eq!(starts([0.8, 0.5]), [[0.0, 0.0]]);
        assert_eq!(ArrayShift.guess(&Evidence::default()), [[0.0, 0.0]]);
    }
}
