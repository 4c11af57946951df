//! Jump of the array: from one moment on, the whole image is displaced.
//!
//! `x -> x + (row_px, col_px)` in frames that begin at `since_s` or later. The head of the microscope was knocked, its
//! mount slipped, or frames of another day stand in the same session.

use super::context::{FrameContext, Ray, RayShift};
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use super::evidence::{Evidence, EvidenceFrame};
use super::place::far_displacement_px;
use ommatidia_session::Role;
use std::ops::{AddAssign, SubAssign};

/// The effect; its formula is in the documentation of the module.
pub(super) struct ArrayJump;

/// Name of the parameter of an effect that holds the moment from which on it acts, s. The search chooses it.
pub const MOMENT: &str = "since_s";

/// A moment after all frames.
const NEVER_S: f64 = 1e12;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "array_jump",
    stage: Stage::Geometry,
    summary: "x + (row_px, col_px) from since_s on: something was knocked while frames were taken",
    params: &[
        Param::strength("row_px", "px", 0.005, -50.0, 50.0),
        Param::strength("col_px", "px", 0.005, -50.0, 50.0),
        Param::choice(MOMENT, "s", 0.0, [-NEVER_S, NEVER_S]),
    ],
    lookalikes: &[
        Lookalike {
            id: "thermal_drift",
            separate_by: "more frames around the moment: a drift moves in all of them, a jump between two",
        },
        Lookalike { id: "array_shift", separate_by: "frames before and after the moment: only a jump differs" },
    ],
};

/// Frames on each side of a jump at least: one that stands alone is a frame that went wrong.
const EACH_SIDE: usize = 2;

impl Effect for ArrayJump {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn shift_ray(&self, p: &[f64], _ray: &Ray, cx: &FrameContext<'_>) -> RayShift {
        if cx.time_s < p[2] {
            return RayShift::default();
        }
        RayShift::by_px([p[0], p[1]])
    }

    /// The moment between two frames at which a displacement of the scenes by another amount before than after explains
    /// most of the residuals.
    fn guess(&self, evidence: &Evidence<'_>) -> Vec<Vec<f64>> {
        let mut scenes: Vec<_> = evidence.frames.iter().filter(|f| f.cx.role == Role::Scene).collect();
        scenes.sort_by(|a, b| a.cx.time_s.total_cmp(&b.cx.time_s));
        let Some(first) = moment(&scenes) else { return vec![vec![0.0, 0.0, NEVER_S]] };
        let since_s = (scenes[first - 1].cx.time_s + scenes[first].cx.time_s) / 2.0;
        let far = far_displacement_px(scenes[first..].iter().copied());
        [[0.0; 2]].into_iter().chain(far).map(|[row, col]| vec![row, col, since_s]).collect()
    }

    fn chances(&self, _sensor: [usize; 2], frames: usize) -> f64 {
        frames.saturating_sub(2 * EACH_SIDE - 1).max(1) as f64
    }
}

