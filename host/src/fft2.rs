//! Two-dimensional FFT of real images: plan a size, allocate scratch memory, transform.
//!
//! The spectrum `X[v, u] = sum_rc x[r, c] exp(-2 pi i (u r / rows + v c / cols))` of a [rows, cols] image is stored
//! transposed, [cols/2 + 1, rows], so that both passes run over contiguous memory: the first over rows, the second over
//! a few columns at a time that stay in the cache. Nothing is normalised: `inverse(forward(x)) = rows * cols * x`.
//!
//! ```
//! use ommatidia_host::fft2::{RealFft2, fast_size};
//! use rustfft::num_complex::Complex32;
//! let plan = RealFft2::new(2, 4);
//! let mut scratch = plan.scratch();
//! let image = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0];
//! let mut spectrum = vec![Complex32::default(); plan.spectrum_len()];
//! plan.forward(&image, &mut spectrum, &mut scratch);
//! assert_eq!(spectrum.len(), 6); // 3 columns of the half spectrum, 2 rows each
//! assert!((spectrum[0].re - 36.0).abs() < 1e-5); // the sum of all pixels
//! assert!((spectrum[1].re + 16.0).abs() < 1e-5); // upper row less lower row
//!
//! let mut back = [0.0; 8];
//! plan.inverse(&spectrum, &mut back, &mut scratch);
//! assert!(back.iter().zip(image).all(|(b, x)| (b / 8.0 - x).abs() < 1e-6));
//! assert_eq!(fast_size(121), 128); // pad to sizes that transform fast
//! ```

use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::Fft;
use rustfft::num_complex::Complex32;
use std::sync::Arc;

/// Columns that are transformed together: two cache lines of each row.
const TILE: usize = 16;

/// A planned real transform of [rows, cols] images.
#[derive(Clone)]
pub struct RealFft2 {
    rows: usize,
    cols: usize,
    row_forward: Arc<dyn RealToComplex<f32>>,
    row_inverse: Arc<dyn ComplexToReal<f32>>,
    col_forward: Arc<dyn Fft<f32>>,
    col_inverse: Arc<dyn Fft<f32>>,
}

/// Working memory of a [`RealFft2`]; each thread needs its own.
#[derive(Clone, Debug)]
pub struct Fft2Scratch {
    /// The half-transformed image, [tile of columns, row, column of the tile]: both passes run through it in order.
    tiles: Vec<Complex32>,
    /// Whether each row of the image holds a non-zero value.
    held: Vec<bool>,
    /// One row of the half-transformed image, padded to whole tiles.
    line: Vec<Complex32>,
    /// One tile, transposed: [column, row].
    tile: Vec<Complex32>,
    row: Vec<f32>,
    fft: Vec<Complex32>,
}

impl std::fmt::Debug for RealFft2 {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "RealFft2 {{ rows: {}, cols: {} }}", self.rows, self.cols)
    }
}

impl RealFft2 {
    /// Plans transforms of [rows, cols] images; both must be at least 1.
    pub fn new(rows: usize, cols: usize) -> Self {
        let mut real = RealFftPlanner::<f32>::new();
        let mut complex = rustfft::FftPlanner::<f32>::new();
        Self {
            rows,
            cols,
            row_forward: real.plan_fft_forward(cols),
            row_inverse: real.plan_fft_inverse(cols),
            col_forward: complex.plan_fft_forward(rows),
            col_inverse: complex.plan_fft_inverse(rows),
        }
    }

    /// Rows and columns of the image.
    pub fn shape(&self) -> [usize; 2] {
        [self.rows, self.cols]
    }

    /// Columns of the half spectrum, `cols / 2 + 1`.
    pub fn half_cols(&self) -> usize {
        self.cols / 2 + 1
    }

    /// Number of values in a spectrum, `rows * (cols / 2 + 1)`.
    pub fn spectrum_len(&self) -> usize {
        self.rows * self.half_cols()
    }

