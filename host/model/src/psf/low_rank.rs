//! The low-rank model of the PSFs as data: basis PSFs and coefficient maps.

use super::nodes::Taps;
use ndarray::{Array2, Array4, Array5, Axis, s};

/// Per-lens truncated SVD, Eq. 2: `H_l(p; x, y) = sum_k M_lk(x, y) B_lk(p)`, p relative to the chief ray.
///
/// A window's centre pixel is `corner_l + (r, c)` for object pixel (r, c), with `corner_l = round(anchor_l - centre)`:
/// one object pixel is one sensor pixel. The sub-pixel remainder and remaining distortion are part of the basis PSFs.
#[derive(Clone, Debug)]
pub struct LowRankPsf {
    /// Basis PSFs B, [lens, k, window, window], unit norm each.
    pub basis: Array4<f32>,
    /// Coefficients M at the nodes of a regular grid over the object, [lens, k, depth, node row, node col], in DN above
    /// black for a unit source (in the session's light unit) at `exposure_ms`.
    pub coefficients: Array5<f32>,
    /// Depths z of the nodes, um, ascending; a single entry where the bead was scanned in one plane.
    pub node_depths_um: Vec<f64>,
    /// Object rows (fractional pixels) of the grid nodes, ascending.
    pub node_rows_px: Vec<f64>,
    /// Object columns (fractional pixels) of the grid nodes, ascending.
    pub node_cols_px: Vec<f64>,
    /// Exposure time to which the coefficients refer, ms.
    pub exposure_ms: f64,
}

impl LowRankPsf {
    /// Index of the depth nearest to `z_um`.
    pub fn depth_nearest(&self, z_um: f64) -> usize {
        let off = |i: &usize| (self.node_depths_um[*i] - z_um).abs();
        (0..self.node_depths_um.len()).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(0)
    }

    /// The PSF of a lens for a source at object pixel `at_px` (row, col) at the depth of node `depth`, Eq. 2:
    /// [window, window], DN for a unit source.
    pub fn window(&self, lens: usize, at_px: [f64; 2], depth: usize) -> Array2<f64> {
        let (_, rank, window, _) = self.basis.dim();
        let [rows, cols] = [Taps::at(&self.node_rows_px, at_px[0]), Taps::at(&self.node_cols_px, at_px[1])];
        let mut sum = Array2::zeros((window, window));
        for k in 0..rank {
            let mut coefficient = 0.0;
            for (i, wi) in rows.weights.iter().enumerate().take(rows.count) {
                for (j, wj) in cols.weights.iter().enumerate().take(cols.count) {
                    let node = self.coefficients[[lens, k, depth, rows.first + i, cols.first + j]];
                    coefficient += f64::from(wi * wj * node);
                }
            }
            let basis = self.basis.index_axis(Axis(0), lens);
            sum.zip_mut_with(&basis.index_axis(Axis(0), k), |s, b| *s += coefficient * f64::from(*b));
        }
        sum
    }

    /// The model at depth `z_um`, interpolated between the calibrated depths; beyond them the nearest depth holds.
    pub fn at_depth(&self, z_um: f64) -> Self {
        let taps = Taps::at(&self.node_depths_um, z_um);
        let mut coefficients = self.coefficients.slice(s![.., .., ..1, .., ..]).to_owned();
        coefficients.fill(0.0);
        for (i, weight) in taps.weights.iter().enumerate().take(taps.count) {
            let depth = taps.first + i;
            coefficients.scaled_add(*weight, &self.coefficients.slice(s![.., .., depth..depth + 1, .., ..]));
        }
        Self { coefficients, node_depths_um: vec![z_um], ..self.clone() }
    }
}
