//! The virtual instrument: optics, sensor, effects and scenes, built from a configuration.

use super::cache::FocusCache;
use super::config::{BenchConfig, SCENES_AT_ONCE};
use super::error::BenchError;
use super::family::change::Change;
use super::optics::VirtualOptics;
use super::sensor::VirtualSensor;
use ndarray::Array2;
use ommatidia_physics::effects::{Chain, Effect, EffectSetting, FrameContext, Layout, Previous, Stage};
use ommatidia_physics::scene::Scenes;
use ommatidia_session::rng;
use ommatidia_session::{FrameInfo, FrameWriter, Role, SampleType, SessionError, StackEntry, StackSpec};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;
use std::sync::Arc;

/// The virtual instrument with its effects, ready to measure.
#[derive(Debug)]
pub struct VirtualInstrument {
    pub(super) config: BenchConfig,
    pub(super) optics: VirtualOptics,
    /// The optics with parts that effects have moved; `None`: they are as they were made.
    pub(super) moved: Option<VirtualOptics>,
    pub(super) anchors_px: Vec<[f64; 2]>,
    /// Where the axis of each lens meets the sensor, (row, col) pixels.
    pub(super) axes_px: Vec<[f64; 2]>,
    pub(super) sensor: VirtualSensor,
    pub(super) settings: Vec<EffectSetting>,
    pub(super) effects: Chain,
    pub(super) scenes: Scenes,
    pub(super) cache: Arc<FocusCache>,
    /// Whether foci are stored. They are not if each is needed only once.
    pub(super) keep: bool,
}

/// Figures of a measured session.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Number of frames of each stack, by role.
    pub frames: BTreeMap<&'static str, usize>,
    /// Brightest pixel of the bead scan, expected electrons.
    pub bead_peak_e: f64,
    /// Brightest pixel of the scenes, expected electrons.
    pub scene_peak_e: f64,
    /// Full scale above the black level, electrons.
    pub full_scale_e: f64,
}

/// Light of a frame, and of the frame before it if an effect needs that.
#[derive(Clone)]
pub(super) struct Lit {
    /// Expected electrons, [sensor rows, sensor cols].
    pub(super) light_e: Array2<f32>,
    pub(super) before: Option<Before>,
}

/// The frame before another one.
#[derive(Clone, Debug)]
pub(super) struct Before {
    /// Its light, expected electrons, [sensor rows, sensor cols].
    pub(super) light_e: Array2<f32>,
    /// Start of its exposure, s.
    pub(super) start_s: f64,
}

impl Lit {
    /// Adds the frame before to the context of this frame.
    pub(super) fn seen<'a>(&'a self, cx: FrameContext<'a>) -> FrameContext<'a> {
        let previous = self.before.as_ref();
        FrameContext {
            previous: previous.map(|b| Previous { light_e: &b.light_e, interval_s: cx.time_s - b.start_s }),
            ..cx
        }
    }
}

/// Names the random numbers of a stack: each role has its own under each seed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Draw {
    pub(super) role: Role,
    pub(super) seed: u64,
}

impl BenchConfig {
    /// Builds the instrument and injects effects.
    ///
    /// # Errors
    /// A number of the configuration is impossible, an effect is unknown, or the pictures for scenes cannot be read.
    pub fn build(&self, settings: &[EffectSetting]) -> Result<VirtualInstrument, BenchError> {
        self.check()?;
        let optics = VirtualOptics::build(self)?;
        let layout = Layout::of(&self.manifest());
        // All settings are checked, also those that become moved parts.
        let mut effects = Chain::build(settings, layout)?;
        for setting in settings {
            if let Some(why) = optics.refuses(setting) {
                return Err(BenchError::Refused { effect: setting.id.clone(), family: self.family.name(), why });
            }
        }
        let moved = optics.moved(settings);
        if moved.is_some() {
            let others: Vec<_> = settings.iter().filter(|s| !Change::knows(&s.id)).cloned().collect();
            effects = Chain::build(&others, layout)?;
        }
        // Scenes pass the optics in batches, and once more with effects. Stored foci help from the second pass on.
        let again = moved.is_none() && !effects.acts_at(Stage::Geometry) && up_to_sensor(&effects);
        let passes = self.scene_count().div_ceil(SCENES_AT_ONCE) * if again { 2 } else { 1 };
        Ok(VirtualInstrument {
            config: self.clone(),
            anchors_px: optics.anchors_px(),
            axes_px: optics.axes_px(),
            optics,
            moved,
            sensor: VirtualSensor::manufacture(&self.sensor, self.instrument_seed),
            settings: settings.to_vec(),
            effects,
            scenes: self.scenes.build()?,
            cache: Arc::new(FocusCache::new(self)),
            keep: passes > 1,
        })
    }

