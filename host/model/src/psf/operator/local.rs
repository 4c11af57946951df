//! The low-rank terms of a lens, decomposed again inside blocks of the object.
//!
//! K terms hold the PSFs of a lens over the whole field; in one block they vary less, and few terms hold them. With the
//! basis PSFs B of the lens, their products `S = B' B`, and the coefficients M(x) of all pixels x of the block,
//!
//! ```text
//! S^1/2 (sum_x M(x) M(x)') S^1/2 = V diag(e) V',  e descending
//! B M(x) ~ sum_(j < r) (B S^-1/2 v_j) (v_j' S^1/2 M(x))
//! ```
//! is the best approximation with r terms (Eckart & Young, Psychometrika 1, 211, 1936): the squared error of the PSFs,
//! summed over pixels and block, is the sum of the eigenvalues that are left out. All of it is in f64. The local terms
//! have the form of the global ones: basis PSFs, and coefficients at the nodes.

use super::tiling::Tiling;
use crate::psf::nodes::Taps;
use ndarray::{Array, Array2, Array3, s};
use ommatidia_physics::linalg::{NotConverged, SymmetricEigen, symmetric_eigen};
use rayon::prelude::*;

/// Share of the largest eigenvalue of `B' B` below which a combination of basis PSFs counts as zero.
const NOTHING: f64 = 1e-13;

/// Terms of one lens.
#[derive(Clone, Debug)]
pub(super) struct Terms {
    /// Basis PSFs, [k, window, window].
    pub kernels: Array3<f32>,
    /// Coefficients at the nodes, [k, node row, node col], DN for a unit source.
    pub coefficients: Array3<f32>,
}

/// Interpolation weights of all rows and of all columns of the object.
#[derive(Clone, Copy)]
pub(super) struct Interpolation<'a> {
    pub rows: &'a [Taps],
    pub cols: &'a [Taps],
}

/// A tiling, with the terms of each lens in each of its blocks.
pub(super) type Decomposed = (Tiling, Vec<Vec<Terms>>);

/// The tiling that costs least, with the terms of each lens (None: dead) in each of its blocks; or None where all terms
/// in large blocks cost less.
///
/// `error` is the relative root-mean-square error of the PSFs in a block; `coarse` is the tiling for all terms.
///
/// # Errors
/// A basis PSF or a coefficient is not finite.
pub(super) fn decompose(
    lenses: &[Option<Terms>],
    at: Interpolation<'_>,
    (coarse, candidates): (Tiling, Vec<Tiling>),
    error: f64,
) -> Result<Option<Decomposed>, NotConverged> {
    let Some(first) = lenses.iter().flatten().next() else { return Ok(None) };
    let (window, nodes) = (first.kernels.dim().1, [first.coefficients.dim().1, first.coefficients.dim().2]);
    let metrics: Vec<Option<Metric>> =
        lenses.par_iter().map(|l| l.as_ref().map(Metric::of).transpose()).collect::<Result<_, _>>()?;
    let (alive, all) = lenses.iter().flatten().fold((0, 0), |(n, k), l| (n + 1, k + l.kernels.dim().0));
    let blocks = coarse.blocks().count();
    let mut least = coarse.cost(window, alive * blocks, blocks * all, all);
    let mut best = None;
    for tiling in candidates {
        let grams: Vec<[Array2<f64>; 2]> =
            tiling.blocks().map(|(r, c)| [gram(&at.rows[r], nodes[0]), gram(&at.cols[c], nodes[1])]).collect();
        let of_lens = |m: &Option<Metric>| match m {
            Some(m) => grams.par_iter().map(|[r, c]| m.leading(r, c, error)).collect(),
            None => Ok(Vec::new()),
        };
        let turns: Vec<Vec<Array2<f64>>> = metrics.par_iter().map(of_lens).collect::<Result<_, NotConverged>>()?;
        let terms = turns.iter().flatten().map(|v| v.ncols()).sum();
        let cost = tiling.cost(window, alive * grams.len(), terms, terms);
        if cost < least {
            (least, best) = (cost, Some((tiling, turns)));
        }
    }
    Ok(best.map(|(tiling, turns)| {
        let of_lens = |l: usize| match (&lenses[l], &metrics[l]) {
            (Some(terms), Some(m)) => m.turned(terms, &turns[l]),
            _ => Vec::new(),
        };
        (tiling, (0..lenses.len()).into_par_iter().map(of_lens).collect())
    }))
}

