//! The image of one block of the object through a lens, and its transpose: sums of products of spectra. Few point
//! sources in the dark cost less as a sum of their PSFs.

use super::image::{Span, overlap};
use super::tiling::Block;
use crate::psf::nodes::{TapRow, Taps};
use ndarray::{Array2, Array3, ArrayView2, ArrayView3, Axis, s};
use ommatidia_physics::fft2::{Fft2Scratch, RealFft2};
use rayon::prelude::*;
use rustfft::num_complex::Complex32;

/// What the blocks of all lenses share.
#[derive(Clone, Debug)]
pub(super) struct Products {
    /// Rows and columns of frames.
    pub sensor: [usize; 2],
    /// Rows and columns of a basis PSF.
    pub window: usize,
    /// The transform that holds a block and its margin.
    pub fft: RealFft2,
    pub row_taps: Vec<Taps>,
    pub col_taps: TapRow,
}

/// The terms of one lens in one block.
#[derive(Clone, Copy, Debug)]
pub(super) struct BlockTerms<'a> {
    /// Sensor pixel of object pixel (0, 0).
    pub corner: [isize; 2],
    /// Basis PSFs, [k, window, window].
    pub windows: &'a Array3<f32>,
    /// Their spectra, [k, spectrum], scaled by 1 / (rows * cols) of the transform. None: they are not kept.
    pub spectra: Option<&'a [Complex32]>,
    /// Coefficients at the nodes, [k, node row, node col], DN for a unit source.
    pub coefficients: &'a Array3<f32>,
}

/// Per-thread working memory.
pub(super) struct Work {
    scratch: Fft2Scratch,
    /// A spectrum, [cols/2 + 1, rows].
    spectrum: Vec<Complex32>,
    /// The spectrum of a basis PSF, where it is not kept.
    kernel: Vec<Complex32>,
    map: MapRow,
}

/// Working memory of the interpolation of coefficients.
#[derive(Default)]
struct MapRow {
    /// Coefficients along one row of the object, at the nodes.
    nodes: Vec<f32>,
    values: Vec<f32>,
}

impl Products {
    pub fn work(&self) -> Work {
        Work {
            scratch: self.fft.scratch(),
            spectrum: vec![Complex32::default(); self.fft.spectrum_len()],
            kernel: Vec::new(),
            map: MapRow::default(),
        }
    }

    /// Spectra of kernels [k, window, window], [k, spectrum], scaled by 1 / (rows * cols) of the transform.
    pub fn spectra(&self, kernels: ArrayView3<'_, f32>) -> Vec<Complex32> {
        let n = self.fft.spectrum_len();
        let mut out = vec![Complex32::default(); kernels.len_of(Axis(0)) * n];
        out.par_chunks_exact_mut(n).enumerate().for_each_init(
            || self.fft.scratch(),
            |scratch, (k, spectrum)| self.spectrum(kernels.index_axis(Axis(0), k), spectrum, scratch),
        );
        out
    }

    fn spectrum(&self, kernel: ArrayView2<'_, f32>, out: &mut [Complex32], scratch: &mut Fft2Scratch) {
        let [rows, cols] = self.fft.shape();
        let scale = 1.0 / (rows * cols) as f32;
        let load = |r: usize, row: &mut [f32]| {
            if r >= kernel.nrows() {
                return false;
            }
            row.fill(0.0);
            row.iter_mut().zip(kernel.row(r)).for_each(|(to, v)| *to = v * scale);
            true
        };
        self.fft.forward_with(load, |c, column| out[c * rows..(c + 1) * rows].copy_from_slice(column), scratch);
    }

    /// `sum_k (M_k . O) * B_k` over one block: [block rows + window - 1, block cols + window - 1].
    pub fn forward(
        &self,
        terms: BlockTerms<'_>,
        (r, c): &Block,
        object: ArrayView2<'_, f32>,
        w: &mut Work,
    ) -> Array2<f32> {
        let size = (r.len() + self.window - 1, c.len() + self.window - 1);
        let block: Vec<f32> = object.slice(s![r.clone(), c.clone()]).iter().copied().collect();
        if block.iter().all(|v| *v == 0.0) {
            return Array2::zeros(size);
        }
        let [rows, cols] = self.fft.shape();
        let Work { scratch, spectrum: sum, kernel, map } = w;
        let lit = block.iter().filter(|v| **v != 0.0).count();
        if lit * self.window * self.window < rows * cols {
            return self.sum_of_psfs(terms, (r, c), &block, map);
        }
        sum.fill(Complex32::default());
        for (k, nodes) in terms.coefficients.outer_iter().enumerate() {
            let basis = self.kernel(terms, k, kernel, scratch);
            let weighted = |i: usize, row: &mut [f32]| {
                let Some(source) = block.get(i * c.len()..(i + 1) * c.len()) else { return false };
                if source.iter().all(|v| *v == 0.0) {
                    return false;
                }
                let weights = self.map_row(nodes, (r.start + i, c), map);
                let (inside, outside) = row.split_at_mut(c.len());
                inside.iter_mut().zip(source).zip(weights).for_each(|((out, o), m)| *out = o * m);
                outside.fill(0.0);
                inside.iter().any(|v| *v != 0.0)
            };
            let add = |column: usize, values: &[Complex32]| {
                let here = column * rows..(column + 1) * rows;
                let sum = sum[here.clone()].iter_mut();
                sum.zip(values).zip(&basis[here]).for_each(|((sum, x), b)| *sum += x * b);
            };
            self.fft.forward_with(weighted, add, scratch);
        }
        let mut light = Array2::zeros(size);
        let load = |column: usize, to: &mut [Complex32]| {
            to.copy_from_slice(&sum[column * rows..(column + 1) * rows]);
        };
        let take = |i: usize, row: &[f32]| {
            light.row_mut(i).iter_mut().zip(row).for_each(|(to, v)| *to = *v);
        };
        self.fft.inverse_with(load, take, size.0, scratch);
        light
    }