    /// As [`BenchConfig::build`], with the same results, but stores the foci and shares them with `other` if both have
    /// the same optics. In a study of many sessions with one instrument, only the first then computes the optics.
    ///
    /// # Errors
    /// As [`BenchConfig::build`].
    pub fn build_like(
        &self,
        other: &VirtualInstrument,
        settings: &[EffectSetting],
    ) -> Result<VirtualInstrument, BenchError> {
        let mut built = self.build(settings)?;
        built.keep = true;
        if other.cache.fits(self) {
            built.cache = Arc::clone(&other.cache);
        }
        Ok(built)
    }
}

/// Whether an effect acts before the light reaches the sensor, or on more than one frame.
fn up_to_sensor(effects: &Chain) -> bool {
    let stages = [Stage::Object, Stage::Geometry, Stage::Lens, Stage::Light];
    effects.needs_previous() || stages.iter().any(|s| effects.acts_at(*s))
}

impl VirtualInstrument {
    /// Whether scenes differ from those without effects before the light reaches the sensor, or by the frame before.
    pub(super) fn changes_light(&self) -> bool {
        self.moved.is_some() || up_to_sensor(&self.effects)
    }

    /// The optics as effects have moved their parts.
    pub(super) fn optics_now(&self) -> &VirtualOptics {
        self.moved.as_ref().unwrap_or(&self.optics)
    }

    /// Computes every focus each time it is needed.
    #[cfg(test)]
    pub(super) fn forget(&mut self) {
        self.keep = false;
    }

    /// Adds an effect from outside the catalogue, with its parameters in the order of its descriptor. The ground truth
    /// of the session does not name it. For studies of unknown effects.
    ///
    /// # Errors
    /// The table of the effect does not fit the sensor.
    pub fn with_foreign(mut self, effect: &'static dyn Effect, params: Vec<f64>) -> Result<Self, BenchError> {
        self.effects.push(effect, params, None, Layout::of(&self.config.manifest()))?;
        Ok(self)
    }

    /// Metadata of frame `frame` of a stack: exposed at even intervals, at light level 1.
    pub(super) fn info(&self, frame: usize) -> FrameInfo {
        let stacks = &self.config.stacks;
        let time_s = frame as f64 * stacks.interval_ms * 1e-3;
        FrameInfo { time_s, ..FrameInfo::plain(frame, stacks.exposure_ms) }
    }

    /// What effects need to know of a frame.
    pub(super) fn context(&self, role: Role, info: &FrameInfo) -> FrameContext<'_> {
        FrameContext {
            role,
            anchors_px: &self.anchors_px,
            axes_px: &self.axes_px,
            pixel_pitch_um: self.config.sensor.pixel_pitch_um,
            gain_dn_per_e: self.config.sensor.gain_dn_per_e,
            temperature_c: info.temperature_c.unwrap_or(20.0),
            travel: if role == Role::Bead { info.travel } else { [0.0; 2] },
            frame: info.frame,
            time_s: info.time_s,
            exposure_ms: info.exposure_ms,
            illumination: info.illumination,
            full_scale_e: self.config.full_scale_e(),
            black_level_dn: self.config.sensor.black_level_dn,
            ..FrameContext::default()
        }
    }

    /// Size of a stack of frames.
    pub(super) fn spec(&self, frames: usize, samples: SampleType) -> StackSpec {
        let sensor = &self.config.sensor;
        StackSpec { frames, rows: sensor.rows, cols: sensor.cols, samples, pixel_um: Some(sensor.pixel_pitch_um) }
    }

    /// The manifest's entry of a stack.
    pub(super) fn entry(&self, role: Role) -> StackEntry {
        let name = role.name();
        let plain = StackEntry::plain(role, format!("{name}.npy"), self.config.stacks.exposure_ms);
        StackEntry { table: Some(format!("{name}.csv")), ..plain }
    }

    /// Draws the frame that the sensor reads, whole DN.
    pub(super) fn read_out(&self, lit: &Lit, draw: Draw, info: &FrameInfo) -> Array2<f32> {
        let mut rng = rng::stream(draw.seed, &format!("bench/{}", draw.role.name()), info.frame as u64);
        self.sensor.expose(&lit.light_e, &self.effects, &lit.seen(self.context(draw.role, info)), &mut rng)
    }

    /// Exposes and writes frames in order; their light comes from `light`. Calls `done` with the number of new frames.
    /// Returns the brightest expected pixel, electrons. Memory holds a few frames for each thread.
    pub(super) fn expose(
        &self,
        frames: &mut FrameWriter,
        infos: &[FrameInfo],
        draw: Draw,
        light: impl Fn(&FrameInfo) -> Lit + Sync,
        done: &(dyn Fn(usize) + Sync),
    ) -> Result<f64, SessionError> {
        let mut peak = 0.0f32;
        for group in infos.chunks(4 * rayon::current_num_threads()) {
            let exposed: Vec<_> = group
                .par_iter()
                .map(|info| {
                    let lit = light(info);
                    (lit.light_e.fold(0.0f32, |m, v| m.max(*v)), self.read_out(&lit, draw, info))
                })
                .collect();
            for (brightest, frame) in exposed {
                peak = peak.max(brightest);
                frames.push(frame.view())?;
            }
            done(group.len());
        }
        Ok(f64::from(peak))
    }
}
