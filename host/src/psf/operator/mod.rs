//! Eq. 3 of the paper as one linear operator, with its exact transpose.
//!
//! ```text
//! g = sum_l place_l( sum_k (M_lk . O) * B_lk )
//! ```
//! `place_l` puts object pixel (r, c) at sensor pixel `corner_l + (r, c)`, with `corner_l = round(anchor_l - centre)`.
//! One object pixel is one sensor pixel; the sub-pixel remainder and distortion are part of the basis PSFs. Light that
//! falls off the sensor is cut. The convolutions run block by block over the object (overlap-add), so that the memory
//! is bounded by the block and not by the object. The spectra of the basis PSFs are kept where they take little memory,
//! and otherwise recomputed for one lens at a time. All arithmetic is f32; the result does not depend on the number of
//! threads.

mod config;
mod error;
mod image;

pub use config::{CalibratedOptics, OperatorConfig};
pub use error::OperatorError;
pub use image::LensImage;

use super::nodes::{TapRow, Taps};
use super::shift::shifted_windows;
use crate::fft2::{Fft2Scratch, RealFft2, fast_size};
use crate::psf::chief_rays::ChiefRays;
use config::check;
use image::{Span, overlap};
use ndarray::{Array2, Array3, ArrayView2, ArrayView3, Axis, s};
use rayon::prelude::*;
use rustfft::num_complex::Complex32;
use std::borrow::Cow;

/// The plan of one lens.
#[derive(Clone, Debug)]
struct LensPlan {
    /// Sensor pixel of object pixel (0, 0).
    corner: [isize; 2],
    basis: Basis,
    /// Coefficients at the nodes, [k, node row, node col], DN for a unit source.
    coefficients: Array3<f32>,
}

/// The basis PSFs of a lens.
#[derive(Clone, Debug)]
enum Basis {
    /// Their spectra, [k, spectrum], scaled by 1 / (rows * cols) of the transform.
    Spectra(Vec<Complex32>),
    /// The basis PSFs themselves, [k, window, window]; spectra are computed at each application.
    Windows(Array3<f32>),
}

/// The planned operator A: object [object rows, object cols] -> light on the sensor [sensor rows, sensor cols].
///
/// Units: DN above black for an object in the session's light unit, at the exposure of the calibration.
#[derive(Clone, Debug)]
pub struct LowRankOperator {
    object: [usize; 2],
    sensor: [usize; 2],
    window: usize,
    step: [usize; 2],
    fft: RealFft2,
    lenses: Vec<Option<LensPlan>>,
    row_taps: Vec<Taps>,
    col_taps: TapRow,
}

/// Per-thread working memory.
struct Work {
    scratch: Fft2Scratch,
    /// A spectrum, [cols/2 + 1, rows].
    spectrum: Vec<Complex32>,
    /// Coefficients along one row of the object, at the nodes.
    node_row: Vec<f32>,
    map_row: Vec<f32>,
}

impl LowRankOperator {
    /// Plans the operator with its chief rays at `rays`: those of the calibration (`optics.rays`), or moved from there
    /// by an effect.
    ///
    /// # Errors
    /// The tables disagree in size, the depth does not exist, or the magnification of `rays` is not that of the
    /// calibration.
    pub fn plan(optics: CalibratedOptics<'_>, rays: &ChiefRays, config: OperatorConfig) -> Result<Self, OperatorError> {
        let CalibratedOptics { psf, rays: calibrated, object, sensor } = optics;
        check(optics, rays, config)?;
        let centre = object.map(|n| (n as f64 - 1.0) / 2.0);
        let moves: Vec<[f64; 2]> = (0..rays.anchors_px.len())
            .map(|l| [0, 1].map(|a| rays.anchors_px[l][a] - calibrated.anchors_px[l][a]))
            .collect();
        let sub_pixel = moves.iter().flatten().any(|d| d.fract() != 0.0);
        // A kernel that moves by a fraction of a pixel spreads a little: keep its tails.
        let margin = if sub_pixel { 4 } else { 0 };
        let window = psf.basis.dim().2 + 2 * margin;
        let transform = object.map(|n| best_transform(n, window, config.max_transform_px));
        let fft = RealFft2::new(transform[0], transform[1]);
        let terms = moves.len() * psf.basis.dim().1;
        let kept = terms * fft.spectrum_len() * size_of::<Complex32>() <= config.most_spectra_bytes;
        let lenses = moves
            .par_iter()
            .enumerate()
            .map(|(l, shift)| {
                if rays.dead[l] {
                    return None;
                }
                let whole = shift.map(f64::round);
                let fraction = [shift[0] - whole[0], shift[1] - whole[1]];
                let basis = psf.basis.index_axis(Axis(0), l);
                let kernels = shifted_windows(basis, fraction, margin);
                let corner =
                    [0, 1].map(|a| (calibrated.anchors_px[l][a] - centre[a]).round() as isize + whole[a] as isize);
                let coefficients = psf.coefficients.slice(s![l, .., config.depth, .., ..]).to_owned();
                let basis =
                    if kept { Basis::Spectra(spectra_of(&fft, kernels.view())) } else { Basis::Windows(kernels) };
                Some(LensPlan { corner, basis, coefficients })
            })
            .collect();
        Ok(Self {
            object,
            sensor,
            window,
            step: [0, 1].map(|a| (transform[a] + 1 - window).min(object[a])),
            fft,
            lenses,
            row_taps: Taps::for_pixels(&psf.node_rows_px, object[0]),
            col_taps: TapRow::for_pixels(&psf.node_cols_px, object[1]),
        })
    }

