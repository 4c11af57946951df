//! The model that the loop closes: the instrument without its effects, and the frames of a session.

use super::lamp;
use super::projection::Sigmas;
use super::state::{Predicted, State, Term};
use super::truth::{Grid, PARTS, TRUTH};
use super::wings::{self, Ring};
use crate::data::{Frame, Observations, Shown};
use ndarray::{Array2, Zip};
use ommatidia_model::bead::slope_terms;
use ommatidia_model::forward::{Forward, ForwardError, SceneLight};
use ommatidia_model::instrument::Instrument;
use ommatidia_model::psf::OperatorConfig;
use ommatidia_physics::effects::{Chain, EffectError, EffectSetting, FrameContext, Param, Previous, blur_within, find};
use ommatidia_physics::noise::MapErrors;
use ommatidia_session::Role;
use rayon::prelude::*;
use std::borrow::Cow;
use std::sync::{Arc, OnceLock};

/// Depths closer than this are equal, um: tables are rounded to it.
const SAME_DEPTH_UM: f64 = 1e-3;
/// Standard deviation of the Gaussian blur that defines the smooth part of an unknown specimen, pixels.
const SMOOTH_PX: f64 = 2.0;
/// Standard deviation of the Gaussian blur that spreads the light of a bead for the error of its PSF, pixels: a focus
/// may err beside its light, too.
const PSF_ERROR_PX: f64 = 1.0;
/// PSFs that err by more are no approximation: what they lack is to be seen in the residual, and not excused.
const MOST_PSF_ERROR: f64 = 0.05;

/// Own defocus of the lenses that their pupils misjudge: fitted beside effects on the wavefront, and never a cause.
pub(crate) const PUPIL_DEFOCUS: &str = "pupil_defocus";

/// An instrument and the frames of a session.
pub struct Model<'a> {
    /// The forward model of the instrument without its effects.
    pub forward: Forward,
    /// The frames.
    pub seen: &'a Observations,
    /// Errors of the sensor maps of the instrument.
    pub maps: MapErrors,
    /// Whether the session may have a background of its own: the beads of the calibration had one. Its strength is then
    /// a nuisance, and no effect of the instrument.
    pub has_background: bool,
    /// The grid that truths live on.
    pub(crate) grid: Grid,
    /// Relative error of the PSFs between the positions of the beads that they were calibrated on, without noise. In
    /// the frame of a single bead nothing averages it.
    psf_error: f64,
    /// The same where it exceeds the noise of the bead frames; 0 where the calibration is as good as its noise allows.
    pub(crate) coarse_error: f64,
    /// Exposure of the calibration, ms.
    pub(crate) exposure_ms: f64,
    /// Rows and columns of the windows of the basis PSFs.
    pub(super) window_px: usize,
    /// Rings outside the windows whose light is fitted.
    pub(super) rings: Vec<Ring>,
    /// Noise of the frames whose specimens are estimated, from their first estimate.
    pub(super) sigmas: OnceLock<Arc<Sigmas>>,
}

impl<'a> Model<'a> {
    /// The model of a session's frames by an instrument.
    ///
    /// # Errors
    /// The tables of the instrument disagree in their sizes.
    pub fn new(instrument: &Instrument, seen: &'a Observations) -> Result<Self, ForwardError> {
        let bare = Instrument { effects: Vec::new(), ..instrument.clone() };
        // The depth of the first specimen; other depths are interpolated.
        let shows_object = |f: &&Frame| matches!(f.shown, Shown::Object(_) | Shown::Estimated);
        let z_um = seen.frames.iter().find(shows_object).map_or(0.0, |f| f.info.z_um);
        let depth = instrument.psf.depth_nearest(z_um);
        let quality = &instrument.quality;
        Ok(Self {
            forward: Forward::with_all_depths(&bare, OperatorConfig::exact(depth))?,
            seen,
            maps: instrument.quality.maps,
            has_background: instrument.quality.background.is_some_and(|b| b.is_seen()),
            grid: Grid::of(instrument),
            psf_error: quality.off_grid_excess().min(MOST_PSF_ERROR),
            coarse_error: if quality.is_coarse() { quality.off_grid_excess() } else { 0.0 },
            exposure_ms: instrument.psf.exposure_ms,
            window_px: instrument.psf.basis.dim().2,
            rings: wings::fitted(seen, instrument.psf.basis.dim().2 / 2, quality.outside_window),
            sigmas: OnceLock::new(),
        })
    }

