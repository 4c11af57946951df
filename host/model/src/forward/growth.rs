//! PSFs that grow or shrink about their foci, as effects ask for ([`ommatidia_physics::effects::RayShift::growth`]).
//!
//! A displacement of the light of a whole image by d(x) grows the PSFs along with the image, by `div d / 2` (and shears
//! them, which is neglected). An effect that displaces foci does not do that, so it is taken back here.

use crate::psf::growth::growth_kernels;
use crate::psf::nodes::Taps;
use crate::psf::pupils::Pupils;
use crate::psf::{CalibratedOptics, ChiefRays, LensImage, LowRankOperator, LowRankPsf, OperatorConfig};
use ndarray::{Array2, ArrayView2, Axis};
use ommatidia_physics::effects::RayShift;

/// Share of the peak below which a pixel says nothing of where a PSF is centred.
const FAINT: f32 = 0.05;

/// What is needed to plan [`Growth`].
#[derive(Debug)]
pub(super) struct Calibrated {
    pub psf: LowRankPsf,
    pub rays: ChiefRays,
    pub object: [usize; 2],
    pub sensor: [usize; 2],
    pub config: OperatorConfig,
    pub pupils: Pupils,
}

/// The operators of the first and the second derivative of the PSFs by their growth.
#[derive(Debug)]
pub(super) struct Growth {
    orders: [LowRankOperator; 2],
    /// Centre of each lens's PSF from the middle of its window at each object pixel, (row, col) px. Windows are placed
    /// on whole pixels, and PSFs lie where the light is.
    centres_px: Vec<Array2<[f64; 2]>>,
}

impl Growth {
    /// Plans the operators; None where the tables disagree, which the plan of the PSFs themselves has refused before.
    pub(super) fn plan(of: &Calibrated) -> Option<Self> {
        let planned = |basis| {
            let psf = LowRankPsf { basis, ..of.psf.clone() };
            let optics = CalibratedOptics { psf: &psf, rays: &of.rays, object: of.object, sensor: of.sensor };
            LowRankOperator::plan(optics, &of.rays, of.config).ok()
        };
        let [first, second] = growth_kernels(&of.psf.basis);
        let lenses = 0..of.rays.anchors_px.len();
        let centres_px = lenses.map(|l| centres_px(&of.psf, l, of.config.depth, of.object)).collect();
        Some(Self { orders: [planned(first)?, planned(second)?], centres_px })
    }

    /// The images of `emitted` under the derivative of order 1 or 2 (`order` 0 or 1).
    pub(super) fn images(&self, order: usize, emitted: ArrayView2<'_, f32>) -> Vec<Option<LensImage>> {
        let mut lenses = vec![None; self.centres_px.len()];
        // An object of another shape was refused when its scene was made.
        let _ = self.orders[order].each_lens(emitted, |l, image| lenses[l] = Some(image));
        lenses
    }

    /// Displaces what grows about the middle of its window back, so that it grows about its focus. `half`: half of the
    /// window, px. Not for what only takes a stretch back: laws displace sources by where they lie in the object, which
    /// is the middle of the window.
    pub(super) fn about_foci(&self, lens: usize, shifts: &mut Array2<RayShift>, half: usize) {
        let Some(centres) = self.centres_px.get(lens).filter(|c| !c.is_empty()) else { return };
        let (rows, cols) = centres.dim();
        for ((r, c), shift) in shifts.indexed_iter_mut().filter(|(_, s)| s.growth != 0.0) {
            let centre = centres[[r.saturating_sub(half).min(rows - 1), c.saturating_sub(half).min(cols - 1)]];
            shift.px = [0, 1].map(|a| shift.px[a] - shift.growth * centre[a]);
        }
    }
}

/// Takes the growth that displacements cause from that which effects ask for: what grows by w, and is stretched by
/// `1 / (1 - s)` where the displacement of what ends on a pixel has the slope s, has grown by `(1 + w) / (1 - s) - 1`.
pub(super) fn less_stretch(shifts: &mut Array2<RayShift>) {
    let (rows, cols) = shifts.dim();
    let slope = |axis: usize, [low, high]: [[usize; 2]; 2]| {
        let distance = (high[axis] - low[axis]).max(1) as f64;
        (shifts[high].px[axis] - shifts[low].px[axis]) / distance
    };
    let stretch = Array2::from_shape_fn((rows, cols), |(r, c)| {
        let by_row = slope(0, [[r.saturating_sub(1), c], [(r + 1).min(rows - 1), c]]);
        let by_col = slope(1, [[r, c.saturating_sub(1)], [r, (c + 1).min(cols - 1)]]);
        0.5 * (by_row + by_col)
    });
    shifts.zip_mut_with(&stretch, |shift, by| shift.growth = (1.0 + shift.growth) * (1.0 - by) - 1.0);
}

/// Centre of the PSF of a lens at each object pixel: the centroid of its brightest part at the nodes, interpolated.
fn centres_px(psf: &LowRankPsf, lens: usize, depth: usize, object: [usize; 2]) -> Array2<[f64; 2]> {
    let basis = psf.basis.index_axis(Axis(0), lens);
    let coefficients = psf.coefficients.index_axis(Axis(0), lens);
    let coefficients = coefficients.index_axis(Axis(1), depth);
    let (_, rows, cols) = coefficients.dim();
    let mut nodes = [Array2::<f32>::zeros((rows, cols)), Array2::zeros((rows, cols))];
    for (i, j) in (0..rows).flat_map(|i| (0..cols).map(move |j| (i, j))) {
        let mut here = Array2::<f32>::zeros((basis.dim().1, basis.dim().2));
        for (kernel, of_kernel) in basis.outer_iter().zip(coefficients.outer_iter()) {
            here.scaled_add(of_kernel[[i, j]], &kernel);
        }
        let at = centre(&here);
        nodes[0][[i, j]] = at[0] as f32;
        nodes[1][[i, j]] = at[1] as f32;
    }
    let taps = [Taps::for_pixels(&psf.node_rows_px, object[0]), Taps::for_pixels(&psf.node_cols_px, object[1])];
    Array2::from_shape_fn((object[0], object[1]), |(r, c)| {
        [0, 1].map(|a| {
            let (of_row, of_col, nodes) = (&taps[0][r], &taps[1][c], &nodes[a]);
            let pairs = (0..of_row.count).flat_map(|i| (0..of_col.count).map(move |j| (i, j)));
            let value = |i: usize, j: usize| f64::from(nodes[[of_row.first + i, of_col.first + j]]);
            pairs.map(|(i, j)| f64::from(of_row.weights[i] * of_col.weights[j]) * value(i, j)).sum::<f64>()
        })
    })
}

/// Centroid of the bright part of a window, from its middle, px; the middle where there is no light.
fn centre(window: &Array2<f32>) -> [f64; 2] {
    let floor = FAINT * window.iter().fold(0.0f32, |m, v| m.max(*v));
    let middle = [window.nrows(), window.ncols()].map(|n| (n as f64 - 1.0) / 2.0);
    let (mut sum, mut light) = ([0.0; 2], 0.0);
    for ((r, c), v) in window.indexed_iter().filter(|(_, v)| **v > floor) {
        let weight = f64::from(v - floor);
        sum = [sum[0] + weight * (r as f64 - middle[0]), sum[1] + weight * (c as f64 - middle[1])];
        light += weight;
    }
    if light > 0.0 { sum.map(|s| s / light) } else { [0.0; 2] }
}
