//! Shifted array: every chief ray is displaced by the same amount.
//!
//! `anchor_l -> anchor_l + (row_px, col_px)`.

use super::context::{FrameContext, Ray, RayShift};
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use super::evidence::{Evidence, EvidenceFrame};
use super::place::displacement_px;
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
        let far = displacement(evidence).filter(|d| d[0].hypot(d[1]) >= FAR_PX);
        [vec![0.0, 0.0]].into_iter().chain(far.map(|d| d.to_vec())).collect()
    }
}

/// Foci are a few pixels wide: frames are linear in displacements below this, pixels.
const FAR_PX: f64 = 2.0;

/// The displacement of the frames from what is expected of them; None: none is clear.
fn displacement(evidence: &Evidence<'_>) -> Option<[f64; 2]> {
    let pictured = |f: &&EvidenceFrame<'_>| matches!(f.cx.role, Role::Scene | Role::Bead);
    let pair = |f: &EvidenceFrame<'_>| {
        let expected = f.light_e.mapv(|e| e * f.cx.gain_dn_per_e as f32);
        [&expected + &f.residual_dn, expected]
    };
    displacement_px(evidence.frames.iter().filter(pictured).map(pair)).map(|d| d.map(|v| v as f64))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::effects::FrameContext;
    use ndarray::Array2;

    fn evidence(moved: [f32; 2]) -> Evidence<'static> {
        let foci = |moved: [f32; 2]| {
            Array2::from_shape_fn((60, 72), |(r, c)| {
                let light = |i: usize| {
                    let [y, x] = [(i * 23 % 44 + 8) as f32 + moved[0], (i * 31 % 56 + 8) as f32 + moved[1]];
                    (-((r as f32 - y).powi(2) + (c as f32 - x).powi(2)) / 3.0).exp()
                };
                (0..9).map(|i| 300.0 * light(i)).sum::<f32>()
            })
        };
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
