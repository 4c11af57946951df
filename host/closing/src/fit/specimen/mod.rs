//! Frames of unknown specimens: the object of each frame is one more thing that is fitted.
//!
//! The optics are written out as a matrix ([`views`]); what a change of the specimen can make is taken out of residuals
//! and signatures ([`projector`]), so that score tests and fits see what no specimen explains; an estimate of each
//! specimen ([`estimate`]) gives the signatures of the effects. `docs/closing.md` has the equations.

mod estimate;
mod projector;
#[cfg(test)]
mod tests;
mod views;

use super::model::Model;
use super::state::State;
use crate::data::{Observations, Shown};
use ndarray::Array2;
use ommatidia_model::forward::ForwardError;
use ommatidia_model::instrument::Instrument;
use ommatidia_physics::effects::blur_within;
use ommatidia_session::rng::stream;
use projector::Projector;
use rand_distr::{Distribution, StandardNormal};
use std::sync::Arc;
use views::Views;

/// Most object pixels whose normal matrix is factored: it takes 4 bytes for each pair, and half a gigabyte at most.
const MOST_UNKNOWNS: usize = 11_600;
/// Most frames whose specimens are estimated; of a longer recording frames are taken at even distances.
const MOST_FRAMES: usize = 8;
/// Frames are blurred so far for their variances, pixels.
const SMOOTH_PX: f64 = 2.0;
/// Least variance of the read noise, electrons squared: Richardson-Lucy divides by it where no light is.
const LEAST_FLOOR_E2: f64 = 0.1;
/// Draws of noise for the expected squares of the residuals.
const DRAWS: usize = 4;

/// Marks the frames of unknown specimens whose specimens are estimated: where no frame shows a known object, and object
/// and sensor have few enough pixels. Their hold-outs are spatial blocks, which other lenses show as well.
pub fn estimate_specimens(instrument: &Instrument, seen: &mut Observations) {
    let known = |shown: &Shown| matches!(shown, Shown::Object(_) | Shown::Bead(_));
    let [rows, cols] = [instrument.manifest.object.rows, instrument.manifest.object.cols];
    let sampled = seen.pixels.len() < seen.sensor[0] * seen.sensor[1];
    let impossible = instrument.sensor_only() || rows * cols > MOST_UNKNOWNS || sampled;
    if impossible || seen.frames.iter().any(|f| known(&f.shown)) {
        return;
    }
    let unknown: Vec<usize> = (0..seen.frames.len()).filter(|k| seen.frames[*k].shown == Shown::Unknown).collect();
    let Some(z_um) = unknown.first().map(|k| seen.frames[*k].info.z_um) else { return };
    let at_depth: Vec<usize> = unknown.into_iter().filter(|k| seen.frames[*k].info.z_um == z_um).collect();
    let n = at_depth.len();
    for i in 0..n.min(MOST_FRAMES) {
        let f = &mut seen.frames[at_depth[i * n / n.min(MOST_FRAMES)]];
        f.shown = Shown::Estimated;
        f.held_out = false;
    }
}

/// Estimated specimens, and what takes them out of the frames.
pub struct Specimens {
    /// For each frame its specimen, [object rows, object cols]; None: not estimated.
    objects: Vec<Option<Array2<f32>>>,
    projector: Projector,
    /// Mean square that noise alone leaves of a pixel after the projection, in units of its variance: for each frame,
    /// for each spatial block.
    expected: Vec<Vec<f64>>,
}

impl std::fmt::Debug for Specimens {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Specimens({})", self.objects.iter().flatten().count())
    }
}

