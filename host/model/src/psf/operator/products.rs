//! The image of one block of the object through a lens, and its transpose: sums of products of spectra. Few point
//! sources in the dark cost less as a sum of their PSFs.

use super::image::{LensImage, Span, overlap};
use super::terms::{Lens, Terms};
use super::tiling::Block;
use crate::psf::nodes::{TapRow, Taps};
use ndarray::{Array2, ArrayView2, ArrayView3, ArrayViewMut2, Axis, s};
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
    pub lens: &'a Lens,
    /// Spectra of the basis PSFs, [k, spectrum], scaled by 1 / (rows * cols) of the transform.
    pub spectra: &'a [Complex32],
}

/// Per-thread working memory.
pub(super) struct Work {
    pub scratch: Fft2Scratch,
    /// A spectrum, [cols/2 + 1, rows].
    pub spectrum: Vec<Complex32>,
    pub map: MapRow,
}

/// Working memory of the interpolation of coefficients.
#[derive(Default)]
pub(super) struct MapRow {
    /// Coefficients along one row of the object, at the nodes.
    nodes: Vec<f32>,
    values: Vec<f32>,
}

impl Products {
    pub fn work(&self) -> Work {
        Work {
            scratch: self.fft.scratch(),
            spectrum: vec![Complex32::default(); self.fft.spectrum_len()],
            map: MapRow::default(),
        }
    }

    /// Shape of the image of an object of `shape` through a lens.
    pub fn image_shape(&self, shape: (usize, usize)) -> (usize, usize) {
        (shape.0 + self.window - 1, shape.1 + self.window - 1)
    }

    /// Adds the light of a block to the image of its lens.
    pub fn add(&self, part: &Array2<f32>, (r, c): &Block, image: &mut Array2<f32>) {
        let mut to = image.slice_mut(s![r.start..r.start + part.nrows(), c.start..c.start + part.ncols()]);
        to += part;
    }

