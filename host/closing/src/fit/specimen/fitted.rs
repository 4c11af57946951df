//! Estimates the specimens of a session under a state.

use super::beside::beside;
use super::estimate::{AFTER_STRAY, BEFORE_STRAY, Estimate, Estimation};
use super::probe::probed;
use crate::data::{Observations, Shown};
use crate::fit::model::Model;
use crate::fit::projection::{Projector, Sigmas, Specimens};
use crate::fit::state::State;
use ndarray::Array2;
use ommatidia_model::forward::ForwardError;
use ommatidia_physics::effects::blur_within;
use ommatidia_session::rng::stream;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use std::sync::Arc;

/// Frames are blurred so far for their variances, pixels.
const SMOOTH_PX: f64 = 2.0;
/// Least variance of the read noise, electrons squared: Richardson-Lucy divides by it where no light is.
const LEAST_FLOOR_E2: f64 = 0.1;
/// Maximum number of times that the light outside the windows is taken out of the frames.
const STRAY_ROUNDS: usize = 8;
/// This ends where the mean square of its change is below this, in units of the variance of the noise.
const FAINT_STRAY: f32 = 1e-3;
/// Draws of noise for the expected squares of the residuals: of whole frames, and of a region, which has fewer pixels.
const DRAWS: [usize; 2] = [4, 16];

/// Estimates the specimens of all frames of [`Shown::Estimated`] under a state. None: there are none.
///
/// # Errors
/// The parts of the instrument disagree, or its optics hold no light.
pub(in crate::fit) fn specimens(model: &Model<'_>, state: &State) -> Result<Option<Arc<Specimens>>, ForwardError> {
    let seen = model.seen;
    let frames: Vec<usize> = (0..seen.frames.len()).filter(|k| seen.frames[*k].shown == Shown::Estimated).collect();
    if frames.is_empty() {
        return Ok(None);
    }
    let (chain, noise) = (model.chain(&state.terms), model.forward.noise());
    let views = probed(model, &state.terms, &frames, model.window_px)?;
    let mut weight = vec![0.0f32; seen.sensor[0] * seen.sensor[1]];
    for k in &frames {
        // Variances from the frame itself, blurred: here they are only weights.
        let level = blur_within(&seen.frames[*k].measured, SMOOTH_PX);
        for (w, y) in weight.iter_mut().zip(&level) {
            *w += 1.0 / (noise.variance_dn2(f64::from(*y).max(noise.black_level_dn)) as f32 * frames.len() as f32);
        }
    }
    let fitted = fitted(seen);
    for (p, w) in weight.iter_mut().enumerate() {
        let at = [p / seen.sensor[1], p % seen.sensor[1]];
        let clipped = |k: &usize| f64::from(seen.frames[*k].measured[at]) >= 0.99 * noise.saturation_dn;
        if !fitted[p] || frames.iter().any(clipped) {
            *w = 0.0;
        }
    }
    let projector = model.projectors.of(views, weight)?;
    let dark = |k: usize| model.lit(k, Array2::zeros((seen.sensor[0], seen.sensor[1])), state, (&chain, None));
    // Light that reads as it does under the effects of the sensor, electrons above the dark signal.
    let above_dark = |k: usize, dn: &Array2<f32>| {
        (dn - &model.dn(k, dark(k), &chain, None, state.black_dn)) / noise.gain_dn_per_e as f32
    };
    let bare = |k: &usize| above_dark(*k, &seen.frames[*k].measured);
    let light: Vec<Array2<f32>> = frames.iter().map(bare).collect();
    let floor_e2 = noise.read_noise_e.powi(2).max(LEAST_FLOOR_E2) as f32;
    // What falls outside the windows, of ghosts and halos for example, and what a bent response adds or takes, is no
    // light that a specimen has to explain. Each round multiplies what is left of it by about its share of all light.
    // Estimates that are not sharp yet show it well enough.
    let beside = match model.beside.get() {
        Some(found) => found,
        None => {
            let found = beside(model, &frames, &light)?;
            model.beside.get_or_init(|| found)
        }
    };
    let mut estimation = Estimation::new(projector.views(), projector.weight(), floor_e2, beside);
    estimation.go_on(&light, BEFORE_STRAY);
    let mut explained = Vec::new();
    let mut before = vec![Array2::zeros((seen.sensor[0], seen.sensor[1])); frames.len()];
    for _ in 0..STRAY_ROUNDS {
        let stray = |(k, of): (&usize, &Estimate)| -> Result<Array2<f32>, ForwardError> {
            let scene = model.scene_of(*k, &of.object, &chain)?;
            let sum = model.sum_e(*k, Some(&scene), (&chain, state), state.scale[seen.frames[*k].stack]);
            let lit = model.lit(*k, sum, state, (&chain, None));
            Ok(above_dark(*k, &model.dn(*k, lit, &chain, None, state.black_dn)) - &of.light_e)
        };
        let found = estimation.estimates();
        let strays: Vec<Array2<f32>> = frames.par_iter().zip(&found).map(stray).collect::<Result<_, _>>()?;
        let gain2 = (noise.gain_dn_per_e * noise.gain_dn_per_e) as f32;
        let in_noise = |(now, before): (&Array2<f32>, &Array2<f32>)| -> f32 {
            let pixels = now.iter().zip(before).zip(projector.weight());
            pixels.map(|((now, before), w)| (now - before).powi(2) * w * gain2).sum::<f32>() / seen.pixels.len() as f32
        };
        if strays.iter().zip(&before).all(|s| in_noise(s) < FAINT_STRAY) {
            break;
        }
        explained = light.iter().zip(&strays).map(|(light, stray)| light - stray).collect();
        estimation.go_on(&explained, AFTER_STRAY);
        before = strays;
    }
    if explained.is_empty() {
        estimation.finish(&light);
    } else {
        // The estimates under all states take the same iterations.
        estimation.begin_again();
        estimation.finish(&explained);
    }
    let found = estimation.estimates();
    // The noise is that of the first estimate under every state. What a specimen takes of the squares of a residual
    // differs from pixel to pixel, so a state could gain by moving light where much is taken.
    let sigmas = model.sigmas.get_or_init(|| {
        let mut sigmas = vec![None; seen.frames.len()];
        for (k, of) in frames.iter().zip(&found) {
            sigmas[*k] = Some(model.variance_dn2(&(&of.light_e + &dark(*k)).mapv(|e| e.max(0.0))).mapv(f32::sqrt));
        }
        Arc::new(sigmas)
    });
    let mut objects = vec![None; seen.frames.len()];
    frames.iter().zip(found).for_each(|(k, of)| objects[*k] = Some(of.object));
    let expected = projector.noise_left.get_or_init(|| noise_left(&projector, sigmas, seen)).clone();
    let it = Specimens { objects, projector, sigmas: Arc::clone(sigmas), expected };
    Ok(Some(Arc::new(it)))
}