impl Specimens {
    /// Estimates the specimens of all frames of [`Shown::Estimated`] under a state. None: there are none.
    ///
    /// # Errors
    /// The parts of the instrument disagree, or its optics hold no light.
    pub(super) fn of(model: &Model<'_>, state: &State) -> Result<Option<Arc<Self>>, ForwardError> {
        let seen = model.seen;
        let frames: Vec<usize> = (0..seen.frames.len()).filter(|k| seen.frames[*k].shown == Shown::Estimated).collect();
        let Some(middle) = frames.get(frames.len() / 2) else { return Ok(None) };
        let (chain, noise) = (model.chain(&state.terms), model.forward.noise());
        let views = Views::of(model, &chain, *middle, model.window_px)?;
        let gain = noise.gain_dn_per_e as f32;
        // Variances from the frames themselves, blurred: they are only weights.
        let sigma = |k: usize| {
            let level = blur_within(&seen.frames[k].measured, SMOOTH_PX);
            level.mapv(|y| noise.variance_dn2(f64::from(y).max(noise.black_level_dn)).sqrt() as f32)
        };
        let sigmas: Vec<Array2<f32>> = frames.iter().map(|k| sigma(*k)).collect();
        let mut weight = vec![0.0f32; seen.sensor[0] * seen.sensor[1]];
        for sigma in &sigmas {
            weight.iter_mut().zip(sigma).for_each(|(w, s)| *w += 1.0 / (s * s * frames.len() as f32));
        }
        let held_out = held_out(seen);
        for (p, w) in weight.iter_mut().enumerate() {
            let at = [p / seen.sensor[1], p % seen.sensor[1]];
            let clipped = |k: &usize| f64::from(seen.frames[*k].measured[at]) >= 0.99 * noise.saturation_dn;
            if held_out[p] || frames.iter().any(clipped) {
                *w = 0.0;
            }
        }
        let projector = Projector::of(views, weight)?;
        let bare = |k: &usize| {
            let dark = model.lit(*k, Array2::zeros((seen.sensor[0], seen.sensor[1])), state, (&chain, None));
            (&seen.frames[*k].measured - &model.dn(*k, dark, &chain, None, state.black_dn)) / gain
        };
        let light: Vec<Array2<f32>> = frames.iter().map(bare).collect();
        let floor_e2 = noise.read_noise_e.powi(2).max(LEAST_FLOOR_E2) as f32;
        let found = estimate::specimens(projector.views(), &light, projector.weight(), floor_e2);
        let mut objects = vec![None; seen.frames.len()];
        frames.iter().zip(found).for_each(|(k, object)| objects[*k] = Some(object));
        let mut it = Self { objects, projector, expected: vec![Vec::new(); seen.frames.len()] };
        for (k, sigma) in frames.iter().zip(&sigmas) {
            it.expected[*k] = it.noise_left(seen, *k, sigma);
        }
        Ok(Some(Arc::new(it)))
    }

    /// The estimated specimen of frame `k`.
    pub(super) fn object(&self, k: usize) -> Option<&Array2<f32>> {
        self.objects.get(k)?.as_ref()
    }

    /// Takes out of images what a change of the specimen can make.
    pub(crate) fn remove(&self, images: &mut [&mut Array2<f32>]) {
        self.projector.remove(images);
    }

    /// Mean square that noise alone leaves of a pixel of a block of frame `k`, in units of its variance.
    pub(crate) fn expected(&self, k: usize, block: usize) -> f64 {
        self.expected.get(k).and_then(|of| of.get(block)).copied().unwrap_or(1.0)
    }

    /// [`Self::expected`] of all blocks of a frame, from draws of its noise.
    fn noise_left(&self, seen: &Observations, k: usize, sigma: &Array2<f32>) -> Vec<f64> {
        let draw = |i: usize| {
            let mut rng = stream(0x5eed, "specimen", (DRAWS * k + i) as u64);
            sigma.mapv(|s| {
                let unit: f32 = StandardNormal.sample(&mut rng);
                unit * s
            })
        };
        let mut drawn: Vec<Array2<f32>> = (0..DRAWS).map(draw).collect();
        self.remove(&mut drawn.iter_mut().collect::<Vec<_>>());
        let left = |span: &std::ops::Range<usize>| {
            let at = |p: &u32| (*p as usize / seen.sensor[1], *p as usize % seen.sensor[1]);
            let pixels = &seen.pixels[span.clone()];
            let square = |p: &u32| drawn.iter().map(|d| f64::from(d[at(p)] / sigma[at(p)]).powi(2)).sum::<f64>();
            pixels.iter().map(square).sum::<f64>() / (DRAWS * pixels.len()).max(1) as f64
        };
        seen.blocks.iter().map(left).collect()
    }
}

/// What a session of estimated specimens can and cannot show.
pub(crate) const UNKNOWN_NOTE: &str = "the specimens are unknown: they were estimated from the frames, and everything \
                                       that another specimen could make as well is not testable; the figures are of \
                                       blocks of the frames that were left out of the estimates, and noise alone gives \
                                       a chi-squared of 1";

/// Whether each pixel of the sensor lies in a held-out block.
fn held_out(seen: &Observations) -> Vec<bool> {
    let ([rows, cols], side) = (seen.sensor, seen.blocks_per_side());
    let block = |p: usize| {
        let of = |at: usize, n: usize| (0..side).rfind(|b| b * n / side <= at).unwrap_or(0);
        of(p / cols, rows) * side + of(p % cols, cols)
    };
    (0..rows * cols).map(|p| seen.held_out_blocks[block(p)]).collect()
}