    /// Rows and columns of objects.
    pub fn object_shape(&self) -> [usize; 2] {
        self.object
    }

    /// Rows and columns of frames.
    pub fn sensor_shape(&self) -> [usize; 2] {
        self.sensor
    }

    /// Number of lenses, dead ones counted.
    pub fn lenses(&self) -> usize {
        self.lenses.len()
    }

    /// Sensor pixel of object pixel (0, 0) behind each lens; None: dead.
    pub fn corners(&self) -> Vec<Option<[isize; 2]>> {
        self.lenses.iter().map(|l| l.as_ref().map(|plan| plan.corner)).collect()
    }

    /// A x: the light of all lenses on the sensor, DN above black, [sensor rows, sensor cols], for an object
    /// [object rows, object cols].
    ///
    /// # Errors
    /// The object does not have the planned shape.
    pub fn apply(&self, object: ArrayView2<'_, f32>) -> Result<Array2<f32>, OperatorError> {
        let mut frame = Array2::zeros(self.sensor);
        self.each_lens(object, |_, image| image.add_to(&mut frame))?;
        Ok(frame)
    }

    /// Calls `take` with the image of each living lens, in the order of the lenses. Only a few images are in memory at
    /// a time.
    ///
    /// # Errors
    /// The object does not have the planned shape.
    pub fn each_lens(
        &self,
        object: ArrayView2<'_, f32>,
        mut take: impl FnMut(usize, LensImage),
    ) -> Result<(), OperatorError> {
        same_shape("object", self.object, object.dim())?;
        for group in self.groups() {
            let images: Vec<_> = group
                .into_par_iter()
                .filter_map(|l| self.lenses[l].as_ref().map(|plan| (l, self.lens_image(plan, object))))
                .collect();
            images.into_iter().for_each(|(l, image)| take(l, image));
        }
        Ok(())
    }

    /// Lenses that are computed at the same time: as many as there are threads, or one where its spectra are
    /// recomputed.
    fn groups(&self) -> impl Iterator<Item = Span> + use<> {
        let made = self.lenses.iter().flatten().any(|plan| matches!(plan.basis, Basis::Windows(_)));
        let (n, size) = (self.lenses.len(), if made { 1 } else { rayon::current_num_threads().max(1) });
        (0..n).step_by(size).map(move |first| first..(first + size).min(n))
    }