/// The terms of a lens in the metric of their PSFs.
struct Metric {
    /// `S^-1/2`, [k, k], zero where S is.
    inverse_root: Array2<f64>,
    /// `S^1/2` times the coefficients at the nodes, [k, node row * node col].
    nodes: Array2<f64>,
}

impl Metric {
    fn of(terms: &Terms) -> Result<Self, NotConverged> {
        let kernels = flat(&terms.kernels);
        let SymmetricEigen { values, vectors } = symmetric_eigen(&kernels.dot(&kernels.t()))?;
        let floor = NOTHING * values.iter().fold(0.0f64, |m, v| m.max(*v));
        let power = |p: f64| {
            let scale = values.mapv(|v| if v > floor { v.powf(p) } else { 0.0 });
            (&vectors * &scale).dot(&vectors.t())
        };
        Ok(Self { inverse_root: power(-0.5), nodes: power(0.5).dot(&flat(&terms.coefficients)) })
    }

    /// The leading eigenvectors `v_j` of a block, [k, r], as few as the relative error allows; `rows` and `cols` are
    /// the products of its interpolation weights.
    fn leading(&self, rows: &Array2<f64>, cols: &Array2<f64>, error: f64) -> Result<Array2<f64>, NotConverged> {
        let mut summed = Array2::zeros(self.nodes.dim());
        for (nodes, mut to) in self.nodes.outer_iter().zip(summed.outer_iter_mut()) {
            let nodes = nodes.into_shape_with_order((rows.nrows(), cols.nrows()));
            let sum = nodes.map(|n| rows.dot(&n).dot(cols)).unwrap_or_default();
            to.iter_mut().zip(&sum).for_each(|(to, v)| *to = *v);
        }
        let products = self.nodes.dot(&summed.t());
        let SymmetricEigen { values, vectors } = symmetric_eigen(&products)?;
        let most = error * error * values.iter().map(|v| v.max(0.0)).sum::<f64>();
        let mut left = 0.0;
        let out = values.iter().take_while(|v| {
            left += v.max(0.0);
            left <= most
        });
        let out = out.count();
        Ok(vectors.slice(s![.., out..]).to_owned())
    }

    /// The local terms of each block, whose eigenvectors are `turns`, [k, r] each.
    fn turned(&self, terms: &Terms, turns: &[Array2<f64>]) -> Vec<Terms> {
        let kernels = flat(&terms.kernels);
        let of_block = |v: &Array2<f64>| Terms {
            kernels: like(&terms.kernels, &v.t().dot(&self.inverse_root).dot(&kernels)),
            coefficients: like(&terms.coefficients, &v.t().dot(&self.nodes)),
        };
        turns.par_iter().map(of_block).collect()
    }
}

/// A stack of images as a matrix, [k, pixels].
fn flat<T: Copy + Into<f64>>(stack: &Array3<T>) -> Array2<f64> {
    let (k, rows, cols) = stack.dim();
    let values = stack.iter().map(|v| (*v).into()).collect();
    Array::from_shape_vec((k, rows * cols), values).unwrap_or_else(|_| Array2::zeros((k, rows * cols)))
}

/// A matrix [r, pixels] as a stack of images of the size of those of `stack`.
fn like(stack: &Array3<f32>, values: &Array2<f64>) -> Array3<f32> {
    let (_, rows, cols) = stack.dim();
    let narrow = values.iter().map(|v| *v as f32).collect();
    let shape = (values.nrows(), rows, cols);
    Array::from_shape_vec(shape, narrow).unwrap_or_else(|_| Array3::zeros(shape))
}

/// Products of the interpolation weights of pixels, summed over the pixels, [node, node].
fn gram(taps: &[Taps], nodes: usize) -> Array2<f64> {
    let mut sum = Array2::zeros((nodes, nodes));
    for t in taps {
        for (i, a) in t.weights[..t.count].iter().enumerate() {
            for (j, b) in t.weights[..t.count].iter().enumerate() {
                sum[[t.first + i, t.first + j]] += f64::from(*a) * f64::from(*b);
            }
        }
    }
    sum
}
