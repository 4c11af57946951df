//! The Fourier filter bank for inference: one frame at a time, all cores on each transform, little memory.
//!
//! The same transforms as in [`Fourier::forward`], and the same bits. A few columns at a time go through product,
//! transform and transposition while they are in the cache; of the product of spectra only these columns ever exist.

use super::fourier::{Fourier, Spectrum};
use rayon::prelude::*;
use rustfft::num_complex::Complex32;
use std::sync::Arc;

/// Columns that are transformed together: two cache lines of each row.
const TILE: usize = 16;

/// A filter bank with its filters.
#[derive(Debug)]
pub struct StreamedBank {
    plan: Arc<Fourier>,
    filters: Vec<Spectrum>,
}

impl StreamedBank {
    /// A bank with the given filters, as [`Fourier::filters`] makes them.
    pub fn new(plan: Arc<Fourier>, filters: Vec<Spectrum>) -> Self {
        Self { plan, filters }
    }

    /// A frame, [frame rows, frame cols], filtered and cropped: [channels, object rows, object cols].
    pub fn apply(&self, frame: &[f32]) -> Vec<f32> {
        let spectrum = self.spectrum(frame);
        let [rows, cols] = self.plan.sizes.object;
        let mut out = vec![0.0; self.filters.len() * rows * cols];
        let mut tiles = vec![Complex32::default(); self.plan.bins().div_ceil(TILE) * TILE * rows];
        for (filter, out) in self.filters.iter().zip(out.chunks_exact_mut((rows * cols).max(1))) {
            self.columns(&spectrum, filter, &mut tiles);
            self.rows(&tiles, out);
        }
        out
    }

    /// As [`Fourier::rfft2`] of a frame.
    fn spectrum(&self, frame: &[f32]) -> Spectrum {
        let (plan, bins) = (&self.plan, self.plan.bins());
        let (t, [height, width]) = (plan.sizes.filter_size, plan.sizes.frame);
        let [top, left] = plan.sizes.frame.map(|side| (t - side) / 2);
        let mut rows = vec![Complex32::default(); height * bins];
        rows.par_chunks_exact_mut(bins).zip(frame.par_chunks_exact(width)).for_each_init(
            || (vec![0.0; t], plan.rows_forward.make_scratch_vec()),
            |(row, scratch), (out, frame)| {
                // The transform overwrites `row`, so all of it is written again.
                row.fill(0.0);
                row[left..left + width].copy_from_slice(frame);
                // The lengths are those of the plan, so this cannot fail.
                let _ = plan.rows_forward.process_with_scratch(row, out, scratch);
            },
        );
        let mut spectrum = vec![Complex32::default(); bins * t];
        spectrum.par_chunks_mut(TILE * t).enumerate().for_each_init(
            || vec![Complex32::default(); plan.cols_forward.get_inplace_scratch_len()],
            |scratch, (tile, columns)| {
                let first = tile * TILE;
                for (r, row) in rows.chunks_exact(bins).enumerate() {
                    for (column, v) in columns.chunks_exact_mut(t).zip(&row[first..]) {
                        column[top + r] = *v;
                    }
                }
                plan.cols_forward.process_with_scratch(columns, scratch);
            },
        );
        spectrum
    }

    /// The product of two spectra, transformed along its columns: the rows of the object, [tile of columns, row, column
    /// of the tile].
    fn columns(&self, x: &[Complex32], filter: &[Complex32], tiles: &mut [Complex32]) {
        let (plan, t, rows) = (&self.plan, self.plan.sizes.filter_size, self.plan.sizes.object[0]);
        let top = (t - rows) / 2;
        tiles.par_chunks_exact_mut(rows * TILE).enumerate().for_each_init(
            || {
                let scratch = plan.cols_inverse.get_inplace_scratch_len();
                (vec![Complex32::default(); TILE * t], vec![Complex32::default(); scratch])
            },
            |(columns, scratch), (tile, out)| {
                let here = tile * TILE * t..x.len().min((tile + 1) * TILE * t);
                let columns = &mut columns[..here.len()];
                columns.iter_mut().zip(&x[here.clone()]).zip(&filter[here]).for_each(|((c, x), k)| *c = x * k);
                plan.cols_inverse.process_with_scratch(columns, scratch);
                for (r, out) in out.chunks_exact_mut(TILE).enumerate() {
                    for (out, column) in out.iter_mut().zip(columns.chunks_exact(t)) {
                        *out = column[top + r];
                    }
                }
            },
        );
    }

    /// The columns of the object from [`Self::columns`], transformed along their rows: [object rows, object cols].
    fn rows(&self, tiles: &[Complex32], out: &mut [f32]) {
        let (plan, bins) = (&self.plan, self.plan.bins());
        let (t, [rows, cols]) = (plan.sizes.filter_size, plan.sizes.object);
        let (left, scale) = ((t - cols) / 2, 1.0 / (t * t) as f32);
        out.par_chunks_exact_mut(cols).enumerate().for_each_init(
            || {
                let line = vec![Complex32::default(); bins.next_multiple_of(TILE)];
                (line, vec![0.0; t], plan.rows_inverse.make_scratch_vec())
            },
            |(line, row, scratch), (r, out)| {
                for (line, tile) in line.chunks_exact_mut(TILE).zip(tiles.chunks_exact(rows * TILE)) {
                    line.copy_from_slice(&tile[r * TILE..(r + 1) * TILE]);
                }
                line[0].im = 0.0;
                if t.is_multiple_of(2) {
                    line[bins - 1].im = 0.0;
                }
                let _ = plan.rows_inverse.process_with_scratch(&mut line[..bins], row, scratch);
                out.iter_mut().zip(&row[left..]).for_each(|(o, v)| *o = v * scale);
            },
        );
    }
}

#[cfg(test)]
mod tests {
    use super::super::fourier::FourierSizes;
    use super::*;

    #[test]
    fn bits_are_those_of_the_bank_for_training() {
        for (frame, object, filter_size) in [([6, 7], [4, 2], 8), ([50, 90], [40, 44], 99), ([70, 61], [64, 70], 70)] {
            let plan = Arc::new(Fourier::new(FourierSizes { frame, object, filter_size, channels: 3 }));
            let values = |n: usize, k: usize| (0..n).map(|i| ((i * k) % 101) as f32 / 50.0 - 1.0).collect::<Vec<f32>>();
            let n = 3 * filter_size * (filter_size / 2 + 1);
            let (x, re, im) = (values(frame[0] * frame[1], 37), values(n, 29), values(n, 31));
            let want = plan.forward(&plan.spectra(&x), &plan.filters(&re, &im));
            let bank = StreamedBank::new(Arc::clone(&plan), plan.filters(&re, &im));
            assert!(bank.apply(&x) == want, "{frame:?}");
        }
    }
}