    /// A' y: the exact transpose, from a frame [sensor rows, sensor cols] to the object grid [object rows, object
    /// cols].
    ///
    /// # Errors
    /// The frame does not have the planned shape.
    pub fn adjoint(&self, frame: ArrayView2<'_, f32>) -> Result<Array2<f32>, OperatorError> {
        same_shape("frame", self.sensor, frame.dim())?;
        let mut object = Array2::zeros(self.object);
        let blocks: Vec<_> = self.blocks().collect();
        for group in self.groups() {
            let plans: Vec<&LensPlan> = group.filter_map(|l| self.lenses[l].as_ref()).collect();
            let spectra: Vec<_> = plans.iter().map(|plan| self.spectra(plan)).collect();
            let tasks: Vec<_> = (0..plans.len()).flat_map(|p| (0..blocks.len()).map(move |b| (p, b))).collect();
            let part = |w: &mut Work, &(p, b): &(usize, usize)| {
                self.adjoint_block((plans[p], &spectra[p]), &blocks[b], frame, w)
            };
            let parts: Vec<_> = tasks.par_iter().map_init(|| self.work(), part).collect();
            for ((_, b), part) in tasks.iter().zip(parts) {
                let (r, c) = &blocks[*b];
                let mut target = object.slice_mut(s![r.clone(), c.clone()]);
                part.iter().for_each(|part| target += part);
            }
        }
        Ok(object)
    }

    fn work(&self) -> Work {
        Work {
            scratch: self.fft.scratch(),
            spectrum: vec![Complex32::default(); self.fft.spectrum_len()],
            node_row: Vec::new(),
            map_row: Vec::new(),
        }
    }

    /// The blocks of the object, as ranges of rows and columns.
    fn blocks(&self) -> impl Iterator<Item = (Span, Span)> + '_ {
        let spans = move |a: usize| {
            (0..self.object[a]).step_by(self.step[a]).map(move |i| i..(i + self.step[a]).min(self.object[a]))
        };
        spans(0).flat_map(move |r| spans(1).map(move |c| (r.clone(), c)))
    }

    fn lens_image(&self, plan: &LensPlan, object: ArrayView2<'_, f32>) -> LensImage {
        let blocks: Vec<_> = self.blocks().collect();
        let spectra = self.spectra(plan);
        let parts: Vec<Array2<f32>> = blocks
            .par_iter()
            .map_init(|| self.work(), |work, block| self.forward_block((plan, &spectra), block, object, work))
            .collect();
        let [rows, cols] = self.object.map(|n| n + self.window - 1);
        let mut light = Array2::zeros((rows, cols));
        for ((r, c), part) in blocks.iter().zip(parts) {
            let mut target = light.slice_mut(s![r.start..r.start + part.nrows(), c.start..c.start + part.ncols()]);
            target += &part;
        }
        let half = (self.window / 2) as isize;
        LensImage { origin: plan.corner.map(|c| c - half), light }
    }

    /// `sum_k (M_k . O) * B_k` over one block: [block rows + window - 1, block cols + window - 1].
    fn forward_block(
        &self,
        (plan, spectra): (&LensPlan, &[Complex32]),
        (r, c): &(Span, Span),
        object: ArrayView2<'_, f32>,
        w: &mut Work,
    ) -> Array2<f32> {
        let size = (r.len() + self.window - 1, c.len() + self.window - 1);
        let block: Vec<f32> = object.slice(s![r.clone(), c.clone()]).iter().copied().collect();
        if block.iter().all(|v| *v == 0.0) {
            return Array2::zeros(size);
        }
        let rows = self.fft.shape()[0];
        let Work { scratch, spectrum: sum, node_row, map_row } = w;
        sum.fill(Complex32::default());
        for (map, basis) in plan.coefficients.outer_iter().zip(spectra.chunks_exact(sum.len())) {
            let weighted = |i: usize, row: &mut [f32]| {
                let Some(source) = block.get(i * c.len()..(i + 1) * c.len()) else { return false };
                self.map_row(map, (r.start + i, c), node_row, map_row);
                let (inside, outside) = row.split_at_mut(c.len());
                inside.iter_mut().zip(source).zip(&*map_row).for_each(|((out, o), m)| *out = o * m);
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

    /// `sum_k M_k . (B_k correlated with the frame)` of one lens over one block, [block rows, block cols]; None where
    /// the block's image lies entirely off the sensor.
    fn adjoint_block(
        &self,
        (plan, spectra): (&LensPlan, &[Complex32]),
        (r, c): &(Span, Span),
        frame: ArrayView2<'_, f32>,
        w: &mut Work,
    ) -> Option<Array2<f32>> {
        let rows = self.fft.shape()[0];
        let half = (self.window / 2) as isize;
        let origin = [plan.corner[0] - half + r.start as isize, plan.corner[1] - half + c.start as isize];
        let size = [r.len() + self.window - 1, c.len() + self.window - 1];
        let (fr, br) = overlap(origin[0], size[0], self.sensor[0])?;
        let (fc, bc) = overlap(origin[1], size[1], self.sensor[1])?;
        let Work { scratch, spectrum, node_row, map_row } = w;
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
        for (map, basis) in plan.coefficients.outer_iter().zip(spectra.chunks_exact(spectrum.len())) {
            let correlated = |column: usize, to: &mut [Complex32]| {
                let here = column * rows..(column + 1) * rows;
                let from = spectrum[here.clone()].iter().zip(&basis[here]);
                to.iter_mut().zip(from).for_each(|(to, (y, b))| *to = y * b.conj());
            };
            let weigh = |i: usize, row: &[f32]| {
                self.map_row(map, (r.start + i, c), node_row, map_row);
                let target = &mut object[i * c.len()..(i + 1) * c.len()];
                target.iter_mut().zip(row).zip(&*map_row).for_each(|((out, v), m)| *out += v * m);
            };
            self.fft.inverse_with(correlated, weigh, r.len(), scratch);
        }
        Array2::from_shape_vec((r.len(), c.len()), object).ok()
    }

    /// Spectra of the basis PSFs of a lens, [k, spectrum].
    fn spectra<'a>(&self, plan: &'a LensPlan) -> Cow<'a, [Complex32]> {
        match &plan.basis {
            Basis::Spectra(spectra) => Cow::Borrowed(spectra),
            Basis::Windows(windows) => Cow::Owned(spectra_of(&self.fft, windows.view())),
        }
    }

    /// Interpolates the coefficients along part of an object row, first to the column nodes, then to the pixels.
    fn map_row(&self, map: ArrayView2<'_, f32>, (row, cols): (usize, &Span), nodes: &mut Vec<f32>, out: &mut Vec<f32>) {
        let taps = &self.row_taps[row];
        nodes.clear();
        nodes.resize(map.ncols(), 0.0);
        for (i, weight) in taps.weights.iter().enumerate().take(taps.count) {
            for (o, v) in nodes.iter_mut().zip(map.row(taps.first + i)) {
                *o += weight * v;
            }
        }
        out.clear();
        out.resize(cols.len(), 0.0);
        self.col_taps.apply(cols.clone(), nodes, out);
    }
}

