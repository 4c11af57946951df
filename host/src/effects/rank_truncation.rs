//! Rank truncation: the PSF varies more over the field than the terms of the low-rank model let it.
//!
//! What the missing terms look like depends on the lens; what they have in common is that they grow away from where the model
//! is exact. So the effect is a blur of variance `terms (r / R)^2` px^2 along each axis, r = distance from the lens's anchor,
//! R = half the diagonal of the sensor: the smooth, field-dependent width that is left over. It marks the fault; the cure is
//! to calibrate with more terms, not to keep this blur. It keeps the light. Catalogue 10.

use super::{Descriptor, Effect, FrameContext, Lookalike, Param, Stage};
use ndarray::Array2;

/// See the module.
pub(super) struct RankTruncation;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "rank_truncation",
    stage: Stage::Lens,
    summary: "blur of variance terms (r / R)^2 about each anchor: the PSF varies more than the model's rank allows",
    params: &[Param::strength("terms", "px^2", 0.02, 0.0, 10.0)],
    lookalikes: &[
        Lookalike { id: "field_curvature", separate_by: "depth scan, or a model of higher rank" },
        Lookalike { id: "motion_blur", separate_by: "a specimen at rest, or a shorter exposure" },
        Lookalike { id: "charge_diffusion", separate_by: "bead scan: diffusion is the same over the field" },
    ],
};

/// Largest variance of one explicit step, px^2: two axes at once stay stable up to twice this.
const STEP_PX2: f64 = 0.25;

impl Effect for RankTruncation {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_lens(&self, p: &[f64], image_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        let Some(anchor) = cx.anchors_px.get(cx.lens) else { return };
        let (rows, cols) = image_e.dim();
        let edge2 = ((rows * rows + cols * cols) as f64 / 4.0).max(1.0);
        // Share of the edge's variance on each border between a pixel and the next, along an axis: (on the pixels, on the borders).
        let square = |n: usize, at: f64, off: f64| -> Vec<f32> {
            (0..n).map(|i| ((i as f64 + off - at).powi(2) / edge2) as f32).collect()
        };
        let on = [square(rows, anchor[0], 0.0), square(cols, anchor[1], 0.0)];
        let between = [square(rows, anchor[0], 0.5), square(cols, anchor[1], 0.5)];
        let largest = on.iter().map(|s| f64::from(s.iter().fold(0.0f32, |m, v| m.max(*v)))).sum::<f64>();
        if p[0] == 0.0 || !largest.is_finite() {
            return;
        }
        let steps = (p[0].abs() * largest / STEP_PX2).ceil().max(1.0);
        let half = (p[0] / steps / 2.0) as f32;
        for _ in 0..steps as usize {
            let from = image_e.clone();
            for r in 0..rows {
                for c in 0..cols {
                    // What flows over a border leaves one side and enters the other.
                    if c + 1 < cols {
                        let flow = half * (on[0][r] + between[1][c]) * (from[[r, c]] - from[[r, c + 1]]);
                        image_e[[r, c]] -= flow;
                        image_e[[r, c + 1]] += flow;
                    }
                    if r + 1 < rows {
                        let flow = half * (between[0][r] + on[1][c]) * (from[[r, c]] - from[[r + 1, c]]);
                        image_e[[r, c]] -= flow;
                        image_e[[r + 1, c]] += flow;
                    }
                }
            }
        }
    }
}
