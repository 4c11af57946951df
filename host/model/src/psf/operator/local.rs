//! The coefficients of all lenses inside a block of the object, as combinations of few functions of the place.
//!
//! K terms hold the PSFs of a lens over the whole field. Their coefficients are smooth, and in one block those of all
//! lenses are nearly combinations of few functions `phi_p` that the lenses share:
//!
//! ```text
//! M_lk(x) ~ sum_(p < P) a_lkp phi_p(x)
//! ```
//! So the object is transformed P times for all lenses, and not once for each term of each lens. With the products of
//! the basis PSFs of a lens `S_l = B_l' B_l` and the power of its PSFs in the block `w_l = sum_x |S_l^1/2 M_l(x)|^2`,
//! the rows of all lenses one below the other are `N(x) = (w_l^-1/2 S_l^1/2 M_l(x))_l`, and
//!
//! ```text
//! sum_x N(x) N(x)' = V diag(e) V',  e descending;     phi_p(x) = v_p' N(x);     a_lp = w_l^1/2 S_l^-1/2 v_lp
//! ```
//! is the best approximation with P functions, all lenses weighing the same (Eckart & Young, Psychometrika 1, 211,
//! 1936): the squared error of the PSFs of lens l, as a share of its power, is `sum_(p >= P) e_p |v_lp|^2`. P is the
//! smallest number with which it is within the bound for every lens. `N(x)` is interpolated from few nodes, so the sum
//! over pixels is one over nodes: with the products G of their weights it is `X X'`, `X = N(nodes) G^1/2`, and the
//! eigenvectors are those of `X X'` or, where that is smaller, of `X' X`. All of it is in f64.

use super::image::Span;
use super::mix::Weights;
use super::terms::{Lens, Terms};
use super::tiling::Tiling;
use crate::psf::nodes::Taps;
use ndarray::{Array, Array2, Array3, ArrayView1, s};
use ommatidia_physics::linalg::{NotConverged, SymmetricEigen, symmetric_eigen};
use rayon::prelude::*;

/// Share of the largest eigenvalue of a matrix of products below which an eigenvalue counts as zero.
const NOTHING: f64 = 1e-13;

/// The functions that the lenses share in one block.
#[derive(Clone, Debug)]
pub(super) struct Functions {
    /// Their values at the nodes, [function, node row, node col].
    pub nodes: Array3<f32>,
    /// The coefficients of each living lens, DN for a unit source.
    pub weights: Vec<Weights>,
}

impl Functions {
    /// The number of functions.
    pub fn count(&self) -> usize {
        self.nodes.dim().0
    }
}

/// Interpolation weights of all rows and of all columns of the object.
#[derive(Clone, Copy)]
pub(super) struct Interpolation<'a> {
    pub rows: &'a [Taps],
    pub cols: &'a [Taps],
}

/// The tiling that costs least with the functions of its blocks; None where terms of each lens in large blocks cost
/// less.
///
/// `lenses` are the living ones. `error` is the relative root-mean-square error of the PSFs of a lens in a block;
/// `coarse` is the tiling for terms of each lens.
///
/// # Errors
/// A basis PSF or a coefficient is not finite.
pub(super) fn decompose(
    lenses: &[Lens],
    at: Interpolation<'_>,
    (coarse, candidates): (Tiling, Vec<Tiling>),
    error: f64,
) -> Result<Option<(Tiling, Vec<Functions>)>, NotConverged> {
    let Some(first) = lenses.first() else { return Ok(None) };
    let (terms, window) = (first.terms.count(), first.terms.kernels.dim().1);
    let metrics: Vec<Metric> = lenses.par_iter().map(|l| Metric::of(&l.terms)).collect::<Result<_, _>>()?;
    let mut least = coarse.cost_of_terms(window, lenses.len(), terms);
    let mut best = None;
    for tiling in candidates {
        let blocks: Vec<_> = tiling.blocks().map(|(r, c)| (&at.rows[r], &at.cols[c])).collect();
        let of_block = |(r, c): (&[Taps], &[Taps])| leading(&metrics, [Axis::of(r)?, Axis::of(c)?], error);
        let leading: Vec<Leading> = blocks.into_par_iter().map(of_block).collect::<Result<_, _>>()?;
        let functions: Vec<usize> = leading.iter().map(|l| l.vectors.ncols()).collect();
        let cost = tiling.cost_of_functions(window, &functions, [lenses.len(), terms]);
        if cost < least {
            (least, best) = (cost, Some((tiling, leading)));
        }
    }
    Ok(best.map(|(tiling, leading)| {
        (tiling, leading.par_iter().map(|l| l.functions(&metrics)).collect::<Vec<Functions>>())
    }))
}

/// The coefficients of a lens in the metric of its PSFs.
struct Metric {
    /// `S^-1/2`, [k, k], zero where S is.
    inverse_root: Array2<f64>,
    /// `S^1/2` times the coefficients at the nodes, [k, node row, node col].
    nodes: Array3<f64>,
}

impl Metric {
    fn of(terms: &Terms) -> Result<Self, NotConverged> {
        let kernels = flat(&terms.kernels);
        let products = kernels.dot(&kernels.t());
        let nodes = power(&products, 0.5)?.dot(&flat(&terms.coefficients));
        let nodes = nodes.into_shape_with_order(terms.coefficients.dim()).unwrap_or_default();
        Ok(Self { inverse_root: power(&products, -0.5)?, nodes })
    }
}

