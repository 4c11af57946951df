//! Takes out of frames all that a change of the specimen can make.
//!
//! With A the optics and W weights of the pixels,
//! ```text
//! P v = v - A (A' W A + lambda 1)^-1 A' W v
//! ```
//! is zero for v = A x, up to lambda, whatever x is (variable projection: Golub & Pereyra, SIAM J. Numer. Anal. 10,
//! 413, 1973). W is zero in held-out blocks: there, P v is what the specimen as the other pixels show it does not
//! explain. One W serves all frames, so that one factor does: the specimen is taken out for any W; another W than the
//! inverse variance of a frame costs a little of the evidence only.

use super::normal::normal;
use super::products::LANES;
use super::views::Views;
use crate::fit::in_use::InUse;
use ndarray::Array2;
use ommatidia_physics::linalg::{Cholesky32, NotPositive};
use rayon::prelude::*;
use std::sync::{Arc, OnceLock};

/// lambda over the mean diagonal element of A' W A. What is left of a specimen has the norm `sqrt(lambda) / 2 |x|` at
/// most, far below the noise; single precision carries the factor.
const LAMBDA: f32 = 1e-4;

/// The projections of a model that are in use. States that differ in the sensor alone have the same optics, and its
/// factor takes most of the time.
#[derive(Default)]
pub(crate) struct Projectors(InUse<(), Projector>);

impl Projectors {
    /// The projection for optics and weights: one that is in use, or a new one.
    ///
    /// # Errors
    /// The optics hold non-finite values, or no light.
    pub(crate) fn of(&self, views: Views, weight: Vec<f32>) -> Result<Arc<Projector>, NotPositive> {
        if let Some(same) = self.0.find(|(), p| p.weight == weight && p.views == views) {
            return Ok(same);
        }
        let new = Arc::new(Projector::of(views, weight)?);
        self.0.add((), &new);
        Ok(new)
    }
}

/// The projection for one set of optics and weights.
pub(crate) struct Projector {
    views: Views,
    /// [sensor pixels].
    weight: Vec<f32>,
    factor: Cholesky32,
    /// [`super::Specimens::expected`], which is the same for all states of a model with these optics.
    pub(in crate::fit) noise_left: OnceLock<Vec<Vec<f64>>>,
}

impl Projector {
    /// Factors the normal matrix. `weight` holds the weights of the pixels, [sensor pixels]; 0: not used.
    ///
    /// # Errors
    /// The optics hold non-finite values, or no light.
    pub(crate) fn of(views: Views, weight: Vec<f32>) -> Result<Self, NotPositive> {
        let n = views.unknowns();
        let mut normal = normal(&views, &weight);
        let trace: f64 = (0..n).map(|i| f64::from(normal[i * (n + 1)])).sum();
        let lambda = (LAMBDA * (trace / n as f64) as f32).max(f32::MIN_POSITIVE);
        (0..n).for_each(|i| normal[i * (n + 1)] += lambda);
        let factor = Cholesky32::of(normal, n)?;
        Ok(Self { views, weight, factor, noise_left: OnceLock::new() })
    }

    /// Applies P to images in place, each [sensor rows, sensor cols].
    pub(crate) fn remove(&self, images: &mut [&mut Array2<f32>]) {
        let collected: Vec<Vec<f32>> = images.par_chunks(LANES).map(|group| self.collect(group)).collect();
        // All of them are solved at once, since that reads the factor once.
        let mut objects = collected.concat();
        self.factor.solve(&mut objects, images.len());
        let objects = objects.par_chunks(LANES * self.views.unknowns());
        images.par_chunks_mut(LANES).zip(objects).for_each(|(group, objects)| self.subtract(group, objects));
    }

    /// A' W v of at most [`LANES`] images, one after the other.
    fn collect(&self, images: &[&mut Array2<f32>]) -> Vec<f32> {
        match images.len() {
            ..=8 => self.collect_of::<8>(images),
            _ => self.collect_of::<LANES>(images),
        }
    }

    fn collect_of<const L: usize>(&self, images: &[&mut Array2<f32>]) -> Vec<f32> {
        let mut frames = vec![[0.0; L]; self.weight.len()];
        for (lane, image) in images.iter().enumerate() {
            for ((v, pixel), w) in image.iter().zip(&mut frames).zip(&self.weight) {
                pixel[lane] = v * w;
            }
        }
        let (right, n) = (self.views.adjoint(&frames), self.views.unknowns());
        let mut sums = vec![0.0; n * images.len()];
        for (x, v) in right.iter().enumerate() {
            let unknown = self.views.unknown(x);
            (0..images.len()).for_each(|lane| sums[lane * n + unknown] += v[lane]);
        }
        sums
    }

    /// Takes the light of objects, one after the other, out of at most [`LANES`] images.
    fn subtract(&self, images: &mut [&mut Array2<f32>], objects: &[f32]) {
        match images.len() {
            ..=8 => self.subtract_of::<8>(images, objects),
            _ => self.subtract_of::<LANES>(images, objects),
        }
    }

    fn subtract_of<const L: usize>(&self, images: &mut [&mut Array2<f32>], columns: &[f32]) {
        let mut objects = vec![[0.0; L]; self.views.pixels().len()];
        for (lane, column) in columns.chunks_exact(self.views.unknowns()).enumerate() {
            objects.iter_mut().enumerate().for_each(|(x, object)| object[lane] = column[self.views.unknown(x)]);
        }
        let light = self.views.forward(&objects);
        for (lane, image) in images.iter_mut().enumerate() {
            image.iter_mut().zip(&light).for_each(|(v, light)| *v -= light[lane]);
        }
    }

    /// The optics.
    pub(crate) fn views(&self) -> &Views {
        &self.views
    }

    /// The weights of the pixels, [sensor pixels].
    pub(crate) fn weight(&self) -> &[f32] {
        &self.weight
    }
}
