//! The model that the loop closes: the instrument without its effects, and the frames of a session.

use super::lamp;
use super::projection::{Projectors, Sigmas};
use super::scenes::{Scenes, ScenesInUse};
use super::state::{State, Term};
use super::truth::{Grid, PARTS, TRUTH};
use super::wings::{self, Ring};
use crate::data::{Frame, Observations, Shown};
use ndarray::Array2;
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
pub(super) const SMOOTH_PX: f64 = 2.0;
/// PSFs that err by more are no approximation: what they lack is to be seen in the residual, and not excused.
const MOST_PSF_ERROR: f64 = 0.05;

/// Own defocus of the lenses that their pupils misjudge: fitted beside effects on the wavefront, and never a cause.
pub(crate) const PUPIL_DEFOCUS: &str = "pupil_defocus";

/// Levels of flats that determine the bend of a response.
const LEVELS: usize = 3;

/// Whether the flats show how the signal grows with the light. Scenes alone do not: what is wrong in the optics is
/// wrong where they are bright.
fn shows_response(seen: &Observations) -> bool {
    let flats = seen.frames.iter().filter(|f| f.shown == Shown::Even);
    let mut doses: Vec<f64> = flats.map(|f| f.info.exposure_ms * f.info.illumination).collect();
    doses.sort_by(f64::total_cmp);
    doses.dedup();
    doses.len() >= LEVELS
}

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
    /// Which lenses show light.
    live: Vec<bool>,
    /// The grid that truths live on.
    pub(crate) grid: Grid,
    /// Relative error of the PSFs in the frame of a single bead, without noise: nothing averages it there.
    pub(super) psf_error: f64,
    /// The same where it exceeds the noise of the bead frames; 0 where the calibration is as good as its noise allows.
    pub(crate) coarse_error: f64,
    /// Exposure of the calibration, ms.
    pub(crate) exposure_ms: f64,
    /// Half of the longer side of the object, mm: on the object, and in its image.
    half_side_mm: [f64; 2],
    /// Rows and columns of the windows of the basis PSFs.
    pub(super) window_px: usize,
    /// Rings outside the windows whose light is fitted.
    pub(super) rings: Vec<Ring>,
    /// Noise of the frames whose specimens are estimated, from their first estimate.
    pub(super) sigmas: OnceLock<Arc<Sigmas>>,
    /// What the objects of these frames hold outside of the region that is used, from their first estimate.
    pub(super) beside: OnceLock<Vec<Array2<f32>>>,
    /// What takes specimens out of frames.
    pub(super) projectors: Projectors,
    /// The light behind the optics that states share.
    scenes: ScenesInUse,
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
            live: instrument.geometry.dead.iter().map(|dead| !dead).collect(),
            grid: Grid::of(instrument),
            psf_error: quality.bead_error().min(MOST_PSF_ERROR),
            coarse_error: if quality.is_coarse() { quality.off_grid_excess() } else { 0.0 },
            exposure_ms: instrument.psf.exposure_ms,
            half_side_mm: [instrument.manifest.object.pixel_um, instrument.manifest.sensor.pixel_pitch_um]
                .map(|um| 5e-4 * um * instrument.manifest.object.rows.max(instrument.manifest.object.cols) as f64),
            window_px: instrument.psf.basis.dim().2,
            rings: wings::fitted(seen, instrument.psf.basis.dim().2 / 2, quality.outside_window),
            sigmas: OnceLock::new(),
            beside: OnceLock::new(),
            projectors: Projectors::default(),
            scenes: ScenesInUse::default(),
        })
    }

    /// Whether the light of no frame is known. Then only effects that follow the pixel grid can be tested, since the
    /// specimen may have any other detail.
    pub fn is_blind(&self) -> bool {
        self.seen.frames.iter().all(|f| f.shown == Shown::Unknown)
    }

    /// Whether frames of single beads show the optics.
    pub(crate) fn shows_beads(&self) -> bool {
        self.seen.frames.iter().any(|f| matches!(f.shown, Shown::Bead(_)))
    }

    /// Whether the light of any frame is known, an object, a bead, or even light, or estimated.
    pub fn sees_known_light(&self) -> bool {
        !self.seen.frames.iter().all(|f| matches!(f.shown, Shown::Dark | Shown::Unknown))
    }

    /// Half of the longer side of the object, mm: on the object, and in its image.
    pub(crate) fn half_side_mm(&self) -> [f64; 2] {
        self.half_side_mm
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
            wings: vec![0.0; wings::values(&self.rings)],
            registration: vec![[0.0; PARTS]; self.seen.registrations.len()],
            specimens: None,
            held: instrument.bends().map(|e| e.id.clone()).filter(|_| !shows_response(self.seen)).collect(),
        })
    }

    /// The same state in a standard gauge: a common factor of an effect and of the light is moved to the light
    /// ([`ommatidia_physics::effects::Effect::gauge`]).
    pub fn gauged(&self, mut state: State) -> State {
        for t in &mut state.terms {
            let factor = t.effect.gauge(&mut t.params, &self.live);
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
    /// pixel grid acts. In flats, what is as smooth as a lamp belongs to the lamp.
    pub(super) fn chain_of(&self, k: usize, terms: &[Term]) -> Chain {
        match self.seen.frames[k].shown {
            Shown::Unknown => self.chain_of_grid(terms),
            Shown::Even => self.chain_of_flats(terms),
            _ => self.chain(terms),
        }
    }

    pub(super) fn chain_of_grid(&self, terms: &[Term]) -> Chain {
        self.chain(terms.iter().filter(|t| t.effect.is_of_the_grid() || t.effect.table().is_some()))
    }

    pub(super) fn chain_of_flats(&self, terms: &[Term]) -> Chain {
        self.chain(terms.iter().filter(|t| !t.effect.is_as_smooth_as_a_lamp()))
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
    pub fn scenes(&self, state: &State) -> Result<Scenes, ForwardError> {
        self.scenes.of(state, || {
            let chain = self.chain(&state.terms);
            (0..self.seen.frames.len()).into_par_iter().map(|k| self.scene(k, state, &chain)).collect()
        })
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
    pub(crate) fn lens_e(
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
                sum = self.forward.sum_e(scene, &self.placed(k, state, chain), &self.context(k, None));
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
    pub(super) fn wings_e(&self, k: usize, sum_e: &Array2<f32>, state: &State) -> Option<Array2<f32>> {
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
}

/// The smooth part of a frame.
pub(super) fn smooth(frame: &Array2<f32>) -> Array2<f32> {
    blur_within(frame, SMOOTH_PX)
}
