//! Lens leakage: without baffles, light of the image of one lens appears again behind each neighbouring lens.
//!
//! `mu_l(x) -> mu_l(x) + kappa sum_n mu_l(x - (anchor_n - anchor_l))` over the neighbours n of lens l: the lenses at
//! the least distance in the array, up to four on a square grid and six on a hexagonal one.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use crate::interpolation::shifted;
use ndarray::Array2;

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
        for anchor in neighbours(cx.lens, cx.anchors_px) {
            image_e.scaled_add(p[0] as f32, &shifted(&source, [anchor[0] - own[0], anchor[1] - own[1]]));
        }
    }
}

/// Distances up to so many times the least one are those of neighbours: on a square grid the next are 1.41 times it.
const NEAREST: f64 = 1.2;

/// The anchors of the lenses that lie nearest to a lens, by the distance to the nearest lens that is usual in the
/// array.
fn neighbours(lens: usize, anchors_px: &[[f64; 2]]) -> impl Iterator<Item = &[f64; 2]> {
    let distance = |a: usize, b: usize| {
        let [a, b] = [anchors_px[a], anchors_px[b]];
        (a[0] - b[0]).hypot(a[1] - b[1])
    };
    let others = move |lens: usize| (0..anchors_px.len()).filter(move |n| *n != lens);
    let nearest = |a: usize| others(a).map(|b| distance(a, b)).fold(f64::INFINITY, f64::min);
    let mut usual: Vec<f64> = (0..anchors_px.len()).map(nearest).collect();
    usual.sort_by(f64::total_cmp);
    let reach = NEAREST * usual[usual.len() / 2];
    others(lens).filter(move |n| distance(*n, lens) <= reach).map(|n| &anchors_px[n])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// How many neighbours each lens has.
    fn counts(anchors_px: &[[f64; 2]]) -> Vec<usize> {
        (0..anchors_px.len()).map(|lens| neighbours(lens, anchors_px).count()).collect()
    }

    #[test]
    fn lenses_on_a_square_grid_have_up_to_four_neighbours_and_on_a_hexagonal_one_up_to_six() {
        // Placed by some tenths of a pixel beside the grid.
        let beside = |n: usize| 0.4 * ((7 * n) as f64).sin();
        let square: Vec<[f64; 2]> =
            (0..9).map(|n| [50.0 * (n / 3) as f64 + beside(n), 50.0 * (n % 3) as f64 + beside(n + 9)]).collect();
        assert_eq!(counts(&square), [2, 3, 2, 3, 4, 3, 2, 3, 2]);
        let around = (0..6).map(|n| [(n as f64 * 60.0).to_radians(), n as f64]);
        let mut hexagon: Vec<[f64; 2]> =
            around.map(|[a, n]| [30.0 * a.sin() + beside(n as usize), 30.0 * a.cos()]).collect();
        hexagon.push([0.0, 0.0]);
        assert_eq!(counts(&hexagon), [3, 3, 3, 3, 3, 3, 6]);
        assert_eq!((counts(&[[0.0, 0.0]]), counts(&[])), (vec![0], vec![]));
    }
}