    /// Whether the light of no frame is known. Then only effects that follow the pixel grid can be tested, since the
    /// specimen may have any other detail.
    pub fn is_blind(&self) -> bool {
        self.seen.frames.iter().all(|f| f.shown == Shown::Unknown)
    }

    /// Whether the light of any frame is known, an object, a bead, or even light, or estimated.
    pub fn sees_known_light(&self) -> bool {
        !self.seen.frames.iter().all(|f| matches!(f.shown, Shown::Dark | Shown::Unknown))
    }

    /// Number of lenses.
    pub fn lenses(&self) -> usize {
        self.forward.layout().lenses
    }

    /// The state of an instrument: its effects, with the light of each stack as calibrated or, for flats, as measured.
    ///
    /// # Errors
    /// The instrument names an effect that does not exist.
    pub fn state(&self, instrument: &Instrument) -> Result<State, EffectError> {
        let layout = self.forward.layout();
        Chain::build(&instrument.effects, layout)?;
        let term = |s: &EffectSetting| {
            let effect = find(&s.id)?;
            let value = |(name, p): (String, &Param)| s.params.get(&name).copied().unwrap_or(p.off);
            let params = effect.descriptor().expanded(layout.lenses).into_iter().map(value).collect();
            Some(Term { effect, params, table: s.table.clone(), table_error: 0.0 })
        };
        let stacks = self.seen.frames.iter().map(|f| f.stack + 1).max().unwrap_or(0);
        let mut scale = vec![1.0; stacks];
        for (s, scale) in scale.iter_mut().enumerate() {
            let (mut light, mut dose) = (0.0, 0.0);
            for f in self.seen.frames.iter().filter(|f| f.stack == s && f.role == Role::Flat && !f.held_out) {
                let mean = f.measured.mean().unwrap_or(0.0);
                light += f64::from(mean) - self.forward.noise().black_level_dn;
                dose += f.info.illumination * f.info.exposure_ms / self.exposure_ms;
            }
            if dose > 0.0 {
                *scale = (light / dose / self.forward.noise().gain_dn_per_e).max(1e-6);
            }
        }
        let mut terms: Vec<Term> = instrument.effects.iter().filter_map(term).collect();
        if self.seen.frames.iter().any(|f| matches!(f.shown, Shown::Object(_)))
            && !terms.iter().any(|t| t.id() == PUPIL_DEFOCUS)
        {
            terms.extend(term(&EffectSetting::new(PUPIL_DEFOCUS, &[])));
        }
        Ok(State {
            terms,
            scale,
            black_dn: 0.0,
            background_e: vec![[0.0; 3]; stacks],
            lamp: [0.0; lamp::TERMS],
            wings: vec![0.0; self.rings.len()],
            registration: vec![[0.0; PARTS]; self.seen.registrations.len()],
            specimens: None,
        })
    }

    /// The same state in a standard gauge: a common factor of an effect and of the light is moved to the light
    /// ([`ommatidia_physics::effects::Effect::gauge`]).
    pub fn gauged(&self, mut state: State) -> State {
        for t in &mut state.terms {
            let factor = t.effect.gauge(&mut t.params);
            let scenes = self.seen.frames.iter().filter(|f| matches!(f.shown, Shown::Object(_)));
            let stacks: std::collections::BTreeSet<usize> = scenes.map(|f| f.stack).collect();
            stacks.into_iter().for_each(|s| state.scale[s] *= factor);
        }
        state
    }

