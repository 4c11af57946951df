//! The image of an object through all lenses, and its transpose, with the terms of each lens over the whole object.

use super::image::{LensImage, Span};
use super::products::{BlockTerms, Products, Work};
use super::terms::Lens;
use super::tiling::Block;
use ndarray::{Array2, ArrayView2, s};
use rayon::prelude::*;
use rustfft::num_complex::Complex32;
use std::borrow::Cow;

/// Images of lenses that are computed at the same time take up to this many bytes, or one image a thread.
const MOST_GROUP_BYTES: usize = 4 << 20;

/// The terms of one living lens.
#[derive(Clone, Debug)]
pub(super) struct LensTerms {
    pub lens: Lens,
    /// Spectra of the basis PSFs, [k, spectrum]. None: they are computed at each application.
    pub spectra: Option<Vec<Complex32>>,
}

impl LensTerms {
    fn spectra(&self, products: &Products) -> Cow<'_, [Complex32]> {
        match &self.spectra {
            Some(kept) => Cow::Borrowed(kept),
            None => Cow::Owned(products.spectra(self.lens.terms.kernels.view())),
        }
    }

    fn block<'a>(&'a self, spectra: &'a [Complex32]) -> BlockTerms<'a> {
        BlockTerms { lens: &self.lens, spectra }
    }

    fn image(&self, products: &Products, blocks: &[Block], object: ArrayView2<'_, f32>) -> LensImage {
        let spectra = self.spectra(products);
        let part = |work: &mut Work, block: &Block| products.forward(self.block(&spectra), block, object, work);
        let parts: Vec<Array2<f32>> = blocks.par_iter().map_init(|| products.work(), part).collect();
        let mut light = Array2::zeros(products.image_shape(object.dim()));
        for (block, part) in blocks.iter().zip(parts) {
            products.add(&part, block, &mut light);
        }
        products.placed(self.lens.corner, light)
    }
}

/// Calls `take` with the image of each lens.
pub(super) fn each_image(
    lenses: &[LensTerms],
    (products, blocks): (&Products, &[Block]),
    object: ArrayView2<'_, f32>,
    mut take: impl FnMut(usize, LensImage),
) {
    let (rows, cols) = products.image_shape(object.dim());
    for group in groups(lenses, rows * cols * size_of::<f32>()) {
        let images: Vec<_> =
            lenses[group].par_iter().map(|of| (of.lens.index, of.image(products, blocks, object))).collect();
        images.into_iter().for_each(|(l, image)| take(l, image));
    }
}

/// The transpose: adds what all lenses collect from a frame to an object.
pub(super) fn adjoint(
    lenses: &[LensTerms],
    (products, blocks): (&Products, &[Block]),
    frame: ArrayView2<'_, f32>,
    object: &mut Array2<f32>,
) {
    let (rows, cols) = products.image_shape(object.dim());
    for group in groups(lenses, rows * cols * size_of::<f32>()) {
        let lenses = &lenses[group];
        let spectra: Vec<_> = lenses.iter().map(|of| of.spectra(products)).collect();
        let tasks: Vec<_> = (0..lenses.len()).flat_map(|l| (0..blocks.len()).map(move |b| (l, b))).collect();
        let part = |w: &mut Work, &(l, b): &(usize, usize)| {
            products.adjoint(lenses[l].block(&spectra[l]), &blocks[b], frame, w)
        };
        let parts: Vec<_> = tasks.par_iter().map_init(|| products.work(), part).collect();
        for ((_, b), part) in tasks.iter().zip(parts) {
            let (r, c) = &blocks[*b];
            let mut target = object.slice_mut(s![r.clone(), c.clone()]);
            part.iter().for_each(|part| target += part);
        }
    }
}

/// Lenses that are computed at the same time: as many as there are threads, or more where their images are small, so
/// that no thread waits; one where the spectra of all its terms are recomputed.
fn groups(lenses: &[LensTerms], image_bytes: usize) -> impl Iterator<Item = Span> + use<> {
    let made = lenses.iter().any(|of| of.spectra.is_none());
    let small = MOST_GROUP_BYTES / image_bytes.max(1);
    let (n, size) = (lenses.len(), if made { 1 } else { rayon::current_num_threads().max(small).max(1) });
    (0..n).step_by(size).map(move |first| first..(first + size).min(n))
}
