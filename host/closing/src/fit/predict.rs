//! The frames that a state predicts, with their noise and residuals.

use super::model::{Model, SMOOTH_PX, smooth};
use super::state::{Predicted, State};
use crate::data::{Frame, Shown};
use ndarray::{Array2, Zip};
use ommatidia_model::forward::SceneLight;
use ommatidia_physics::effects::{Chain, blur_within};
use rayon::prelude::*;

/// Standard deviation of the Gaussian blur that spreads the light of a bead for the error of its PSF, pixels: a focus
/// may err beside its light, too.
const PSF_ERROR_PX: f64 = 1.0;

impl Model<'_> {
    /// Predicts every frame. `scenes` are those of [`Model::scenes`] for the same state.
    pub fn predict(&self, state: &State, scenes: &[Option<SceneLight>]) -> Vec<Predicted> {
        let (whole, of_grid) = (self.chain(&state.terms), self.chain_of_grid(&state.terms));
        let of_flats = self.chain_of_flats(&state.terms);
        let chain_of = |f: &Frame| match f.shown {
            Shown::Unknown => &of_grid,
            Shown::Even => &of_flats,
            _ => &whole,
        };
        // The noise model is that of the calibration: a fit must not gain by a larger variance.
        let noise = self.forward.noise();
        let alone: Vec<Alone> = (0..self.seen.frames.len())
            .into_par_iter()
            .map(|k| {
                let f = &self.seen.frames[k];
                let chain = chain_of(f);
                let mut scale = state.scale[f.stack];
                let mut sum = self.sum_e(k, scenes[k].as_ref(), (chain, state), scale);
                if matches!(f.shown, Shown::Bead(..)) {
                    let own = self.own_scale(k, &sum, state, chain);
                    scale *= own;
                    sum *= own as f32;
                }
                let wings = self.wings_e(k, &sum, state);
                let light = self.lit_with(k, (sum.clone(), wings.as_ref()), state, (chain, None));
                Alone { sum_e: sum, wings_e: wings, light_e: light, scale }
            })
            .collect();
        // Outside of a region what estimates leave is no residual.
        let region = self.seen.is_part().then(|| self.seen.used());
        let mut predicted: Vec<Predicted> = alone
            .par_iter()
            .enumerate()
            .map(|(k, Alone { sum_e, wings_e, light_e: alone_e, scale })| {
                let f = &self.seen.frames[k];
                let chain = chain_of(f);
                let previous = f.previous.filter(|_| chain.needs_previous()).map(|p| &alone[p].light_e);
                let light_e = match previous {
                    None => alone_e.clone(),
                    Some(_) => self.lit_with(k, (sum_e.clone(), wings_e.as_ref()), state, (chain, previous)),
                };
                let dn = self.dn(k, light_e.clone(), chain, previous, state.black_dn);
                let (mut residual_dn, detail) = residual(f, &dn);
                let top = noise.saturation_dn;
                let mut inverse_sigma = Array2::zeros(dn.dim());
                let region = region.as_ref().filter(|_| f.shown == Shown::Estimated);
                let mut variance = match state.specimens.as_ref().and_then(|s| s.sigma(k)) {
                    Some(sigma) => sigma * sigma,
                    None => self.variance_dn2(&light_e),
                };
                if state.terms.iter().any(|t| t.effect.bends_noise()) {
                    variance *= &self.bent(k, &light_e, &variance, (chain, previous));
                }
                if matches!(f.shown, Shown::Bead(..)) {
                    self.add_psf_error(&mut variance, &light_e);
                }
                Zip::from(&mut inverse_sigma).and(&dn).and(&detail).and(&mut residual_dn).and(&variance).for_each(
                    |w, &mu, &v, r, &variance| {
                        let sigma = (f64::from(variance) + f64::from(v)).sqrt();
                        // Pixels that may saturate are not used. The model selects them, since a selection by the noisy
                        // values would be biased.
                        let usable = f64::from(mu) + 4.0 * sigma < top && r.is_finite();
                        *w = if usable { (1.0 / sigma) as f32 } else { 0.0 };
                        if !usable {
                            *r = 0.0;
                        }
                    },
                );
                if let Some(region) = region {
                    inverse_sigma *= region;
                }
                Predicted {
                    sum_e: sum_e.clone(),
                    wings_e: wings_e.clone(),
                    alone_e: previous.map(|_| alone_e.clone()),
                    light_e,
                    dn,
                    inverse_sigma,
                    residual_dn,
                    scale: *scale,
                }
            })
            .collect();
        if let Some(specimens) = &state.specimens {
            let frames = predicted.iter_mut().zip(&self.seen.frames).filter(|(_, f)| f.shown == Shown::Estimated);
            let mut residuals: Vec<&mut Array2<f32>> = frames.map(|(p, _)| &mut p.residual_dn).collect();
            specimens.remove(&mut residuals);
            if let Some(region) = &region {
                residuals.into_iter().for_each(|r| *r *= region);
            }
        }
        predicted
    }

    /// By how much a chain of effects multiplies the variance of noise that comes before it: the square of its mean
    /// slope over the noise, from one standard deviation below the light to one above.
    fn bent(
        &self,
        k: usize,
        light_e: &Array2<f32>,
        variance_dn2: &Array2<f32>,
        (chain, previous): (&Chain, Option<&Array2<f32>>),
    ) -> Array2<f32> {
        let sigma_e = variance_dn2.mapv(|v| v.max(0.0).sqrt() / self.forward.noise().gain_dn_per_e as f32);
        let [low, high] = [-1.0f32, 1.0].map(|way| self.dn(k, light_e + &sigma_e * way, chain, previous, 0.0));
        let mut slope = high - low;
        let gain = self.forward.noise().gain_dn_per_e as f32;
        slope.zip_mut_with(&sigma_e, |d, s| *d = (*d / (2.0 * gain * s).max(f32::MIN_POSITIVE)).powi(2));
        slope
    }

    /// Variance of the noise of frames with an expected light, DN^2, [sensor rows, sensor cols]. The fixed pattern of
    /// the offset is no noise: the variance depends on the light alone.
    pub(super) fn variance_dn2(&self, light_e: &Array2<f32>) -> Array2<f32> {
        let noise = self.forward.noise();
        let of_light = |e: &f32| noise.variance_dn2(noise.black_level_dn + noise.gain_dn_per_e * f64::from(*e)) as f32;
        let mut variance = light_e.map(of_light);
        if let Some(reading) = self.forward.reading_dn2() {
            // The read noise of single pixels beyond the common read noise.
            let common = noise.variance_dn2(noise.black_level_dn) as f32;
            variance.zip_mut_with(reading, |v, r| *v += r - common);
        }
        variance
    }

    /// Adds to a variance what errors of the PSFs make of it in the frame of a single bead.
    fn add_psf_error(&self, variance: &mut Array2<f32>, light_e: &Array2<f32>) {
        let error = self.psf_error * self.forward.noise().gain_dn_per_e;
        let light2 = blur_within(&light_e.mapv(|e| e * e), PSF_ERROR_PX);
        variance.zip_mut_with(&light2, |v, l2| *v += (error * error) as f32 * l2);
    }

    /// Light of a bead's frame over the expected light, by least squares: bead frames may have been normalised one by
    /// one. First all pixels count alike, then by their variance at the light that was found. What acts on the light on
    /// the sensor acts on the expected light, too.
    fn own_scale(&self, k: usize, sum_e: &Array2<f32>, state: &State, chain: &Chain) -> f64 {
        let (f, noise) = (&self.seen.frames[k], self.forward.noise());
        let lit = |scale: f64| self.lit_with(k, (sum_e * scale as f32, None), state, (chain, None));
        let dn = |light_e: Array2<f32>| self.dn(k, light_e, chain, None, state.black_dn);
        let dark = dn(lit(0.0));
        let usable = |(r, c): (usize, usize), y: f32| {
            f.cut.as_ref().is_none_or(|cut| cut.holds(r, c)) && f64::from(y) < noise.saturation_dn
        };
        let (mut scale, mut variance) = (1.0, Array2::ones(sum_e.dim()));
        for _ in 0..2 {
            let (mut top, mut bottom) = (0.0, 0.0);
            for (((at, y), mu), (dark, variance)) in
                f.measured.indexed_iter().zip(&dn(lit(scale))).zip(dark.iter().zip(&variance))
            {
                if usable(at, *y) {
                    let light = f64::from(mu - dark);
                    top += f64::from(y - dark) * light / f64::from(*variance);
                    bottom += light * light / f64::from(*variance);
                }
            }
            if !(bottom > 0.0 && top > 0.0) {
                break;
            }
            scale *= top / bottom;
            let light_e = lit(scale);
            variance = self.variance_dn2(&light_e);
            self.add_psf_error(&mut variance, &light_e);
        }
        scale
    }

    /// The expected frame `k` for a light on the sensor, DN.
    pub(super) fn dn(
        &self,
        k: usize,
        light_e: Array2<f32>,
        chain: &Chain,
        previous: Option<&Array2<f32>>,
        black_dn: f64,
    ) -> Array2<f32> {
        let mut dn = self.forward.frame_dn(light_e, chain, &self.context(k, previous));
        if black_dn != 0.0 {
            dn.mapv_inplace(|v| v + black_dn as f32);
        }
        dn
    }

    /// Reduces changes of expected frames, each with the number of its frame, to what the frames can show of them: all,
    /// or, for an estimated specimen, what no change of the specimen makes, or, for an unknown one, the sharp part. A
    /// change of the last that is mostly smooth cannot be distinguished from the specimen and becomes zero.
    pub fn visible<'a>(&self, state: &State, changes: impl Iterator<Item = (usize, &'a mut Array2<f32>)>) {
        let (mut of_estimated, mut of_unknown) = (Vec::new(), Vec::new());
        for (k, change) in changes {
            match (&self.seen.frames[k].shown, &state.specimens) {
                (Shown::Estimated, Some(_)) => of_estimated.push(change),
                (Shown::Unknown, _) => of_unknown.push(change),
                _ => {}
            }
        }
        if let Some(specimens) = &state.specimens {
            specimens.remove(&mut of_estimated);
        }
        let power = |image: &Array2<f32>| image.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>();
        of_unknown.into_par_iter().for_each(|change| {
            let sharp = &*change - &smooth(change);
            let is_smooth = power(&sharp) < 0.5 * power(change);
            *change = if is_smooth { Array2::zeros(sharp.dim()) } else { sharp };
        });
    }
}

/// What a state predicts for a frame before anything of the preceding frame is added to it; see [`Predicted`].
struct Alone {
    sum_e: Array2<f32>,
    wings_e: Option<Array2<f32>>,
    light_e: Array2<f32>,
    scale: f64,
}

/// Residual of a frame, DN (NaN where it was not measured), and the variance that the detail of an unknown specimen
/// adds, DN^2.
fn residual(f: &Frame, expected: &Array2<f32>) -> (Array2<f32>, Array2<f32>) {
    let mut difference = &f.measured - expected;
    if let Some(cut) = &f.cut {
        difference.indexed_iter_mut().filter(|((r, c), _)| !cut.holds(*r, *c)).for_each(|(_, v)| *v = f32::NAN);
    }
    if f.shown != Shown::Unknown {
        return (difference, Array2::zeros(expected.dim()));
    }
    let sharp = |image: &Array2<f32>| image - &smooth(image);
    // The detail of the specimen counts as noise: pixels with much of it get little weight.
    let detail = blur_within(&sharp(&f.measured).mapv(|v| v * v), 3.0 * SMOOTH_PX);
    (sharp(&difference), detail)
}