/// The nodes that the pixels of a block use along one axis.
struct Axis {
    nodes: Span,
    /// Square root of the products of their weights, summed over the pixels, [node, node].
    root: Array2<f64>,
}

impl Axis {
    fn of(taps: &[Taps]) -> Result<Self, NotConverged> {
        let first = taps.iter().map(|t| t.first).min().unwrap_or(0);
        let nodes = first..taps.iter().map(|t| t.first + t.count).max().unwrap_or(0);
        let mut products = Array2::zeros((nodes.len(), nodes.len()));
        for t in taps {
            for (i, a) in t.weights[..t.count].iter().enumerate() {
                for (j, b) in t.weights[..t.count].iter().enumerate() {
                    products[[t.first - first + i, t.first - first + j]] += f64::from(*a) * f64::from(*b);
                }
            }
        }
        Ok(Self { nodes, root: power(&products, 0.5)? })
    }
}

/// The leading eigenvectors of a block.
struct Leading {
    /// [lens * k, function].
    vectors: Array2<f64>,
    /// Square root of the power of each lens.
    roots: Vec<f64>,
}

/// The leading eigenvectors `v_p` of a block, as few as the relative error allows.
fn leading(metrics: &[Metric], [rows, cols]: [Axis; 2], error: f64) -> Result<Leading, NotConverged> {
    let terms = metrics.first().map_or(0, |m| m.nodes.dim().0);
    let mut x = Array2::zeros((metrics.len() * terms, rows.nodes.len() * cols.nodes.len()));
    let mut roots = Vec::new();
    for (m, mut of_lens) in metrics.iter().zip(x.axis_chunks_iter_mut(ndarray::Axis(0), terms.max(1))) {
        let inside = m.nodes.slice(s![.., rows.nodes.clone(), cols.nodes.clone()]);
        for (nodes, mut to) in inside.outer_iter().zip(of_lens.outer_iter_mut()) {
            to.iter_mut().zip(&rows.root.dot(&nodes).dot(&cols.root)).for_each(|(to, v)| *to = *v);
        }
        let root = of_lens.iter().map(|v| v * v).sum::<f64>().sqrt();
        if root > 0.0 {
            of_lens /= root;
        }
        roots.push(root);
    }
    let by_row = x.nrows() <= x.ncols();
    let SymmetricEigen { values, vectors } = symmetric_eigen(&if by_row { x.dot(&x.t()) } else { x.t().dot(&x) })?;
    let vectors =
        if by_row { vectors } else { x.dot(&vectors) * &values.mapv(|v| if v > 0.0 { v.sqrt().recip() } else { 0.0 }) };
    // The eigenvalues ascend: leave out as many as every lens allows.
    let mut left = vec![0.0; metrics.len()];
    let within = |(value, vector): &(&f64, ArrayView1<'_, f64>)| {
        left.iter_mut().enumerate().all(|(l, left)| {
            let share = vector.slice(s![l * terms..(l + 1) * terms]);
            *left += value.max(0.0) * share.dot(&share);
            *left <= error * error
        })
    };
    let out = values.iter().zip(vectors.columns()).take_while(within).count();
    Ok(Leading { vectors: vectors.slice(s![.., out..;-1]).to_owned(), roots })
}

impl Leading {
    fn functions(&self, metrics: &[Metric]) -> Functions {
        let (terms, rows, cols) = metrics.first().map_or((0, 0, 0), |m| m.nodes.dim());
        let count = self.vectors.ncols();
        let mut nodes = Array2::zeros((count, rows * cols));
        let mut weights = Vec::new();
        for (l, (m, root)) in metrics.iter().zip(&self.roots).enumerate() {
            let of_lens = self.vectors.slice(s![l * terms..(l + 1) * terms, ..]);
            if let Ok(coefficients) = m.nodes.to_shape((terms, rows * cols))
                && *root > 0.0
            {
                nodes += &(of_lens.t().dot(&coefficients) / *root);
            }
            weights.push(Weights::new(&(m.inverse_root.dot(&of_lens) * *root)));
        }
        let nodes = nodes.mapv(|v| v as f32).into_shape_with_order((count, rows, cols)).unwrap_or_default();
        Functions { nodes, weights }
    }
}

/// A power of a matrix that has no negative eigenvalues; zero where it is.
fn power(of: &Array2<f64>, exponent: f64) -> Result<Array2<f64>, NotConverged> {
    let SymmetricEigen { values, vectors } = symmetric_eigen(of)?;
    let floor = NOTHING * values.iter().fold(0.0f64, |m, v| m.max(*v));
    let scale = values.mapv(|v| if v > floor { v.powf(exponent) } else { 0.0 });
    Ok((&vectors * &scale).dot(&vectors.t()))
}

/// A stack of images as a matrix, [k, pixels].
fn flat(stack: &Array3<f32>) -> Array2<f64> {
    let (k, rows, cols) = stack.dim();
    let values = stack.iter().map(|v| f64::from(*v)).collect();
    Array::from_shape_vec((k, rows * cols), values).unwrap_or_else(|_| Array2::zeros((k, rows * cols)))
}