    /// The image of a lens whose object pixel (0, 0) is seen at sensor pixel `corner`.
    pub fn placed(&self, corner: [isize; 2], light: Array2<f32>) -> LensImage {
        let half = (self.window / 2) as isize;
        LensImage { origin: corner.map(|c| c - half), light }
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

    /// Whether so few pixels of a block are lit that a sum of their PSFs costs less than transforms.
    pub fn is_sparse(&self, object: ArrayView2<'_, f32>) -> bool {
        let [rows, cols] = self.fft.shape();
        object.iter().filter(|v| **v != 0.0).count() * self.window * self.window < rows * cols
    }

    /// `sum_k (M_k . O) * B_k` over one block: [block rows + window - 1, block cols + window - 1].
    pub fn forward(&self, of: BlockTerms<'_>, block: &Block, object: ArrayView2<'_, f32>, w: &mut Work) -> Array2<f32> {
        let (r, c) = block;
        let object = object.slice(s![r.clone(), c.clone()]);
        let mut light = Array2::zeros(self.image_shape(object.dim()));
        if self.is_sparse(object) {
            self.sum_of_psfs(&of.lens.terms, block, object, &mut light, w);
            return light;
        }
        let rows = self.fft.shape()[0];
        let Work { scratch, spectrum: sum, map } = w;
        sum.fill(Complex32::default());
        for (k, nodes) in of.lens.terms.coefficients.outer_iter().enumerate() {
            let basis = self.of_term(of, k);
            let add = |column: usize, values: &[Complex32]| {
                let here = column * rows..(column + 1) * rows;
                let sum = sum[here.clone()].iter_mut();
                sum.zip(values).zip(&basis[here]).for_each(|((sum, x), b)| *sum += x * b);
            };
            self.weighted(nodes, (r, c), object, add, scratch, map);
        }
        let load = |column: usize, to: &mut [Complex32]| {
            to.copy_from_slice(&sum[column * rows..(column + 1) * rows]);
        };
        self.light(load, &mut light, scratch);
        light
    }

    /// Transforms a block `object` times coefficients that are interpolated from `nodes`; `take` receives the columns
    /// of the spectrum.
    pub fn weighted(
        &self,
        nodes: ArrayView2<'_, f32>,
        (r, c): (&Span, &Span),
        object: ArrayView2<'_, f32>,
        take: impl FnMut(usize, &[Complex32]),
        scratch: &mut Fft2Scratch,
        map: &mut MapRow,
    ) {
        let weighted = |i: usize, row: &mut [f32]| {
            if i >= object.nrows() || object.row(i).iter().all(|v| *v == 0.0) {
                return false;
            }
            let weights = self.map_row(nodes, (r.start + i, c), map);
            let (inside, outside) = row.split_at_mut(c.len());
            inside.iter_mut().zip(object.row(i)).zip(weights).for_each(|((out, o), m)| *out = o * m);
            outside.fill(0.0);
            inside.iter().any(|v| *v != 0.0)
        };
        self.fft.forward_with(weighted, take, scratch);
    }

    /// The light of a block, [block rows + window - 1, block cols + window - 1], from its spectrum.
    pub fn light(&self, load: impl FnMut(usize, &mut [Complex32]), light: &mut Array2<f32>, scratch: &mut Fft2Scratch) {
        let rows = light.nrows();
        let take = |i: usize, row: &[f32]| {
            light.row_mut(i).iter_mut().zip(row).for_each(|(to, v)| *to = *v);
        };
        self.fft.inverse_with(load, take, rows, scratch);
    }

    /// The light of a block in which few pixels are lit, of the same shape: the sum of their PSFs.
    pub fn sum_of_psfs(
        &self,
        terms: &Terms,
        (r, c): &Block,
        object: ArrayView2<'_, f32>,
        light: &mut Array2<f32>,
        w: &mut Work,
    ) {
        light.fill(0.0);
        for ((i, j), source) in object.indexed_iter().filter(|(_, v)| **v != 0.0) {
            let here = c.start + j..c.start + j + 1;
            let mut to = light.slice_mut(s![i..i + self.window, j..j + self.window]);
            for (nodes, kernel) in terms.coefficients.outer_iter().zip(terms.kernels.outer_iter()) {
                let weight = self.map_row(nodes, (r.start + i, &here), &mut w.map)[0];
                to.scaled_add(source * weight, &kernel);
            }
        }
    }

    /// `sum_k M_k . (B_k correlated with the frame)` over one block, [block rows, block cols]; None where the block's
    /// image lies entirely off the sensor.
    pub fn adjoint(
        &self,
        of: BlockTerms<'_>,
        block: &Block,
        frame: ArrayView2<'_, f32>,
        w: &mut Work,
    ) -> Option<Array2<f32>> {
        let (r, c) = block;
        let rows = self.fft.shape()[0];
        let Work { scratch, spectrum, map } = w;
        let keep = |column: usize, values: &[Complex32]| {
            spectrum[column * rows..(column + 1) * rows].copy_from_slice(values);
        };
        if !self.seen(of.lens.corner, block, frame, keep, scratch) {
            return None;
        }
        let mut object = Array2::zeros((r.len(), c.len()));
        for (k, nodes) in of.lens.terms.coefficients.outer_iter().enumerate() {
            let basis = self.of_term(of, k);
            let correlated = |column: usize, to: &mut [Complex32]| {
                let here = column * rows..(column + 1) * rows;
                let from = spectrum[here.clone()].iter().zip(&basis[here]);
                to.iter_mut().zip(from).for_each(|(to, (y, b))| *to = y * b.conj());
            };
            self.weigh(nodes, (r, c), correlated, object.view_mut(), scratch, map);
        }
        Some(object)
    }

    /// Transforms what a lens shows of a block on a frame; false where that lies entirely off the sensor. `corner` is
    /// the sensor pixel of object pixel (0, 0); `take` receives the columns of the spectrum.
    pub fn seen(
        &self,
        corner: [isize; 2],
        (r, c): &Block,
        frame: ArrayView2<'_, f32>,
        take: impl FnMut(usize, &[Complex32]),
        scratch: &mut Fft2Scratch,
    ) -> bool {
        let half = (self.window / 2) as isize;
        let origin = [corner[0] - half + r.start as isize, corner[1] - half + c.start as isize];
        let size = [r.len() + self.window - 1, c.len() + self.window - 1];
        let Some((fr, br)) = overlap(origin[0], size[0], self.sensor[0]) else { return false };
        let Some((fc, bc)) = overlap(origin[1], size[1], self.sensor[1]) else { return false };
        let seen = |i: usize, row: &mut [f32]| {
            if !br.contains(&i) {
                return false;
            }
            row.fill(0.0);
            let from = frame.slice(s![fr.start + i - br.start, fc.clone()]);
            row[bc.clone()].iter_mut().zip(from).for_each(|(to, v)| *to = *v);
            true
        };
        self.fft.forward_with(seen, take, scratch);
        true
    }

    /// Adds the image of a spectrum, times coefficients that are interpolated from `nodes`, to a block of an object.
    pub fn weigh(
        &self,
        nodes: ArrayView2<'_, f32>,
        (r, c): (&Span, &Span),
        load: impl FnMut(usize, &mut [Complex32]),
        mut object: ArrayViewMut2<'_, f32>,
        scratch: &mut Fft2Scratch,
        map: &mut MapRow,
    ) {
        let weigh = |i: usize, row: &[f32]| {
            let weights = self.map_row(nodes, (r.start + i, c), map);
            object.row_mut(i).iter_mut().zip(row).zip(weights).for_each(|((out, v), m)| *out += v * m);
        };
        self.fft.inverse_with(load, weigh, r.len(), scratch);
    }

    /// The spectrum of basis PSF k.
    fn of_term<'a>(&self, of: BlockTerms<'a>, k: usize) -> &'a [Complex32] {
        let n = self.fft.spectrum_len();
        &of.spectra[k * n..(k + 1) * n]
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