    /// The effects of terms as one chain of the forward model.
    pub fn chain<'t>(&self, terms: impl IntoIterator<Item = &'t Term>) -> Chain {
        let mut chain = Chain::default();
        for t in terms {
            // The tables of terms have the size of this sensor.
            let _ = chain.push(t.effect, t.params.clone(), t.table.as_ref(), self.forward.layout());
        }
        chain
    }

    /// The effects of terms that act on frame `k`. A frame of an unknown specimen that is not estimated is predicted by
    /// its own smooth part, which holds the work of the optics and of the sensor already: there, only what follows the
    /// pixel grid acts.
    pub(super) fn chain_of(&self, k: usize, terms: &[Term]) -> Chain {
        match self.seen.frames[k].shown {
            Shown::Unknown => self.chain_of_grid(terms),
            _ => self.chain(terms),
        }
    }

    fn chain_of_grid(&self, terms: &[Term]) -> Chain {
        self.chain(terms.iter().filter(|t| t.effect.is_of_the_grid() || t.effect.table().is_some()))
    }

    /// The context of frame `k` for the hooks of effects; `previous_e` is the light of the preceding frame, electrons.
    pub fn context<'c>(&'c self, k: usize, previous_e: Option<&'c Array2<f32>>) -> FrameContext<'c> {
        let f = &self.seen.frames[k];
        let before = f.previous.map(|p| self.seen.frames[p].info.time_s);
        FrameContext {
            role: f.role,
            frame: f.info.frame,
            time_s: f.info.time_s,
            exposure_ms: f.info.exposure_ms,
            illumination: if f.role == Role::Dark { 0.0 } else { f.info.illumination },
            temperature_c: f.info.temperature_c.unwrap_or(20.0),
            travel: if f.role == Role::Bead { f.info.travel } else { [0.0; 2] },
            previous: previous_e.zip(before).map(|(light_e, t)| Previous { light_e, interval_s: f.info.time_s - t }),
            ..self.forward.context()
        }
    }

    /// The light of each frame's object behind the optics, with the effects on the emission. None for flats, darks and
    /// unknown specimens that the state has not estimated.
    ///
    /// # Errors
    /// An object holds negative or non-finite light.
    pub fn scenes(&self, state: &State) -> Result<Vec<Option<SceneLight>>, ForwardError> {
        let chain = self.chain(&state.terms);
        (0..self.seen.frames.len()).into_par_iter().map(|k| self.scene(k, state, &chain)).collect()
    }

    /// That of frame `k` under a chain of effects, which may differ from that of the state.
    pub(super) fn scene(&self, k: usize, state: &State, chain: &Chain) -> Result<Option<SceneLight>, ForwardError> {
        match &self.seen.frames[k].shown {
            Shown::Object(truth) => self.scene_of(k, &self.seen.truths[*truth], chain).map(Some),
            Shown::Estimated => {
                let object = state.specimens.as_ref().and_then(|s| s.object(k));
                object.map(|o| self.scene_of(k, o, chain)).transpose()
            }
            Shown::Bead(at) => {
                let light = self.forward.point(*at, chain, &self.context(k, None))?;
                Ok(Some(light.at_depth(self.depth_of(k))))
            }
            Shown::Even | Shown::Dark | Shown::Unknown => Ok(None),
        }
    }

    /// The light of an object behind the optics in the place of that of frame `k`.
    pub(super) fn scene_of(&self, k: usize, object: &Array2<f32>, chain: &Chain) -> Result<SceneLight, ForwardError> {
        let scene = self.forward.scene(object.view(), chain, &self.context(k, None))?;
        Ok(scene.at_depth(self.depth_of(k)))
    }

    /// Depth of the object of frame `k`, um: as recorded, to the precision of a table.
    pub(super) fn depth_of(&self, k: usize) -> f64 {
        let (z, own) = (self.seen.frames[k].info.z_um, self.forward.depth_um());
        if (z - own).abs() < SAME_DEPTH_UM { own } else { z }
    }

    /// The effects of a chain on frame `k`, with the registration of its truth under a state.
    fn placed<'c>(&self, k: usize, state: &State, chain: &'c Chain) -> Cow<'c, Chain> {
        let registered = self.seen.registration_of(k).and_then(|g| state.registration.get(g));
        let Some(registered) = registered.filter(|r| **r != [0.0; PARTS]) else { return Cow::Borrowed(chain) };
        let mut placed = chain.clone();
        // It has no table, so that it fits every layout.
        let _ = placed.push(&TRUTH, self.grid.params(*registered), None, self.forward.layout());
        Cow::Owned(placed)
    }

    /// Light of frame `k` through one lens before the effects on the sensor, electrons, with the registration of its
    /// truth under a state.
    pub(super) fn lens_e(
        &self,
        k: usize,
        scene: &SceneLight,
        lens: usize,
        chain: &Chain,
        state: &State,
    ) -> Array2<f32> {
        let (cx, placed) = (self.context(k, None), self.placed(k, state, chain));
        self.forward.lens_e(scene, lens, &placed, &cx)
    }

    /// Light of frame `k` before the effects on the sensor, electrons, with the registration of its truth under a
    /// state.
    pub(super) fn sum_e(
        &self,
        k: usize,
        scene: Option<&SceneLight>,
        (chain, state): (&Chain, &State),
        scale: f64,
    ) -> Array2<f32> {
        let f = &self.seen.frames[k];
        let mut sum = Array2::zeros((self.seen.sensor[0], self.seen.sensor[1]));
        match (&f.shown, scene) {
            (Shown::Even, _) => {
                sum = lamp::light(sum.dim(), &state.lamp);
                sum *= (scale * f.info.illumination * f.info.exposure_ms / self.exposure_ms) as f32;
            }
            (Shown::Unknown, _) => {
                let noise = self.forward.noise();
                sum = smooth(&f.measured);
                sum.mapv_inplace(|y| ((f64::from(y) - noise.black_level_dn) / noise.gain_dn_per_e).max(0.0) as f32);
            }
            (Shown::Dark, _) | (_, None) => {}
            (_, Some(scene)) => {
                for l in 0..self.lenses() {
                    sum += &self.lens_e(k, scene, l, chain, state);
                }
                sum *= scale as f32;
            }
        }
        sum
    }

    /// Light on the sensor for the sum of all lenses, electrons: with the light outside the windows, the background of
    /// its stack and the effects that act on light.
    pub(super) fn lit(
        &self,
        k: usize,
        sum_e: Array2<f32>,
        state: &State,
        by: (&Chain, Option<&Array2<f32>>),
    ) -> Array2<f32> {
        let wings_e = self.wings_e(k, &sum_e, state);
        self.lit_with(k, (sum_e, wings_e.as_ref()), state, by)
    }

    /// Light outside the windows of the calibration for the sum of all lenses, electrons. None: the state has none.
    fn wings_e(&self, k: usize, sum_e: &Array2<f32>, state: &State) -> Option<Array2<f32>> {
        let known = matches!(self.seen.frames[k].shown, Shown::Object(_));
        known.then(|| wings::light(sum_e, &self.rings, state)).flatten()
    }

    /// [`Model::lit`] with the light outside the windows given.
    pub(super) fn lit_with(
        &self,
        k: usize,
        (mut sum_e, wings_e): (Array2<f32>, Option<&Array2<f32>>),
        state: &State,
        (chain, previous): (&Chain, Option<&Array2<f32>>),
    ) -> Array2<f32> {
        let f = &self.seen.frames[k];
        wings_e.into_iter().for_each(|light| sum_e += light);
        if let Some(slopes) = state.background_e.get(f.stack).filter(|s| **s != [0.0; 3]) {
            let share = f.info.exposure_ms / self.exposure_ms;
            let dim = sum_e.dim();
            sum_e.indexed_iter_mut().for_each(|((r, c), v)| {
                let here: f64 = slope_terms(dim, [r, c]).iter().zip(slopes).map(|(t, s)| t * s).sum();
                *v += (share * here) as f32;
            });
        }
        self.forward.on_sensor(sum_e, chain, &self.context(k, previous))
    }

    /// Predicts every frame. `scenes` are those of [`Model::scenes`] for the same state.
    pub fn predict(&self, state: &State, scenes: &[Option<SceneLight>]) -> Vec<Predicted> {
        let (whole, of_grid) = (self.chain(&state.terms), self.chain_of_grid(&state.terms));
        let chain_of = |f: &Frame| if f.shown == Shown::Unknown { &of_grid } else { &whole };
        // The noise model is that of the calibration: a fit must not gain by a larger variance.
        let noise = self.forward.noise();
        let alone: Vec<(Array2<f32>, Option<Array2<f32>>, Array2<f32>, f64)> = (0..self.seen.frames.len())
            .into_par_iter()
            .map(|k| {
                let f = &self.seen.frames[k];
                let chain = chain_of(f);
                let mut scale = state.scale[f.stack];
                let mut sum = self.sum_e(k, scenes[k].as_ref(), (chain, state), scale);
                if matches!(f.shown, Shown::Bead(..)) {
                    let own = self.own_scale(k, state, &sum);
                    scale *= own;
                    sum *= own as f32;
                }
                let wings = self.wings_e(k, &sum, state);
                let light = self.lit_with(k, (sum.clone(), wings.as_ref()), state, (chain, None));
                (sum, wings, light, scale)
            })
            .collect();
        let mut predicted: Vec<Predicted> = alone
            .par_iter()
            .enumerate()
            .map(|(k, (sum_e, wings_e, alone_e, scale))| {
                let f = &self.seen.frames[k];
                let chain = chain_of(f);
                let previous = f.previous.filter(|_| chain.needs_previous()).map(|p| &alone[p].2);
                let light_e = match previous {
                    None => alone_e.clone(),
                    Some(_) => self.lit_with(k, (sum_e.clone(), wings_e.as_ref()), state, (chain, previous)),
                };
                let dn = self.dn(k, light_e.clone(), chain, previous, state.black_dn);
                let (mut residual_dn, detail) = residual(f, &dn);
                let top = noise.saturation_dn;
                let mut inverse_sigma = Array2::zeros(dn.dim());
                let mut variance = match state.specimens.as_ref().and_then(|s| s.sigma(k)) {
                    Some(sigma) => sigma * sigma,
                    None => self.variance_dn2(&light_e),
                };
                if state.terms.iter().any(|t| t.effect.bends_noise()) {
                    variance *= &self.bent(k, &light_e, &variance, (chain, previous));
                }
                if matches!(f.shown, Shown::Bead(..)) {
                    let error = self.psf_error * noise.gain_dn_per_e;
                    let light2 = blur_within(&light_e.mapv(|e| e * e), PSF_ERROR_PX);
                    variance.zip_mut_with(&light2, |v, l2| *v += (error * error) as f32 * l2);
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
            specimens.remove(&mut frames.map(|(p, _)| &mut p.residual_dn).collect::<Vec<_>>());
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

    /// Light of a bead's frame over the expected light, by least squares: bead frames may have been normalised one by
    /// one.
    fn own_scale(&self, k: usize, state: &State, sum_e: &Array2<f32>) -> f64 {
        let (f, noise) = (&self.seen.frames[k], self.forward.noise());
        let slopes = state.background_e.get(f.stack).copied().unwrap_or_default();
        let gain = noise.gain_dn_per_e * f.info.exposure_ms / self.exposure_ms;
        let background = |at: (usize, usize)| {
            let terms = slope_terms(sum_e.dim(), [at.0, at.1]);
            gain * terms.iter().zip(&slopes).map(|(t, s)| t * s).sum::<f64>()
        };
        let (mut top, mut bottom) = (0.0, 0.0);
        let measured = |r: usize, c: usize| f.cut.as_ref().is_none_or(|cut| cut.holds(r, c));
        for ((at, y), e) in f.measured.indexed_iter().zip(sum_e).filter(|((at, _), _)| measured(at.0, at.1)) {
            top += (f64::from(*y) - noise.black_level_dn - background(at)) * f64::from(*e);
            bottom += f64::from(*e).powi(2) * noise.gain_dn_per_e;
        }
        if bottom > 0.0 && top > 0.0 { top / bottom } else { 1.0 }
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

    /// Reduces changes of the expected frame `k` to what the frame can show of them: all, or, for an estimated
    /// specimen, what no change of the specimen makes, or, for an unknown one, the sharp part. A change of the last
    /// that is mostly smooth cannot be distinguished from the specimen and becomes zero.
    pub fn visible(&self, k: usize, state: &State, changes: &mut [&mut Array2<f32>]) {
        match (&self.seen.frames[k].shown, &state.specimens) {
            (Shown::Estimated, Some(specimens)) => specimens.remove(changes),
            (Shown::Unknown, _) => {
                let power = |image: &Array2<f32>| image.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>();
                for change in changes {
                    let sharp = &**change - &smooth(change);
                    let is_smooth = power(&sharp) < 0.5 * power(change);
                    **change = if is_smooth { Array2::zeros(sharp.dim()) } else { sharp };
                }
            }
            _ => {}
        }
    }
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

/// The smooth part of a frame.
fn smooth(frame: &Array2<f32>) -> Array2<f32> {
    blur_within(frame, SMOOTH_PX)
}
