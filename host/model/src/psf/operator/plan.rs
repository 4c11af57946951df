//! The planned operator: which terms each lens has in each block, and how lenses and blocks are shared out.

use super::config::{CalibratedOptics, OperatorConfig, check};
use super::error::OperatorError;
use super::image::{LensImage, Span};
use super::local::{Interpolation, Terms, decompose};
use super::products::{BlockTerms, Products, Work};
use super::tiling::{Block, Tiling};
use crate::psf::chief_rays::ChiefRays;
use crate::psf::nodes::{TapRow, Taps};
use crate::psf::shift::shifted_windows;
use ndarray::{Array2, ArrayView2, Axis, s};
use ommatidia_physics::fft2::RealFft2;
use rayon::prelude::*;
use rustfft::num_complex::Complex32;
use std::borrow::Cow;

/// Images of lenses that are computed at the same time take up to this many bytes, or one image a thread.
const MOST_GROUP_BYTES: usize = 4 << 20;

/// The plan of one lens.
#[derive(Clone, Debug)]
struct LensPlan {
    /// Sensor pixel of object pixel (0, 0).
    corner: [isize; 2],
    terms: LensTerms,
}

/// The terms of a lens.
#[derive(Clone, Debug)]
enum LensTerms {
    /// The same in all blocks, with the spectra of the basis PSFs, [k, spectrum].
    Kept(Vec<Complex32>, Terms),
    /// The same in all blocks; spectra are computed at each application.
    Everywhere(Terms),
    /// Those of each block; spectra are computed at each application.
    ByBlock(Vec<Terms>),
}