/// [`Specimens::expected`] of all frames and blocks, from draws of the noise.
fn noise_left(projector: &Projector, sigmas: &Sigmas, seen: &Observations) -> Vec<Vec<f64>> {
    let of_frames: Vec<(usize, &Array2<f32>)> =
        sigmas.iter().enumerate().filter_map(|(k, sigma)| Some((k, sigma.as_ref()?))).collect();
    let draws = DRAWS[usize::from(seen.is_part())];
    let draw = |(k, sigma): (usize, &Array2<f32>), i: usize| {
        let mut rng = stream(0x5eed, "specimen", (draws * k + i) as u64);
        sigma.mapv(|s| {
            let unit: f32 = StandardNormal.sample(&mut rng);
            unit * s
        })
    };
    let mut drawn: Vec<Array2<f32>> = of_frames.iter().flat_map(|of| (0..draws).map(|i| draw(*of, i))).collect();
    projector.remove(&mut drawn.iter_mut().collect::<Vec<_>>());
    let mut expected = vec![Vec::new(); seen.frames.len()];
    for ((k, sigma), drawn) in of_frames.into_iter().zip(drawn.chunks_exact(draws)) {
        let left = |span: &std::ops::Range<usize>| {
            let at = |p: &u32| (*p as usize / seen.sensor[1], *p as usize % seen.sensor[1]);
            let pixels = &seen.pixels[span.clone()];
            let square = |p: &u32| drawn.iter().map(|d| f64::from(d[at(p)] / sigma[at(p)]).powi(2)).sum::<f64>();
            pixels.iter().map(square).sum::<f64>() / (draws * pixels.len()).max(1) as f64
        };
        expected[k] = seen.blocks.iter().map(left).collect();
    }
    expected
}

/// Whether each pixel of the sensor is used, and not in a held-out block.
fn fitted(seen: &Observations) -> Vec<bool> {
    let mut fitted = vec![false; seen.sensor[0] * seen.sensor[1]];
    for (span, _) in seen.blocks.iter().zip(&seen.held_out_blocks).filter(|(_, held_out)| !**held_out) {
        seen.pixels[span.clone()].iter().for_each(|p| fitted[*p as usize] = true);
    }
    fitted
}
