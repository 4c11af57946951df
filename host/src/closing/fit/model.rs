//! The model that is being closed: an instrument, the effects it has so far, and the nuisances of a session.

use super::state::{Column, Predicted, State, Term};
use crate::closing::data::{Frame, Observations, Shown};
use crate::effects::{Chain, EffectError, EffectSetting, FrameContext, Param, Previous, Stage, blur_within, find};
use crate::forward::{Forward, ForwardError, SceneLight};
use crate::instrument::Instrument;
use crate::noise::MapErrors;
use crate::psf::OperatorConfig;
use crate::session::Role;
use ndarray::{Array2, Zip};
use rayon::prelude::*;

/// Depths closer than this are the same, um: what tables round to.
const SAME_DEPTH_UM: f64 = 1e-3;
/// Standard deviation of the blur that an unknown specimen's smooth part is taken by, pixels.
const SMOOTH_PX: f64 = 2.0;

/// A session before an instrument.
pub struct Model<'a> {
    /// The forward model of the instrument without its effects.
    pub forward: Forward,
    /// The frames.
    pub seen: &'a Observations,
    /// What the maps of the sensor leave of its true patterns.
    pub maps: MapErrors,
    /// Exposure of the calibration, ms.
    exposure_ms: f64,
}

impl<'a> Model<'a> {
    /// Puts an instrument before a session's frames.
    ///
    /// # Errors
    /// The tables of the instrument disagree.
    pub fn new(instrument: &Instrument, seen: &'a Observations) -> Result<Self, ForwardError> {
        let bare = Instrument { effects: Vec::new(), ..instrument.clone() };
        // The plane that the first specimen is in; others are interpolated.
        let z_um = seen.frames.iter().find(|f| matches!(f.shown, Shown::Object(_))).map_or(0.0, |f| f.info.z_um);
        let depth = instrument.psf.depth_nearest(z_um);
        Ok(Self {
            forward: Forward::with_all_depths(&bare, OperatorConfig { depth, ..OperatorConfig::default() })?,
            seen,
            maps: instrument.quality.maps,
            exposure_ms: instrument.psf.exposure_ms,
        })
    }

    /// Whether nothing is known of any frame's light: a specimen has detail of every kind but that of the pixel grid.
    pub fn is_blind(&self) -> bool {
        self.seen.frames.iter().all(|f| f.shown == Shown::Unknown)
    }

    /// Number of lenses.
    pub fn lenses(&self) -> usize {
        self.forward.layout().lenses
    }

