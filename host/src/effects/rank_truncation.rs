//! Rank truncation: the PSF varies more over the field than the terms of the low-rank model can represent.
//!
//! The shape of the missing terms depends on the lens, but they all grow with the distance from the place where the
//! model is exact. The effect is therefore a blur of variance `terms (r / R)^2` px^2 along each axis, with the distance
//! r from the anchor of the lens and half the diagonal R of the sensor. It conserves light. It only indicates the
//! fault: the remedy is a calibration with more terms, not this blur.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct RankTruncation;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "rank_truncation",
    stage: Stage::Lens,
    summary: "blur of variance terms (r / R)^2 about each anchor: the PSF varies more than the model can follow",
    params: &[Param::strength("terms", "px^2", 0.02, 0.0, 10.0)],
    lookalikes: &[
        Lookalike {
            id: "field_curvature",
            separate_by: "depth scan, or a model of higher rank: a higher rank removes a truncation",
        },
        Lookalike {
            id: "motion_blur",
            separate_by: "a specimen at rest, or a shorter exposure: motion blur disappears",
        },
        Lookalike { id: "charge_diffusion", separate_by: "bead scan: diffusion is the same over the field" },
    ],
};

/// Largest variance of one explicit step, px^2. Steps along two axes are stable up to twice this.
const STEP_PX2: f64 = 0.25;

impl Effect for RankTruncation {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_lens(&self, p: &[f64], image_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        let Some(anchor) = cx.anchors_px.get(cx.lens) else { return };
        let (rows, cols) = image_e.dim();
        let edge2 = ((rows * rows + cols * cols) as f64 / 4.0).max(1.0);
        // (r / R)^2 along each axis, at the pixels (`on`) and at the borders between them (`between`).
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
                    // The flow over a border leaves one pixel and enters the other.
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
