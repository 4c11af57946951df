//! The planned operator: which terms each lens has in each block, and how lenses and blocks are shared out.

use super::blocks::LocalTerms;
use super::config::{CalibratedOptics, OperatorConfig, check};
use super::error::OperatorError;
use super::image::LensImage;
use super::lenses::{LensTerms, adjoint, each_image};
use super::local::{Functions, Interpolation, decompose};
use super::products::Products;
use super::terms::{Lens, Terms};
use super::tiling::{Block, Tiling};
use crate::psf::chief_rays::ChiefRays;
use crate::psf::nodes::{TapRow, Taps};
use crate::psf::shift::shifted_windows;
use ndarray::{Array2, ArrayView2, Axis, s};
use ommatidia_physics::fft2::RealFft2;
use rayon::prelude::*;
use rustfft::num_complex::Complex32;

/// Most memory for the spectra of the basis PSFs of all lenses where these share functions, bytes.
const MOST_LOCAL_BYTES: usize = 1 << 30;

/// How the PSFs of the living lenses are held.
#[derive(Clone, Debug)]
enum Held {
    /// The terms of each lens over the whole object.
    EachLens(Vec<LensTerms>),
    /// Functions that the lenses share in each block.
    Local(LocalTerms),
}

/// The planned operator A: object [object rows, object cols] -> light on the sensor [sensor rows, sensor cols].
///
/// Units: DN above black for an object in the session's light unit, at the exposure of the calibration.
#[derive(Clone, Debug)]
pub struct LowRankOperator {
    object: [usize; 2],
    tiling: Tiling,
    products: Products,
    lenses: usize,
    held: Held,
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
        let lens_of = |(index, shift): (usize, &[f64; 2])| {
            (!rays.dead[index]).then(|| Lens {
                index,
                corner: [0, 1].map(|a| {
                    (calibrated.anchors_px[index][a] - centre[a]).round() as isize + shift[a].round() as isize
                }),
                terms: Terms {
                    kernels: shifted_windows(
                        psf.basis.index_axis(Axis(0), index),
                        shift.map(|d| d - d.round()),
                        margin,
                    ),
                    coefficients: psf.coefficients.slice(s![index, .., config.depth, .., ..]).to_owned(),
                },
            })
        };
        let lenses: Vec<Lens> = moves.par_iter().enumerate().filter_map(lens_of).collect();
        let row_taps = Taps::for_pixels(&psf.node_rows_px, object[0]);
        let coarse = Tiling::coarse(object, window, config.max_transform_px);
        let [rows, cols] = coarse.transform;
        let bytes = moves.len() * psf.basis.dim().1 * rows * (cols / 2 + 1) * size_of::<Complex32>();
        let kept = bytes <= config.most_spectra_bytes;
        let local = if kept || config.most_error <= 0.0 {
            None
        } else {
            let fits = |t: &Tiling| LocalTerms::bytes(t.transform, lenses.len(), psf.basis.dim().1) <= MOST_LOCAL_BYTES;
            let mut candidates = Tiling::candidates(object, window, config.max_transform_px);
            candidates.retain(fits);
            let at = Interpolation { rows: &row_taps, cols: &Taps::for_pixels(&psf.node_cols_px, object[1]) };
            // What is not finite has no functions, and is found where the operator is used.
            decompose(&lenses, at, (coarse, candidates), config.most_error).unwrap_or(None)
        };
        let (tiling, local) = local.map_or((coarse, None), |(tiling, functions)| (tiling, Some(functions)));
        let products = Products {
            sensor,
            window,
            fft: RealFft2::new(tiling.transform[0], tiling.transform[1]),
            row_taps,
            col_taps: TapRow::for_pixels(&psf.node_cols_px, object[1]),
        };
        let held = match local {
            Some(functions) => Held::Local(LocalTerms::new(&products, lenses, functions)),
            None => {
                let plan = |lens: Lens| {
                    let spectra = kept.then(|| products.spectra(lens.terms.kernels.view()));
                    LensTerms { lens, spectra }
                };
                Held::EachLens(lenses.into_par_iter().map(plan).collect())
            }
        };
        Ok(Self { object, tiling, products, lenses: moves.len(), held })
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
        self.lenses
    }

    /// Sensor pixel of object pixel (0, 0) behind each lens; None: dead.
    pub fn corners(&self) -> Vec<Option<[isize; 2]>> {
        let mut corners = vec![None; self.lenses];
        let mut set = |lens: &Lens| corners[lens.index] = Some(lens.corner);
        match &self.held {
            Held::EachLens(lenses) => lenses.iter().for_each(|of| set(&of.lens)),
            Held::Local(local) => local.lenses.iter().for_each(set),
        }
        corners
    }

    /// Rows and columns of a transform, and the number of transforms of each block of an object, row by row: what an
    /// application costs.
    pub fn cost(&self) -> ([usize; 2], Vec<usize>) {
        let transforms = match &self.held {
            Held::EachLens(lenses) => {
                vec![lenses.iter().map(|of| of.lens.terms.count()).sum(); self.tiling.blocks().count()]
            }
            Held::Local(local) => local.functions.iter().map(Functions::count).collect(),
        };
        (self.tiling.transform, transforms)
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
    /// time take 4 MiB, or one image a thread; all images where the lenses share functions.
    ///
    /// # Errors
    /// The object does not have the planned shape.
    pub fn each_lens(
        &self,
        object: ArrayView2<'_, f32>,
        mut take: impl FnMut(usize, LensImage),
    ) -> Result<(), OperatorError> {
        same_shape("object", self.object, object.dim())?;
        let blocks: Vec<Block> = self.tiling.blocks().collect();
        match &self.held {
            Held::EachLens(lenses) => each_image(lenses, (&self.products, &blocks), object, take),
            Held::Local(local) => {
                let images = local.images(&self.products, &blocks, object);
                for (of, light) in local.lenses.iter().zip(images) {
                    take(of.index, self.products.placed(of.corner, light));
                }
            }
        }
        Ok(())
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
        match &self.held {
            Held::EachLens(lenses) => adjoint(lenses, (&self.products, &blocks), frame, &mut object),
            Held::Local(local) => local.adjoint(&self.products, &blocks, frame, &mut object),
        }
        Ok(object)
    }
}

fn same_shape(what: &'static str, expected: [usize; 2], found: (usize, usize)) -> Result<(), OperatorError> {
    let found = [found.0, found.1];
    if expected == found { Ok(()) } else { Err(OperatorError::Shape { what, expected, found }) }
}