/// The index of the first of some frames, in order of time, after the moment of a jump. None: they are too few, or
/// taken at the same time.
fn moment(frames: &[&EvidenceFrame<'_>]) -> Option<usize> {
    let of: Vec<Displaced> = frames.iter().map(|f| Displaced::of(f)).collect();
    let (mut before, mut after) = (Displaced::default(), Displaced::default());
    of.iter().for_each(|d| after += *d);
    let mut best: Option<(f64, usize)> = None;
    for (k, d) in of.iter().enumerate() {
        let is_inside = k >= EACH_SIDE && k + EACH_SIDE <= of.len();
        if is_inside && frames[k].cx.time_s > frames[k - 1].cx.time_s {
            let gain = before.gain() + after.gain();
            if best.is_none_or(|(most, _)| gain > most) {
                best = Some((gain, k));
            }
        }
        before += *d;
        after -= *d;
    }
    best.map(|(_, k)| k)
}

/// Normal equations of a displacement of frames by (row, col).
#[derive(Clone, Copy, Default)]
struct Displaced {
    /// (row, row), (row, col), (col, col), DN^2 per px^2 in units of the noise.
    normal: [f64; 3],
    right: [f64; 2],
}

impl Displaced {
    fn of(f: &EvidenceFrame<'_>) -> Self {
        let (rows, cols) = f.light_e.dim();
        let mut it = Self::default();
        let gain = f.cx.gain_dn_per_e as f32;
        for r in 1..rows.saturating_sub(1) {
            for c in 1..cols.saturating_sub(1) {
                let light = |r: usize, c: usize| f.light_e[[r, c]];
                // What a displacement by one pixel adds, to first order.
                let slope = [light(r - 1, c) - light(r + 1, c), light(r, c - 1) - light(r, c + 1)]
                    .map(|d| f64::from(0.5 * gain * d));
                let (w, y) = (f64::from(f.weight[[r, c]]), f64::from(f.residual_dn[[r, c]]));
                it.normal[0] += w * slope[0] * slope[0];
                it.normal[1] += w * slope[0] * slope[1];
                it.normal[2] += w * slope[1] * slope[1];
                it.right[0] += w * slope[0] * y;
                it.right[1] += w * slope[1] * y;
            }
        }
        it
    }

    /// Fall of chi-squared by the best displacement.
    fn gain(&self) -> f64 {
        let ([rr, rc, cc], [r, c]) = (self.normal, self.right);
        let determinant = rr * cc - rc * rc;
        if determinant <= 1e-9 * rr * cc {
            return 0.0;
        }
        (cc * r * r - 2.0 * rc * r * c + rr * c * c) / determinant
    }
}

impl AddAssign for Displaced {
    fn add_assign(&mut self, other: Self) {
        self.normal.iter_mut().zip(other.normal).for_each(|(a, b)| *a += b);
        self.right.iter_mut().zip(other.right).for_each(|(a, b)| *a += b);
    }
}

impl SubAssign for Displaced {
    fn sub_assign(&mut self, other: Self) {
        self.normal.iter_mut().zip(other.normal).for_each(|(a, b)| *a -= b);
        self.right.iter_mut().zip(other.right).for_each(|(a, b)| *a -= b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::place::testing::foci;
    use ndarray::Array2;

    /// Frames of foci, one a second, of which those from `first` on lie beside the expected ones.
    fn evidence(frames: usize, first: usize, moved: [f32; 2]) -> Evidence<'static> {
        let frame = |k: usize| {
            let light_e = foci([0.0; 2]);
            let residual_dn = foci(if k >= first { moved } else { [0.0; 2] }) - &light_e;
            let cx = FrameContext { frame: k, time_s: k as f64, ..FrameContext::default() };
            EvidenceFrame { cx, residual_dn, weight: Array2::ones(light_e.dim()), light_e }
        };
        Evidence { frames: (0..frames).map(frame).collect() }
    }

    #[test]
    fn the_moment_of_a_jump_is_found_and_a_far_one_is_a_start() {
        assert_eq!(ArrayJump.guess(&evidence(12, 7, [0.3, -0.2])), [[0.0, 0.0, 6.5]]);
        assert_eq!(ArrayJump.guess(&evidence(9, 2, [4.0, -3.0])), [[0.0, 0.0, 1.5], [4.0, -3.0, 1.5]]);
        // The first or the last frame alone is no jump, and few frames show none.
        assert!(ArrayJump.guess(&evidence(9, 8, [0.4, 0.0]))[0][2] < 7.0);
        assert_eq!(ArrayJump.guess(&evidence(3, 2, [0.4, 0.0])), [[0.0, 0.0, NEVER_S]]);
        assert_eq!(ArrayJump.guess(&Evidence::default()), [[0.0, 0.0, NEVER_S]]);
    }

    #[test]
    fn frames_before_the_moment_stay_where_they_are() {
        let at = |time_s: f64| {
            ArrayJump.shift_ray(&[0.5, -0.25, 3.0], &Ray::default(), &FrameContext { time_s, ..Default::default() }).px
        };
        assert_eq!((at(2.9), at(3.0), at(9.0)), ([0.0; 2], [0.5, -0.25], [0.5, -0.25]));
    }

    #[test]
    fn frames_of_the_same_time_show_no_jump() {
        let mut same = evidence(8, 4, [0.3, 0.0]);
        same.frames.iter_mut().for_each(|f| f.cx.time_s = 0.0);
        assert_eq!(ArrayJump.guess(&same)[0][2], NEVER_S);
    }
}
