//! Sums over terms and functions at each frequency: what a column of spectra costs most of its time for.
//!
//! ```text
//! image(w)       = sum_k B_k(w) sum_p a_kp F_p(w)                 Weights::image
//! collected_p(w) = sum_k a_kp conj(B_k(w)) Y(w)                   Weights::collect
//! ```
//! `w` runs over the values of one column. All of them come in panels of [`PANEL`] values, so that a panel of all terms
//! and one of all functions stay in the cache nearest to the processor. Vectors run over the frequencies, never over a
//! sum; the instruction set is chosen when the program runs.

use ndarray::Array2;
use pulp::{Arch, Simd, WithSimd};
use rustfft::num_complex::Complex32;

/// Values of a panel: first their real parts, then their imaginary parts.
pub(super) const PANEL: usize = 16;
/// Sums that are kept in registers at the same time.
const TOGETHER: usize = 4;

/// Length of the panels of `n` columns of `rows` values, f32: [panel, n, 2, PANEL].
pub(super) fn panels_len(rows: usize, n: usize) -> usize {
    rows.div_ceil(PANEL) * n * 2 * PANEL
}

/// Columns of `n` spectra in panels, [panel, n, 2, PANEL]: column `i` is the one that `columns` gives as the i-th. What
/// lies beyond a column, or beyond the columns, is zero.
pub(super) fn pack<'a>(columns: impl Iterator<Item = &'a [Complex32]>, n: usize, out: &mut [f32]) {
    out.fill(0.0);
    for (i, column) in columns.enumerate() {
        for (values, panel) in column.chunks(PANEL).zip(out.chunks_exact_mut(n * 2 * PANEL)) {
            let (re, im) = panel[i * 2 * PANEL..][..2 * PANEL].split_at_mut(PANEL);
            for ((v, re), im) in values.iter().zip(re).zip(im) {
                (*re, *im) = (v.re, v.im);
            }
        }
    }
}

/// The values of column `i` of `n` in panels.
pub(super) fn unpack(panels: &[f32], (i, n): (usize, usize), out: &mut [Complex32]) {
    for (values, panel) in out.chunks_mut(PANEL).zip(panels.chunks_exact(n * 2 * PANEL)) {
        let (re, im) = panel[i * 2 * PANEL..][..2 * PANEL].split_at(PANEL);
        values.iter_mut().zip(re).zip(im).for_each(|((v, re), im)| *v = Complex32::new(*re, *im));
    }
}

/// `n` and what fills it up to whole groups of sums.
pub(super) fn padded(n: usize) -> usize {
    n.next_multiple_of(TOGETHER)
}

/// The coefficients `a_kp` of one lens in one block.
#[derive(Clone, Debug)]
pub(super) struct Weights {
    terms: usize,
    functions: usize,
    /// [group of terms, function, term of the group].
    by_term: Vec<f32>,
    /// [group of functions, term, function of the group].
    by_function: Vec<f32>,
}

impl Weights {
    /// From `a_kp`, [terms, functions].
    pub fn new(a: &Array2<f64>) -> Self {
        let (terms, functions) = a.dim();
        let value = |k: usize, p: usize| a.get([k, p]).map_or(0.0, |v| *v as f32);
        let groups = |n: usize| (0..padded(n)).step_by(TOGETHER);
        let by_term = groups(terms)
            .flat_map(|k| (0..functions).flat_map(move |p| (0..TOGETHER).map(move |j| (k + j, p))))
            .map(|(k, p)| value(k, p));
        let by_function = groups(functions)
            .flat_map(|p| (0..terms).flat_map(move |k| (0..TOGETHER).map(move |j| (k, p + j))))
            .map(|(k, p)| value(k, p));
        Self { terms, functions, by_term: by_term.collect(), by_function: by_function.collect() }
    }

    /// The image: `functions` are panels [panel, functions, 2, PANEL], `basis` panels [panel, padded terms, 2, PANEL];
    /// `out` has as many values as a column.
    pub fn image(&self, functions: &[f32], basis: &[f32], out: &mut [Complex32]) {
        Arch::new().dispatch(Image { weights: self, functions, basis, out });
    }

    /// Adds what the functions collect, panels [panel, padded functions, 2, PANEL], of the frame `frame`, panels
    /// [panel, 1, 2, PANEL].
    pub fn collect(&self, frame: &[f32], basis: &[f32], out: &mut [f32]) {
        Arch::new().dispatch(Collect { weights: self, frame, basis, out });
    }
}

struct Image<'a> {
    weights: &'a Weights,
    functions: &'a [f32],
    basis: &'a [f32],
    out: &'a mut [Complex32],
}

impl WithSimd for Image<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { weights, functions, basis, out } = self;
        let vectors = PANEL / S::F32_LANES;
        let step = 2 * vectors;
        let zero = simd.splat_f32s(0.0);
        let panels = functions.chunks_exact(weights.functions * 2 * PANEL);
        let panels = panels.zip(basis.chunks_exact(padded(weights.terms) * 2 * PANEL));
        for ((f, b), out) in panels.zip(out.chunks_mut(PANEL)) {
            let (f, b) = (S::as_simd_f32s(f).0, S::as_simd_f32s(b).0);
            let mut sums = [0.0f32; 2 * PANEL];
            let (re, im) = sums.split_at_mut(PANEL);
            for (v, (re, im)) in S::as_mut_simd_f32s(re).0.iter_mut().zip(S::as_mut_simd_f32s(im).0).enumerate() {
                let groups = weights.by_term.chunks_exact(weights.functions * TOGETHER);
                for (a, b) in groups.zip(b.chunks_exact(TOGETHER * step)) {
                    let mut sums = [[zero; 2]; TOGETHER];
                    for (a, f) in a.chunks_exact(TOGETHER).zip(f.chunks_exact(step)) {
                        let parts = [f[v], f[vectors + v]];
                        for (sum, a) in sums.iter_mut().zip(a) {
                            let a = simd.splat_f32s(*a);
                            *sum = [0, 1].map(|i| simd.mul_add_f32s(a, parts[i], sum[i]));
                        }
                    }
                    for ([x, y], b) in sums.iter().zip(b.chunks_exact(step)) {
                        let (br, bi) = (b[v], b[vectors + v]);
                        *re = simd.mul_add_f32s(br, *x, simd.mul_add_f32s(simd.neg_f32s(bi), *y, *re));
                        *im = simd.mul_add_f32s(br, *y, simd.mul_add_f32s(bi, *x, *im));
                    }
                }
            }
            out.iter_mut().zip(re).zip(im).for_each(|((out, re), im)| *out = Complex32::new(*re, *im));
        }
    }
}