fn same_shape(what: &'static str, expected: [usize; 2], found: (usize, usize)) -> Result<(), OperatorError> {
    let found = [found.0, found.1];
    if expected == found { Ok(()) } else { Err(OperatorError::Shape { what, expected, found }) }
}

/// Side of the cheapest transform for an object of `n` pixels a side. Large blocks waste little on the margin of the
/// window; a transform is no larger than `most`, unless the window needs it.
fn best_transform(n: usize, window: usize, most: usize) -> usize {
    let most = most.max(2 * window);
    let fewest = n.div_ceil(most + 1 - window).max(1);
    let of = |blocks: usize| fast_size(n.div_ceil(blocks) + window - 1);
    let cost = |blocks: &usize| (blocks * of(*blocks)) as f64 * (of(*blocks) as f64).ln();
    let best = (fewest..=fewest + 2).min_by(|a, b| cost(a).total_cmp(&cost(b)));
    of(best.unwrap_or(fewest))
}

/// Spectra of kernels [k, window, window], scaled by 1 / (rows * cols) of the transform.
fn spectra_of(fft: &RealFft2, kernels: ArrayView3<'_, f32>) -> Vec<Complex32> {
    let [rows, cols] = fft.shape();
    let scale = 1.0 / (rows * cols) as f32;
    let n = fft.spectrum_len();
    let mut out = vec![Complex32::default(); kernels.len_of(Axis(0)) * n];
    out.par_chunks_exact_mut(n).enumerate().for_each_init(
        || fft.scratch(),
        |scratch, (k, spectrum)| {
            let kernel = kernels.index_axis(Axis(0), k);
            let load = |r: usize, row: &mut [f32]| {
                if r >= kernel.nrows() {
                    return false;
                }
                row.fill(0.0);
                row.iter_mut().zip(kernel.row(r)).for_each(|(to, v)| *to = v * scale);
                true
            };
            fft.forward_with(load, |c, column| spectrum[c * rows..(c + 1) * rows].copy_from_slice(column), scratch);
        },
    );
    out
}

#[cfg(test)]
mod tests;