    /// Allocates working memory for this plan.
    pub fn scratch(&self) -> Fft2Scratch {
        let zero = Complex32::default();
        let fft = self.row_forward.get_scratch_len().max(self.row_inverse.get_scratch_len());
        let fft = fft.max(self.col_forward.get_inplace_scratch_len()).max(self.col_inverse.get_inplace_scratch_len());
        let padded = self.half_cols().next_multiple_of(TILE);
        Fft2Scratch {
            tiles: vec![zero; self.rows * padded],
            held: vec![false; self.rows],
            line: vec![zero; padded],
            tile: vec![zero; TILE * self.rows],
            row: vec![0.0; self.cols],
            fft: vec![zero; fft],
        }
    }

    /// Transforms an image [rows, cols] into its spectrum [cols/2 + 1, rows]. Rows of zeros are skipped in the first
    /// pass.
    ///
    /// # Panics
    /// A slice has another length than the plan, which is a mistake of the caller.
    pub fn forward(&self, image: &[f32], spectrum: &mut [Complex32], s: &mut Fft2Scratch) {
        assert_eq!((image.len(), spectrum.len()), (self.rows * self.cols, self.spectrum_len()));
        let load = |r: usize, row: &mut [f32]| {
            let from = &image[r * self.cols..(r + 1) * self.cols];
            row.copy_from_slice(from);
            from.iter().any(|v| *v != 0.0)
        };
        self.forward_with(load, |c, column| spectrum[c * self.rows..(c + 1) * self.rows].copy_from_slice(column), s);
    }

    /// As [`RealFft2::forward`], without storing the image or the spectrum.
    ///
    /// `load(r, row)` fills row `r` of the image (`cols` values) and returns whether the row has a non-zero value.
    /// `take(c, column)` receives column `c` of the half spectrum (`rows` values).
    pub fn forward_with(
        &self,
        mut load: impl FnMut(usize, &mut [f32]) -> bool,
        mut take: impl FnMut(usize, &[Complex32]),
        s: &mut Fft2Scratch,
    ) {
        let Fft2Scratch { tiles, held, line, tile, row, fft } = s;
        for (r, held) in held.iter_mut().enumerate() {
            *held = load(r, row);
            if *held {
                let done = self.row_forward.process_with_scratch(row, &mut line[..self.half_cols()], fft);
                debug_assert!(done.is_ok());
                for (strip, part) in tiles.chunks_exact_mut(self.rows * TILE).zip(line.chunks_exact(TILE)) {
                    strip[r * TILE..(r + 1) * TILE].copy_from_slice(part);
                }
            }
        }
        for (t, strip) in tiles.chunks_exact(self.rows * TILE).enumerate() {
            for ((r, part), held) in strip.chunks_exact(TILE).enumerate().zip(held.iter()) {
                for (c, v) in part.iter().enumerate() {
                    tile[c * self.rows + r] = if *held { *v } else { Complex32::default() };
                }
            }
            let columns = TILE.min(self.half_cols() - t * TILE);
            let used = &mut tile[..columns * self.rows];
            self.col_forward.process_with_scratch(used, fft);
            used.chunks_exact(self.rows).enumerate().for_each(|(c, column)| take(t * TILE + c, column));
        }
    }

    /// Transforms a spectrum [cols/2 + 1, rows] into `rows * cols` times its image [rows, cols].
    ///
    /// # Panics
    /// A slice has another length than the plan, which is a mistake of the caller.
    pub fn inverse(&self, spectrum: &[Complex32], image: &mut [f32], s: &mut Fft2Scratch) {
        assert_eq!((image.len(), spectrum.len()), (self.rows * self.cols, self.spectrum_len()));
        let load =
            |c: usize, column: &mut [Complex32]| column.copy_from_slice(&spectrum[c * self.rows..(c + 1) * self.rows]);
        self.inverse_with(load, |r, row| image[r * self.cols..(r + 1) * self.cols].copy_from_slice(row), self.rows, s);
    }