/// The planned operator A: object [object rows, object cols] -> light on the sensor [sensor rows, sensor cols].
///
/// Units: DN above black for an object in the session's light unit, at the exposure of the calibration.
#[derive(Clone, Debug)]
pub struct LowRankOperator {
    object: [usize; 2],
    tiling: Tiling,
    products: Products,
    lenses: Vec<Option<LensPlan>>,
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
        let terms_of = |(l, shift): (usize, &[f64; 2])| {
            (!rays.dead[l]).then(|| Terms {
                kernels: shifted_windows(psf.basis.index_axis(Axis(0), l), shift.map(|d| d - d.round()), margin),
                coefficients: psf.coefficients.slice(s![l, .., config.depth, .., ..]).to_owned(),
            })
        };
        let all: Vec<Option<Terms>> = moves.par_iter().enumerate().map(terms_of).collect();
        let row_taps = Taps::for_pixels(&psf.node_rows_px, object[0]);
        let coarse = Tiling::coarse(object, window, config.max_transform_px);
        let [rows, cols] = coarse.transform;
        let bytes = moves.len() * psf.basis.dim().1 * rows * (cols / 2 + 1) * size_of::<Complex32>();
        let kept = bytes <= config.most_spectra_bytes;
        let local = if kept || config.most_error <= 0.0 {
            None
        } else {
            let col_taps = Taps::for_pixels(&psf.node_cols_px, object[1]);
            let candidates = Tiling::candidates(object, window, config.max_transform_px);
            let at = Interpolation { rows: &row_taps, cols: &col_taps };
            // What is not finite has no local terms, and is found where the operator is used.
            decompose(&all, at, (coarse, candidates), config.most_error).unwrap_or(None)
        };
        let (tiling, local) = local.map_or((coarse, None), |(tiling, terms)| (tiling, Some(terms)));
        let products = Products {
            sensor,
            window,
            fft: RealFft2::new(tiling.transform[0], tiling.transform[1]),
            row_taps,
            col_taps: TapRow::for_pixels(&psf.node_cols_px, object[1]),
        };
        let terms: Vec<Option<LensTerms>> = match local {
            Some(local) => local.into_iter().map(|t| (!t.is_empty()).then_some(LensTerms::ByBlock(t))).collect(),
            None if !kept => all.into_iter().map(|t| t.map(LensTerms::Everywhere)).collect(),
            None => {
                let keep = |t: Terms| LensTerms::Kept(products.spectra(t.kernels.view()), t);
                all.into_par_iter().map(|t| t.map(keep)).collect()
            }
        };
        let corner = |l: usize| {
            [0, 1].map(|a| (calibrated.anchors_px[l][a] - centre[a]).round() as isize + moves[l][a].round() as isize)
        };
        let lens = |(l, terms): (usize, Option<LensTerms>)| terms.map(|terms| LensPlan { corner: corner(l), terms });
        Ok(Self { object, tiling, products, lenses: terms.into_iter().enumerate().map(lens).collect() })
    }

    /// Rows and columns of objects.
    pub fn object_shape(&self) -> [usize; 2] {
        self.object
    }

    /// Rows and columns of frames.
    pub fn sensor_shape(&self) -> [usize; 2] {
        self.products.sensor
    }

    /// Number of lenses, dead ones counted.
    pub fn lenses(&self) -> usize {
        self.lenses.len()
    }

    /// Sensor pixel of object pixel (0, 0) behind each lens; None: dead.
    pub fn corners(&self) -> Vec<Option<[isize; 2]>> {
        self.lenses.iter().map(|l| l.as_ref().map(|plan| plan.corner)).collect()
    }

    /// Rows and columns of a transform, and the number of terms of each living lens in each block, by lens and then by
    /// block, row by row: what an application costs.
    pub fn cost(&self) -> ([usize; 2], Vec<Vec<usize>>) {
        let blocks = self.tiling.blocks().count();
        let of = |plan: &LensPlan| match &plan.terms {
            LensTerms::Kept(_, terms) | LensTerms::Everywhere(terms) => vec![terms.coefficients.dim().0; blocks],
            LensTerms::ByBlock(terms) => terms.iter().map(|t| t.coefficients.dim().0).collect(),
        };
        (self.tiling.transform, self.lenses.iter().flatten().map(of).collect())
    }

    /// A x: the light of all lenses on the sensor, DN above black, [sensor rows, sensor cols], for an object
    /// [object rows, object cols].
    ///
    /// # Errors
    /// The object does not have the planned shape.
    pub fn apply(&self, object: ArrayView2<'_, f32>) -> Result<Array2<f32>, OperatorError> {
        let mut frame = Array2::zeros(self.products.sensor);
        self.each_lens(object, |_, image| image.add_to(&mut frame))?;
        Ok(frame)
    }

    /// Calls `take` with the image of each living lens, in the order of the lenses. The images in memory at a
    /// time take 4 MiB, or one image a thread.
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

    /// Lenses that are computed at the same time: as many as there are threads, or more where their images are small,
    /// so that no thread waits; one where the spectra of all its terms are recomputed.
    fn groups(&self) -> impl Iterator<Item = Span> + use<> {
        let made = self.lenses.iter().flatten().any(|plan| matches!(plan.terms, LensTerms::Everywhere(_)));
        let image: usize = self.object.iter().map(|n| n + self.products.window - 1).product();
        let small = MOST_GROUP_BYTES / (image * size_of::<f32>());
        let (n, size) = (self.lenses.len(), if made { 1 } else { rayon::current_num_threads().max(small).max(1) });
        (0..n).step_by(size).map(move |first| first..(first + size).min(n))
    }

    /// A' y: the exact transpose, from a frame [sensor rows, sensor cols] to the object grid [object rows, object
    /// cols].
    ///
    /// # Errors
    /// The frame does not have the planned shape.
    pub fn adjoint(&self, frame: ArrayView2<'_, f32>) -> Result<Array2<f32>, OperatorError> {
        same_shape("frame", self.products.sensor, frame.dim())?;
        let mut object = Array2::zeros(self.object);
        let blocks: Vec<Block> = self.tiling.blocks().collect();
        for group in self.groups() {
            let plans: Vec<&LensPlan> = group.filter_map(|l| self.lenses[l].as_ref()).collect();
            let spectra: Vec<_> = plans.iter().map(|plan| self.spectra(plan)).collect();
            let tasks: Vec<_> = (0..plans.len()).flat_map(|p| (0..blocks.len()).map(move |b| (p, b))).collect();
            let part = |w: &mut Work, &(p, b): &(usize, usize)| {
                self.products.adjoint(plans[p].block(b, &spectra[p]), &blocks[b], frame, w)
            };
            let parts: Vec<_> = tasks.par_iter().map_init(|| self.products.work(), part).collect();
            for ((_, b), part) in tasks.iter().zip(parts) {
                let (r, c) = &blocks[*b];
                let mut target = object.slice_mut(s![r.clone(), c.clone()]);
                part.iter().for_each(|part| target += part);
            }
        }
        Ok(object)
    }

    fn lens_image(&self, plan: &LensPlan, object: ArrayView2<'_, f32>) -> LensImage {
        let blocks: Vec<Block> = self.tiling.blocks().collect();
        let spectra = self.spectra(plan);
        let part = |work: &mut Work, (b, block): (usize, &Block)| {
            self.products.forward(plan.block(b, &spectra), block, object, work)
        };
        let parts: Vec<Array2<f32>> = blocks.par_iter().enumerate().map_init(|| self.products.work(), part).collect();
        let [rows, cols] = self.object.map(|n| n + self.products.window - 1);
        let mut light = Array2::zeros((rows, cols));
        for ((r, c), part) in blocks.iter().zip(parts) {
            let mut target = light.slice_mut(s![r.start..r.start + part.nrows(), c.start..c.start + part.ncols()]);
            target += &part;
        }
        let half = (self.products.window / 2) as isize;
        LensImage { origin: plan.corner.map(|c| c - half), light }
    }

    /// Spectra of the basis PSFs that all blocks of a lens share, [k, spectrum]; empty where they share none.
    fn spectra<'a>(&self, plan: &'a LensPlan) -> Cow<'a, [Complex32]> {
        match &plan.terms {
            LensTerms::Kept(spectra, _) => Cow::Borrowed(spectra),
            LensTerms::Everywhere(terms) => Cow::Owned(self.products.spectra(terms.kernels.view())),
            LensTerms::ByBlock(_) => Cow::Borrowed(&[]),
        }
    }
}

impl LensPlan {
    /// The terms in block `b`, where `spectra` are those that all blocks share.
    fn block<'a>(&'a self, b: usize, spectra: &'a [Complex32]) -> BlockTerms<'a> {
        let (terms, spectra) = match &self.terms {
            LensTerms::Kept(_, terms) | LensTerms::Everywhere(terms) => (terms, Some(spectra)),
            LensTerms::ByBlock(terms) => (&terms[b], None),
        };
        BlockTerms { corner: self.corner, windows: &terms.kernels, spectra, coefficients: &terms.coefficients }
    }
}

fn same_shape(what: &'static str, expected: [usize; 2], found: (usize, usize)) -> Result<(), OperatorError> {
    let found = [found.0, found.1];
    if expected == found { Ok(()) } else { Err(OperatorError::Shape { what, expected, found }) }
}
