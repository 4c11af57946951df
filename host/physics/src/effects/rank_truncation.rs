//! Rank truncation: the PSF varies more over the field than the terms of the low-rank model can represent.
//!
//! The shape of the missing terms depends on the lens, but they all grow with the distance from the place where the
//! model is exact. The effect is therefore a blur of variance `terms (r / R)^2` px^2 along each axis, with the distance
//! r from the anchor of the lens and half the diagonal R of the sensor. It conserves light. It only indicates the
//! fault: the remedy is a calibration with more terms, not this blur.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use ndarray::{Array2, ArrayView1, Axis, s};
use std::ops::Range;

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
        let Some(mut lit) = lit(image_e) else { return };
        for _ in 0..steps as usize {
            // Light reaches one pixel farther with each step.
            lit = [(&lit[0], rows), (&lit[1], cols)].map(|(l, n)| l.start.saturating_sub(1)..(l.end + 1).min(n));
            step(image_e, half, &lit, (&on, &between));
        }
    }
}

/// Rows and columns that hold all pixels with light; None: there are none.
fn lit(image: &Array2<f32>) -> Option<[Range<usize>; 2]> {
    let along = |axis: Axis| {
        let dark = |line: ArrayView1<'_, f32>| line.iter().all(|v| *v == 0.0);
        let first = image.axis_iter(axis).position(|line| !dark(line))?;
        let last = image.axis_iter(axis).rposition(|line| !dark(line))?;
        Some(first..last + 1)
    };
    Some([along(Axis(0))?, along(Axis(1))?])
}

/// One explicit step inside some rows and columns: the flow over a border leaves one pixel and enters the other. `on`
/// and `between` are the variances along the rows and the columns at the pixels and at the borders behind them.
fn step(
    image_e: &mut Array2<f32>,
    half: f32,
    [rows, cols]: &[Range<usize>; 2],
    (on, between): (&[Vec<f32>; 2], &[Vec<f32>; 2]),
) {
    let from = image_e.slice(s![rows.clone(), cols.clone()]).to_owned();
    let last = from.ncols() - 1;
    for (r, here) in rows.clone().zip(from.outer_iter()) {
        let mut flow = &here.slice(s![..last]) - &here.slice(s![1..]);
        flow.iter_mut().zip(&between[1][cols.clone()]).for_each(|(f, v)| *f *= half * (on[0][r] + v));
        let mut row = image_e.slice_mut(s![r, cols.clone()]);
        row.slice_mut(s![1..]).scaled_add(1.0, &flow);
        row.slice_mut(s![..last]).scaled_add(-1.0, &flow);
        if r + 1 < rows.end {
            let mut flow = &here - &from.row(r + 1 - rows.start);
            flow.iter_mut().zip(&on[1][cols.clone()]).for_each(|(f, v)| *f *= half * (between[0][r] + v));
            image_e.slice_mut(s![r, cols.clone()]).scaled_add(-1.0, &flow);
            image_e.slice_mut(s![r + 1, cols.clone()]).scaled_add(1.0, &flow);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The naive loop over all pixels.
    fn naive(terms: f64, image: &mut Array2<f32>, anchor: [f64; 2]) {
        let (rows, cols) = image.dim();
        let edge2 = (rows * rows + cols * cols) as f64 / 4.0;
        let square = |at: f64, anchor: f64| ((at - anchor).powi(2) / edge2) as f32;
        let largest = (0..rows).map(|r| square(r as f64, anchor[0])).fold(0.0, f32::max)
            + (0..cols).map(|c| square(c as f64, anchor[1])).fold(0.0, f32::max);
        let steps = (terms * f64::from(largest) / STEP_PX2).ceil();
        let half = (terms / steps / 2.0) as f32;
        for _ in 0..steps as usize {
            let from = image.clone();
            for (r, c) in (0..rows).flat_map(|r| (0..cols).map(move |c| (r, c))) {
                let [y, x] = [r as f64, c as f64];
                let right = half * (square(y, anchor[0]) + square(x + 0.5, anchor[1]));
                let down = half * (square(y + 0.5, anchor[0]) + square(x, anchor[1]));
                for (other, share) in [((r, c + 1), right), ((r + 1, c), down)] {
                    if let Some(v) = from.get(other) {
                        let flow = share * (from[(r, c)] - v);
                        image[(r, c)] -= flow;
                        image[other] += flow;
                    }
                }
            }
        }
    }

    #[test]
    fn dark_parts_are_left_out_and_nothing_else_changes() {
        let anchor = [8.2, 13.7];
        let anchors_px = [anchor];
        let cx = FrameContext { anchors_px: &anchors_px, ..FrameContext::default() };
        for (row, col, size) in [(9, 11, 6), (0, 0, 20), (17, 20, 3), (5, 5, 0)] {
            let near = |r: usize, c: usize| (row..row + size).contains(&r) && (col..col + size).contains(&c);
            let light = |(r, c): (usize, usize)| if near(r, c) { 3.0 + ((7 * r + 5 * c) % 11) as f32 } else { 0.0 };
            let mut found = Array2::from_shape_fn((20, 24), light);
            let mut expected = found.clone();
            RankTruncation.on_lens(&[3.0], &mut found, &cx);
            naive(3.0, &mut expected, anchor);
            let most = found.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(most < 1e-5, "{row} {col} {size}: {most}");
            let sum = |image: &Array2<f32>| image.iter().map(|v| f64::from(*v)).sum::<f64>();
            assert!((sum(&found) - sum(&expected)).abs() < 1e-3);
        }
    }
}