    /// [`Products::forward`] of a block, row by row, in which few pixels are lit: the sum of their PSFs.
    fn sum_of_psfs(
        &self,
        terms: BlockTerms<'_>,
        (r, c): (&Span, &Span),
        block: &[f32],
        map: &mut MapRow,
    ) -> Array2<f32> {
        let mut light = Array2::zeros((r.len() + self.window - 1, c.len() + self.window - 1));
        for (at, source) in block.iter().enumerate().filter(|(_, v)| **v != 0.0) {
            let (i, j) = (at / c.len(), at % c.len());
            let here = c.start + j..c.start + j + 1;
            let mut to = light.slice_mut(s![i..i + self.window, j..j + self.window]);
            for (nodes, kernel) in terms.coefficients.outer_iter().zip(terms.windows.outer_iter()) {
                let weight = self.map_row(nodes, (r.start + i, &here), map)[0];
                to.scaled_add(source * weight, &kernel);
            }
        }
        light
    }

    /// `sum_k M_k . (B_k correlated with the frame)` over one block, [block rows, block cols]; None where the block's
    /// image lies entirely off the sensor.
    pub fn adjoint(
        &self,
        terms: BlockTerms<'_>,
        (r, c): &Block,
        frame: ArrayView2<'_, f32>,
        w: &mut Work,
    ) -> Option<Array2<f32>> {
        let rows = self.fft.shape()[0];
        let half = (self.window / 2) as isize;
        let origin = [terms.corner[0] - half + r.start as isize, terms.corner[1] - half + c.start as isize];
        let size = [r.len() + self.window - 1, c.len() + self.window - 1];
        let (fr, br) = overlap(origin[0], size[0], self.sensor[0])?;
        let (fc, bc) = overlap(origin[1], size[1], self.sensor[1])?;
        let Work { scratch, spectrum, kernel, map } = w;
        let seen = |i: usize, row: &mut [f32]| {
            if !br.contains(&i) {
                return false;
            }
            row.fill(0.0);
            let from = frame.slice(s![fr.start + i - br.start, fc.clone()]);
            row[bc.clone()].iter_mut().zip(from).for_each(|(to, v)| *to = *v);
            true
        };
        let keep = |column: usize, values: &[Complex32]| {
            spectrum[column * rows..(column + 1) * rows].copy_from_slice(values);
        };
        self.fft.forward_with(seen, keep, scratch);
        let mut object = vec![0.0f32; r.len() * c.len()];
        for (k, nodes) in terms.coefficients.outer_iter().enumerate() {
            let basis = self.kernel(terms, k, kernel, scratch);
            let correlated = |column: usize, to: &mut [Complex32]| {
                let here = column * rows..(column + 1) * rows;
                let from = spectrum[here.clone()].iter().zip(&basis[here]);
                to.iter_mut().zip(from).for_each(|(to, (y, b))| *to = y * b.conj());
            };
            let weigh = |i: usize, row: &[f32]| {
                let weights = self.map_row(nodes, (r.start + i, c), map);
                let target = &mut object[i * c.len()..(i + 1) * c.len()];
                target.iter_mut().zip(row).zip(weights).for_each(|((out, v), m)| *out += v * m);
            };
            self.fft.inverse_with(correlated, weigh, r.len(), scratch);
        }
        Array2::from_shape_vec((r.len(), c.len()), object).ok()
    }

    /// The spectrum of basis PSF k, computed into `space` where it is not kept.
    fn kernel<'a>(
        &self,
        terms: BlockTerms<'a>,
        k: usize,
        space: &'a mut Vec<Complex32>,
        scratch: &mut Fft2Scratch,
    ) -> &'a [Complex32] {
        let n = self.fft.spectrum_len();
        match terms.spectra {
            Some(spectra) => &spectra[k * n..(k + 1) * n],
            None => {
                space.resize(n, Complex32::default());
                self.spectrum(terms.windows.index_axis(Axis(0), k), space, scratch);
                space
            }
        }
    }

    /// Interpolates coefficients along part of an object row, first to the column nodes, then to the pixels.
    fn map_row<'a>(&self, at: ArrayView2<'_, f32>, (row, cols): (usize, &Span), map: &'a mut MapRow) -> &'a [f32] {
        let taps = &self.row_taps[row];
        map.nodes.clear();
        map.nodes.resize(at.ncols(), 0.0);
        for (i, weight) in taps.weights.iter().enumerate().take(taps.count) {
            for (o, v) in map.nodes.iter_mut().zip(at.row(taps.first + i)) {
                *o += weight * v;
            }
        }
        map.values.clear();
        map.values.resize(cols.len(), 0.0);
        self.col_taps.apply(cols.clone(), &map.nodes, &mut map.values);
        &map.values
    }
}