struct Collect<'a> {
    weights: &'a Weights,
    frame: &'a [f32],
    basis: &'a [f32],
    out: &'a mut [f32],
}

impl WithSimd for Collect<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { weights, frame, basis, out } = self;
        let vectors = PANEL / S::F32_LANES;
        let step = 2 * vectors;
        let mut products = vec![[simd.splat_f32s(0.0); 2]; weights.terms];
        let panels = frame.chunks_exact(2 * PANEL).zip(basis.chunks_exact(padded(weights.terms) * 2 * PANEL));
        for ((y, b), out) in panels.zip(out.chunks_exact_mut(padded(weights.functions) * 2 * PANEL)) {
            let (y, b, out) = (S::as_simd_f32s(y).0, S::as_simd_f32s(b).0, S::as_mut_simd_f32s(out).0);
            for v in 0..vectors {
                let (yr, yi) = (y[v], y[vectors + v]);
                for (product, b) in products.iter_mut().zip(b.chunks_exact(step)) {
                    let (br, bi) = (b[v], b[vectors + v]);
                    let re = simd.mul_add_f32s(br, yr, simd.mul_f32s(bi, yi));
                    *product = [re, simd.mul_add_f32s(simd.neg_f32s(bi), yr, simd.mul_f32s(br, yi))];
                }
                let groups = weights.by_function.chunks_exact(weights.terms * TOGETHER);
                for (a, out) in groups.zip(out.chunks_exact_mut(TOGETHER * step)) {
                    let mut sums: [[S::f32s; 2]; TOGETHER] =
                        std::array::from_fn(|j| [out[j * step + v], out[j * step + vectors + v]]);
                    for (a, product) in a.chunks_exact(TOGETHER).zip(&products) {
                        for (sum, a) in sums.iter_mut().zip(a) {
                            let a = simd.splat_f32s(*a);
                            *sum = [0, 1].map(|i| simd.mul_add_f32s(a, product[i], sum[i]));
                        }
                    }
                    for (j, [re, im]) in sums.into_iter().enumerate() {
                        (out[j * step + v], out[j * step + vectors + v]) = (re, im);
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustfft::num_complex::Complex64;

    fn columns(n: usize, rows: usize, seed: usize) -> Vec<Vec<Complex32>> {
        let value = |i: usize| ((i * 7919 + seed) % 1009) as f32 / 1009.0 - 0.4;
        (0..n).map(|c| (0..rows).map(|r| Complex32::new(value(c * rows + r), value(3 * r + c))).collect()).collect()
    }

    fn packed(columns: &[Vec<Complex32>], n: usize) -> Vec<f32> {
        let mut out = vec![9.0; panels_len(columns[0].len(), n)];
        pack(columns.iter().map(Vec::as_slice), n, &mut out);
        out
    }

    /// Both sums by their definition in f64, for numbers of terms, functions and rows that fill no group and no panel.
    #[test]
    fn sums_are_those_of_their_definition() {
        for (terms, functions, rows) in [(1, 1, 1), (5, 7, 33), (8, 4, 16), (3, 9, 40)] {
            let (basis, f) = (columns(terms, rows, 1), columns(functions, rows, 5));
            let a = Array2::from_shape_fn((terms, functions), |(k, p)| ((k * 5 + p * 3) % 7) as f64 / 7.0 - 0.4);
            let weights = Weights::new(&a);
            let wide = |c: Complex32| Complex64::new(f64::from(c.re), f64::from(c.im));
            let panels = packed(&basis, padded(terms));
            let mut image = vec![Complex32::default(); rows];
            weights.image(&packed(&f, functions), &panels, &mut image);
            let frame = columns(1, rows, 8);
            let mut collected = vec![0.0; panels_len(rows, padded(functions))];
            for _ in 0..2 {
                weights.collect(&packed(&frame, 1), &panels, &mut collected);
            }
            let mut column = vec![Complex32::default(); rows];
            for w in 0..rows {
                let sum = |k: usize| (0..functions).map(|p| wide(f[p][w]) * a[[k, p]]).sum::<Complex64>();
                let want: Complex64 = (0..terms).map(|k| wide(basis[k][w]) * sum(k)).sum();
                assert!((wide(image[w]) - want).norm() < 1e-5);
            }
            for p in 0..functions {
                unpack(&collected, (p, padded(functions)), &mut column);
                for w in 0..rows {
                    let back = |k: usize| wide(basis[k][w]).conj() * wide(frame[0][w]) * a[[k, p]];
                    let want = 2.0 * (0..terms).map(back).sum::<Complex64>();
                    assert!((wide(column[w]) - want).norm() < 1e-5);
                }
            }
        }
    }
}
