//! Lens leakage: without baffles, light of the image of one lens appears again behind each neighbouring lens.
//!
//! `mu_l(x) -> mu_l(x) + kappa sum_n mu_l(x - (anchor_n - anchor_l))` over the up to four neighbours n of lens l.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use ndarray::{Array2, s};

/// The effect; its formula is in the documentation of the module.
pub(super) struct LensLeakage;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "lens_leakage",
    stage: Stage::Lens,
    summary: "mu_l + kappa mu_l displaced to each neighbour's anchor: light leaks between lenses",
    params: &[Param::strength("kappa", "1", 0.0005, 0.0, 1.0)],
    lookalikes: &[
        Lookalike {
            id: "ghost",
            separate_by: "move the bead: a leak moves with it, a ghost in the opposite direction",
        },
        Lookalike { id: "halo", separate_by: "a bead at the edge: a leak is as sharp as a focus" },
    ],
};

impl Effect for LensLeakage {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_lens(&self, p: &[f64], image_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        let Some(own) = cx.anchors_px.get(cx.lens) else { return };
        if p[0] == 0.0 {
            return;
        }
        let source = image_e.clone();
        for anchor in neighbours(cx.lens, cx.array).into_iter().filter_map(|n| cx.anchors_px.get(n)) {
            add_displaced(image_e, &source, [anchor[0] - own[0], anchor[1] - own[1]], p[0]);
        }
    }
}

/// The lenses above, below, left and right of a lens.
fn neighbours(lens: usize, [rows, cols]: [usize; 2]) -> Vec<usize> {
    if cols == 0 {
        return Vec::new();
    }
    let (i, j) = (lens / cols, lens % cols);
    let mut all = Vec::new();
    if i > 0 {
        all.push(lens - cols);
    }
    if i + 1 < rows {
        all.push(lens + cols);
    }
    if j > 0 {
        all.push(lens - 1);
    }
    if j + 1 < cols {
        all.push(lens + 1);
    }
    all
}

/// `to(x) += share from(x - by)`, by linear interpolation; the image is dark outside.
fn add_displaced(to: &mut Array2<f32>, from: &Array2<f32>, by: [f64; 2], share: f64) {
    if !by.iter().all(|v| v.is_finite()) {
        return;
    }
    let (rows, cols) = from.dim();
    let whole = by.map(f64::floor);
    for (corner, weight) in [[0, 0], [0, 1], [1, 0], [1, 1]].map(|corner: [usize; 2]| {
        let along = |a: usize| {
            let part = by[a] - whole[a];
            if corner[a] == 1 { part } else { 1.0 - part }
        };
        (corner, along(0) * along(1))
    }) {
        let at = [0, 1].map(|a| whole[a] as i64 + corner[a] as i64);
        // Ranges of target and source that overlap along an axis of n pixels.
        let overlap = |d: i64, n: usize| {
            let (start, end) = (d.max(0), (n as i64 + d).min(n as i64));
            (start < end).then(|| (start as usize..end as usize, (start - d) as usize..(end - d) as usize))
        };
        if let (Some((to_r, from_r)), Some((to_c, from_c))) = (overlap(at[0], rows), overlap(at[1], cols)) {
            to.slice_mut(s![to_r, to_c]).scaled_add((share * weight) as f32, &from.slice(s![from_r, from_c]));
        }
    }
}