    /// The state that an instrument stands for: its effects, every light as calibrated.
    ///
    /// # Errors
    /// It names an effect that does not exist.
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
        Ok(State { terms: instrument.effects.iter().filter_map(term).collect(), scale, black_dn: 0.0 })
    }

    /// The same state with values that only its light can tell from others chosen by rule ([`crate::effects::Effect::gauge`]).
    pub fn gauged(&self, mut state: State) -> State {
        for t in &mut state.terms {
            let factor = t.effect.gauge(&mut t.params);
            let scenes = self.seen.frames.iter().filter(|f| matches!(f.shown, Shown::Object(_)));
            let stacks: std::collections::BTreeSet<usize> = scenes.map(|f| f.stack).collect();
            stacks.into_iter().for_each(|s| state.scale[s] *= factor);
        }
        state
    }

    /// The chain of terms.
    pub fn chain<'t>(&self, terms: impl IntoIterator<Item = &'t Term>) -> Chain {
        let mut chain = Chain::default();
        for t in terms {
            // The tables of terms are made for this sensor.
            let _ = chain.push(t.effect, t.params.clone(), t.table.as_ref(), self.forward.layout());
        }
        chain
    }

    /// What hooks are told of frame `k`; `previous_e` is the light of the frame before.
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
            previous: previous_e.zip(before).map(|(light_e, t)| Previous { light_e, interval_s: f.info.time_s - t }),
            ..self.forward.context()
        }
    }

    /// What the optics make of each frame's object, with the terms that act on emission. None: flats, darks, unknowns.
    ///
    /// # Errors
    /// An object is no light.
    pub fn scenes(&self, chain: &Chain) -> Result<Vec<Option<SceneLight>>, ForwardError> {
        (0..self.seen.frames.len()).into_par_iter().map(|k| self.scene(k, chain)).collect()
    }

    fn scene(&self, k: usize, chain: &Chain) -> Result<Option<SceneLight>, ForwardError> {
        let cx = self.context(k, None);
        match &self.seen.frames[k].shown {
            Shown::Object(truth) => {
                let scene = self.forward.scene(self.seen.truths[*truth].view(), chain, &cx)?;
                Ok(Some(scene.at_depth(self.depth_of(k))))
            }
            Shown::Bead(at) => Ok(Some(self.forward.point(*at, chain, &cx)?.at_depth(self.depth_of(k)))),
            Shown::Even | Shown::Dark | Shown::Unknown => Ok(None),
        }
    }

    /// Depth of what frame `k` shows, um: as the session says, and nothing finer than what a table is rounded to.
    fn depth_of(&self, k: usize) -> f64 {
        let (z, own) = (self.seen.frames[k].info.z_um, self.forward.depth_um());
        if (z - own).abs() < SAME_DEPTH_UM { own } else { z }
    }

    /// Light of frame `k` before what acts on it on the sensor, electrons.
    fn sum_e(&self, k: usize, scene: Option<&SceneLight>, chain: &Chain, scale: f64) -> Array2<f32> {
        let (f, cx) = (&self.seen.frames[k], self.context(k, None));
        let mut sum = Array2::zeros((self.seen.sensor[0], self.seen.sensor[1]));
        match (&f.shown, scene) {
            (Shown::Even, _) => sum.fill((scale * f.info.illumination * f.info.exposure_ms / self.exposure_ms) as f32),
            (Shown::Unknown, _) => {
                let noise = self.forward.noise();
                sum = smooth(&f.measured);
                sum.mapv_inplace(|y| ((f64::from(y) - noise.black_level_dn) / noise.gain_dn_per_e).max(0.0) as f32);
            }
            (Shown::Dark, _) | (_, None) => {}
            (_, Some(scene)) => {
                for l in 0..self.lenses() {
                    sum += &self.forward.lens_e(scene, l, chain, &cx);
                }
                sum *= scale as f32;
            }
        }
        sum
    }

    /// What a state predicts of every frame.
    pub fn predict(&self, state: &State, scenes: &[Option<SceneLight>]) -> Vec<Predicted> {
        let chain = self.chain(&state.terms);
        // Errors stay those of the calibration: a fit that may widen them would like nothing better.
        let noise = self.forward.noise();
        let n = self.seen.frames.len();
        let alone: Vec<(Array2<f32>, Array2<f32>, f64)> = (0..n)
            .into_par_iter()
            .map(|k| {
                let f = &self.seen.frames[k];
                let mut scale = state.scale[f.stack];
                let mut sum = self.sum_e(k, scenes[k].as_ref(), &chain, scale);
                if matches!(f.shown, Shown::Bead(..)) {
                    let own = self.own_scale(f, &sum);
                    scale *= own;
                    sum *= own as f32;
                }
                let light = self.forward.on_sensor(sum.clone(), &chain, &self.context(k, None));
                (sum, light, scale)
            })
            .collect();
        alone
            .par_iter()
            .enumerate()
            .map(|(k, (sum_e, alone_e, scale))| {
                let f = &self.seen.frames[k];
                let previous = f.previous.filter(|_| chain.needs_previous()).map(|p| &alone[p].1);
                let light_e = match previous {
                    None => alone_e.clone(),
                    Some(_) => self.forward.on_sensor(sum_e.clone(), &chain, &self.context(k, previous)),
                };
                let dn = self.dn(k, light_e.clone(), &chain, previous, state.black_dn);
                let (mut residual_dn, detail) = residual(f, &dn);
                let top = noise.saturation_dn;
                let mut inverse_sigma = Array2::zeros(dn.dim());
                // The fixed pattern of the offset makes no noise: the variance is that of the light.
                let mut variance = light_e
                    .mapv(|e| noise.variance_dn2(noise.black_level_dn + noise.gain_dn_per_e * f64::from(e)) as f32);
                if let Some(reading) = self.forward.reading_dn2() {
                    // What the reading of a pixel has beyond that of the others.
                    let common = self.forward.noise().variance_dn2(noise.black_level_dn) as f32;
                    variance.zip_mut_with(reading, |v, r| *v += r - common);
                }
                Zip::from(&mut inverse_sigma).and(&dn).and(&detail).and(&mut residual_dn).and(&variance).for_each(
                    |w, &mu, &v, r, &variance| {
                        let sigma = (f64::from(variance) + f64::from(v)).sqrt();
                        // What may touch the highest code says nothing; the model says which pixels, not the noise.
                        let usable = f64::from(mu) + 4.0 * sigma < top && r.is_finite();
                        *w = if usable { (1.0 / sigma) as f32 } else { 0.0 };
                        if !usable {
                            *r = 0.0;
                        }
                    },
                );
                Predicted {
                    sum_e: sum_e.clone(),
                    alone_e: previous.map(|_| alone_e.clone()),
                    light_e,
                    dn,
                    inverse_sigma,
                    residual_dn,
                    scale: *scale,
                }
            })
            .collect()
    }

    /// Light of a bead's frame over what is expected, by least squares: who measured single beads may have normalised each.
    fn own_scale(&self, f: &Frame, sum_e: &Array2<f32>) -> f64 {
        let noise = self.forward.noise();
        let (mut top, mut bottom) = (0.0, 0.0);
        let measured = |r: usize, c: usize| f.cut.as_ref().is_none_or(|cut| cut.holds(r, c));
        for ((_, y), e) in f.measured.indexed_iter().zip(sum_e).filter(|((at, _), _)| measured(at.0, at.1)) {
            top += (f64::from(*y) - noise.black_level_dn) * f64::from(*e);
            bottom += f64::from(*e).powi(2) * noise.gain_dn_per_e;
        }
        if bottom > 0.0 && top > 0.0 { top / bottom } else { 1.0 }
    }

    fn dn(
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

    /// How the expected frame changes with a column's value, per unit of it ([`Param::inner`] of a parameter), DN. None: not at all.
    ///
    /// # Errors
    /// An object is no light.
    pub fn derivative(
        &self,
        k: usize,
        column: &Column,
        state: &State,
        trials: &[Term],
        now: &[Predicted],
        scenes: &[Option<SceneLight>],
    ) -> Result<Option<Array2<f32>>, ForwardError> {
        let (f, here) = (&self.seen.frames[k], &now[k]);
        let previous = f.previous.map(|p| now[p].alone_e());
        let own = || self.chain(&state.terms);
        let (terms, which, param): (Vec<Term>, usize, usize) = match column {
            Column::Black => return Ok((f.shown != Shown::Unknown).then(|| Array2::ones(here.dn.dim()))),
            Column::Scale(stack) => {
                if *stack != f.stack || matches!(f.shown, Shown::Dark | Shown::Unknown) {
                    return Ok(None);
                }
                // A tenth of the noise of a bright pixel, far above rounding.
                let step = 1e-3;
                let chain = own();
                let more = 1.0 + step as f32;
                let before = previous.filter(|_| chain.needs_previous()).map(|p| p * more);
                let light = self.forward.on_sensor(&here.sum_e * more, &chain, &self.context(k, before.as_ref()));
                let moved = self.dn(k, light, &chain, before.as_ref(), state.black_dn);
                return Ok(Some((moved - &here.dn) / step as f32));
            }
            Column::Trial { term, param } => {
                let terms = state.terms.iter().chain([&trials[*term]]).cloned().collect();
                (terms, state.terms.len(), *param)
            }
            Column::Own { term, param } => (state.terms.clone(), *term, *param),
        };
        let mut terms = terms;
        let effect = terms[which].effect;
        let expanded = terms[which].expanded(self.lenses());
        let p = expanded[param].1;
        let value = p.inner(terms[which].params[param]);
        let mut step = 0.5 * p.inner(p.step);
        if value + step > p.inner(p.max) {
            step = -step;
        }
        terms[which].params[param] = p.outer(value + step);
        let chain = self.chain(&terms);
        let lens = p.per_lens.then(|| {
            let first = expanded.iter().position(|(_, q)| std::ptr::eq(*q, p)).unwrap_or(param);
            param - first
        });
        let Some(moved) = self.moved(k, effect.descriptor().stage, lens, &chain, state, here, previous, scenes)? else {
            return Ok(None);
        };
        Ok(Some((moved - &here.dn) / step as f32))
    }

    /// The expected frame under another chain that differs from `stage` on (in one lens only, if one is named).
    #[allow(clippy::too_many_arguments)] // the state of one frame, passed on as it is
    fn moved(
        &self,
        k: usize,
        stage: Stage,
        lens: Option<usize>,
        chain: &Chain,
        state: &State,
        here: &Predicted,
        previous: Option<&Array2<f32>>,
        scenes: &[Option<SceneLight>],
    ) -> Result<Option<Array2<f32>>, ForwardError> {
        let scale = here.scale;
        let sum = match (stage, &scenes[k]) {
            (Stage::Record, _) => return Ok(None),
            (Stage::Object | Stage::Geometry | Stage::Lens, None) => return Ok(None),
            (Stage::Object, Some(_)) => {
                let scene = self.scene(k, chain)?;
                self.sum_e(k, scene.as_ref(), chain, scale)
            }
            (Stage::Geometry | Stage::Lens, Some(scene)) => match lens {
                None => self.sum_e(k, Some(scene), chain, scale),
                Some(l) => {
                    let cx = self.context(k, None);
                    let before = self.forward.lens_e(scene, l, &self.chain(&state.terms), &cx);
                    let change = self.forward.lens_e(scene, l, chain, &cx) - before;
                    &here.sum_e + &(change * scale as f32)
                }
            },
            (Stage::Light, _) => here.sum_e.clone(),
            (Stage::Charge | Stage::Electronics, _) => {
                return Ok(Some(self.dn(k, here.light_e.clone(), chain, previous, state.black_dn)));
            }
        };
        let light = self.forward.on_sensor(sum, chain, &self.context(k, previous));
        Ok(Some(self.dn(k, light, chain, previous, state.black_dn)))
    }

    /// What of a change of the expected frame can be seen in frame `k`: all of it, or what is sharper than the smooth part. A
    /// change that is mostly smooth cannot be told from the specimen: nothing of it is seen.
    pub fn visible(&self, k: usize, change: Array2<f32>) -> Array2<f32> {
        if self.seen.frames[k].shown != Shown::Unknown {
            return change;
        }
        let sharp = &change - &smooth(&change);
        let power = |image: &Array2<f32>| image.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>();
        if power(&sharp) < 0.5 * power(&change) { Array2::zeros(change.dim()) } else { sharp }
    }
}

/// Residual of a frame, DN (no number where it was not measured), and the variance that its own unknown detail adds, DN^2.
fn residual(f: &Frame, expected: &Array2<f32>) -> (Array2<f32>, Array2<f32>) {
    let mut difference = &f.measured - expected;
    if let Some(cut) = &f.cut {
        difference.indexed_iter_mut().filter(|((r, c), _)| !cut.holds(*r, *c)).for_each(|(_, v)| *v = f32::NAN);
    }
    if f.shown != Shown::Unknown {
        return (difference, Array2::zeros(expected.dim()));
    }
    let sharp = |image: &Array2<f32>| image - &smooth(image);
    // The detail of the specimen is no noise; where there is much of it little can be told, whatever the model says.
    let detail = blur_within(&sharp(&f.measured).mapv(|v| v * v), 3.0 * SMOOTH_PX);
    (sharp(&difference), detail)
}

/// The smooth part of a frame.
fn smooth(frame: &Array2<f32>) -> Array2<f32> {
    blur_within(frame, SMOOTH_PX)
}