    /// As [`RealFft2::inverse`], without storing the spectrum or the image.
    ///
    /// `load(c, column)` fills column `c` of the half spectrum (as many values as the image has rows). `take(r, row)`
    /// receives each of the first `rows` rows of the image; the others are not computed.
    pub fn inverse_with(
        &self,
        mut load: impl FnMut(usize, &mut [Complex32]),
        mut take: impl FnMut(usize, &[f32]),
        rows: usize,
        s: &mut Fft2Scratch,
    ) {
        let Fft2Scratch { tiles, line, tile, row, fft, .. } = s;
        let half = self.half_cols();
        for (t, strip) in tiles.chunks_exact_mut(self.rows * TILE).enumerate() {
            let used = &mut tile[..TILE.min(half - t * TILE) * self.rows];
            used.chunks_exact_mut(self.rows).enumerate().for_each(|(c, column)| load(t * TILE + c, column));
            self.col_inverse.process_with_scratch(used, fft);
            for (r, part) in strip.chunks_exact_mut(TILE).enumerate().take(rows) {
                for (c, v) in part.iter_mut().enumerate() {
                    *v = tile[c * self.rows + r];
                }
            }
        }
        for r in 0..rows.min(self.rows) {
            for (strip, part) in tiles.chunks_exact(self.rows * TILE).zip(line.chunks_exact_mut(TILE)) {
                part.copy_from_slice(&strip[r * TILE..(r + 1) * TILE]);
            }
            // The imaginary parts at zero and at Nyquist are rounding noise; the transform requires them to be zero.
            line[0].im = 0.0;
            if self.cols.is_multiple_of(2) {
                line[half - 1].im = 0.0;
            }
            let done = self.row_inverse.process_with_scratch(&mut line[..half], row, fft);
            debug_assert!(done.is_ok());
            take(r, row);
        }
    }
}

/// The smallest even number >= `n` whose only prime factors are 2, 3 and 5: a size that transforms fast.
pub fn fast_size(n: usize) -> usize {
    let smooth = |mut m: usize| {
        for p in [2, 3, 5] {
            while m.is_multiple_of(p) {
                m /= p;
            }
        }
        m == 1
    };
    let mut size = n.max(2).next_multiple_of(2);
    while !smooth(size) {
        size += 2;
    }
    size
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    fn image(rows: usize, cols: usize) -> Vec<f32> {
        (0..rows * cols).map(|i| ((i * 7919 + 13) % 101) as f32 / 50.0 - 1.0).collect()
    }

    /// One value of the spectrum by its definition, in f64: (real, imaginary).
    fn naive(x: &[f32], rows: usize, cols: usize, u: usize, v: usize) -> [f64; 2] {
        let mut sum = [0.0; 2];
        for r in 0..rows {
            for c in 0..cols {
                let phase = -TAU * (u as f64 * r as f64 / rows as f64 + v as f64 * c as f64 / cols as f64);
                sum[0] += f64::from(x[r * cols + c]) * phase.cos();
                sum[1] += f64::from(x[r * cols + c]) * phase.sin();
            }
        }
        sum
    }

    #[test]
    fn equals_the_naive_sum_and_comes_back() {
        for (rows, cols) in [(8, 8), (6, 10), (9, 5), (1, 4), (5, 1)] {
            let plan = RealFft2::new(rows, cols);
            let x = image(rows, cols);
            let mut s = plan.scratch();
            let mut spectrum = vec![Complex32::new(9.0, 9.0); plan.spectrum_len()];
            plan.forward(&x, &mut spectrum, &mut s);
            for v in 0..plan.half_cols() {
                for u in 0..rows {
                    let (got, want) = (spectrum[v * rows + u], naive(&x, rows, cols, u, v));
                    assert!((f64::from(got.re) - want[0]).abs() < 1e-4 && (f64::from(got.im) - want[1]).abs() < 1e-4);
                }
            }
            let mut back = vec![9.0; rows * cols];
            plan.inverse(&spectrum, &mut back, &mut s);
            for (a, b) in back.iter().zip(&x) {
                assert!((a / (rows * cols) as f32 - b).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn fast_sizes_are_even_and_smooth() {
        assert_eq!([1, 2, 7, 13, 110, 121, 1025].map(fast_size), [2, 2, 8, 16, 120, 128, 1080]);
    }
}
