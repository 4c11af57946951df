//! Measures a session: darks, flats, a bead scan, scenes with truth.

use super::BenchError;
use super::cache::FocusCache;
use super::config::BenchConfig;
use super::optics::{Moves, Point, VirtualOptics};
use super::scenes::SCENES_AT_ONCE;
use super::sensor::VirtualSensor;
use super::truth::{BenchTruth, TRUTH_FILE};
use crate::effects::{Chain, Effect, EffectSetting, FrameContext, Layout, Previous, Stage};
use crate::rng;
use crate::scene::Scenes;
use crate::session::{
    Existing, FrameInfo, FrameWriter, Role, SampleType, SessionError, SessionWriter, StackEntry, StackSpec,
};
use ndarray::Array2;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// The virtual instrument with its effects, ready to measure.
#[derive(Debug)]
pub struct VirtualInstrument {
    pub(super) config: BenchConfig,
    pub(super) optics: VirtualOptics,
    anchors_px: Vec<[f64; 2]>,
    pub(super) sensor: VirtualSensor,
    settings: Vec<EffectSetting>,
    pub(super) effects: Chain,
    pub(super) scenes: Scenes,
    pub(super) cache: Arc<FocusCache>,
    /// Whether foci are kept: not where each is needed once.
    pub(super) keep: bool,
}

/// Stacks that a calibration is made from.
pub(super) const CALIBRATION_ROLES: [Role; 3] = [Role::Dark, Role::Flat, Role::Bead];

/// Light of a frame, and light and start, s, of the frame before it where an effect asks for that.
#[derive(Clone)]
pub(super) struct Lit {
    pub(super) light_e: Array2<f32>,
    pub(super) before: Option<(Array2<f32>, f64)>,
}

impl Lit {
    /// The context of the frame with the one before it.
    pub(super) fn seen<'a>(&'a self, cx: FrameContext<'a>) -> FrameContext<'a> {
        let previous = self.before.as_ref();
        FrameContext {
            previous: previous.map(|(light_e, start_s)| Previous { light_e, interval_s: cx.time_s - start_s }),
            ..cx
        }
    }
}

/// What a measurement was like.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Frames of each stack, by role.
    pub frames: BTreeMap<&'static str, usize>,
    /// Brightest pixel of the bead scan, expected electrons.
    pub bead_peak_e: f64,
    /// Brightest pixel of the scenes, expected electrons.
    pub scene_peak_e: f64,
    /// Full scale above the black level, electrons.
    pub full_scale_e: f64,
}

impl BenchConfig {
    /// Builds the instrument, with effects injected.
    ///
    /// # Errors
    /// A number cannot be, or an effect is unknown.
    pub fn build(&self, settings: &[EffectSetting]) -> Result<VirtualInstrument, BenchError> {
        self.check()?;
        let optics = VirtualOptics::build(self)?;
        let effects = Chain::build(settings, Layout::of(&self.manifest()))?;
        // Scenes pass the optics in batches, and once more with effects; kept foci help from the second time on.
        let again = !effects.acts_at(Stage::Geometry) && up_to_sensor(&effects);
        let passes = self.scene_count().div_ceil(SCENES_AT_ONCE) * if again { 2 } else { 1 };
        Ok(VirtualInstrument {
            config: self.clone(),
            anchors_px: optics.anchors_px(),
            optics,
            sensor: VirtualSensor::manufacture(&self.sensor, self.instrument_seed),
            settings: settings.to_vec(),
            effects,
            scenes: self.scenes.build()?,
            cache: Arc::new(FocusCache::new(self)),
            keep: passes > 1,
        })
    }

    /// Builds the instrument as [`BenchConfig::build`] does, to the same bits; keeps the foci of its optics at rest, and shares them
    /// with `other` where that is of the same build. For studies of many sessions with one instrument: only the first pays for the
    /// optics.
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

/// Whether an effect acts before the light is on the sensor, or on more than one frame.
pub(super) fn up_to_sensor(effects: &Chain) -> bool {
    let stages = [Stage::Object, Stage::Geometry, Stage::Lens, Stage::Light];
    effects.needs_previous() || stages.iter().any(|s| effects.acts_at(*s))
}

impl VirtualInstrument {
    /// Computes every focus anew.
    #[cfg(test)]
    pub(super) fn forget(&mut self) {
        self.keep = false;
    }

    /// Frames that a session will have.
    pub fn frames(&self) -> usize {
        self.counts().values().sum()
    }

    fn counts(&self) -> BTreeMap<&'static str, usize> {
        let (stacks, scan) = (&self.config.stacks, &self.config.scan);
        BTreeMap::from([
            ("dark", stacks.dark_frames * self.config.dark_exposures_ms().len()),
            ("flat", stacks.flat_levels.len() * stacks.flat_frames * self.config.flat_exposures_ms().len()),
            ("bead", scan.rows * scan.cols * scan.depths_um.len()),
            ("scene", self.config.scene_count()),
        ])
    }

    /// Measures a session into folder `target`, whole or not at all; calls `done` with the number of frames measured.
    ///
    /// # Errors
    /// The place is taken by something that is no virtual session, or cannot be written.
    pub fn measure(&self, target: &Path, seed: u64, done: impl Fn(usize) + Sync) -> Result<Summary, BenchError> {
        self.measure_some(target, seed, &[Role::Dark, Role::Flat, Role::Bead, Role::Scene], done)
    }

    /// Measures the stacks of some roles alone, each to the same bits as in the whole session.
    ///
    /// # Errors
    /// As [`VirtualInstrument::measure`].
    pub fn measure_some(
        &self,
        target: &Path,
        seed: u64,
        roles: &[Role],
        done: impl Fn(usize) + Sync,
    ) -> Result<Summary, BenchError> {
        let mut writer = SessionWriter::create(target, &self.config.manifest(), Existing::ReplaceIfHas(TRUTH_FILE))?;
        let has = |role: Role| roles.contains(&role);
        let mut bead_peak_e = 0.0;
        for role in CALIBRATION_ROLES.into_iter().filter(|r| has(*r)) {
            let peak_e = self.stack(&mut writer, (role, seed), &done)?;
            if role == Role::Bead {
                bead_peak_e = peak_e;
            }
        }
        let scene_peak_e = if has(Role::Scene) { self.specimens(&mut writer, seed, &done)? } else { 0.0 };
        writer.extra(TRUTH_FILE, self.truth(seed)?.as_bytes())?;
        writer.finish()?;
        let mut frames = self.counts();
        frames.retain(|name, _| roles.iter().any(|r| r.name() == *name));
        Ok(Summary { frames, bead_peak_e, scene_peak_e, full_scale_e: self.config.full_scale_e() })
    }

    /// Adds an effect that no catalogue holds: for studies of what happens then. The record of the session does not name it.
    ///
    /// # Errors
    /// Its table does not fit the sensor.
    pub fn with_foreign(mut self, effect: &'static dyn Effect, params: Vec<f64>) -> Result<Self, BenchError> {
        self.effects.push(effect, params, None, Layout::of(&self.config.manifest()))?;
        Ok(self)
    }

    fn truth(&self, seed: u64) -> Result<String, BenchError> {
        let per_row = |v: Vec<[f64; 2]>| v.chunks(self.config.array.cols).map(<[_]>::to_vec).collect();
        let truth = BenchTruth {
            program: concat!("ommatidia ", env!("CARGO_PKG_VERSION")).into(),
            seed,
            gain_dn_per_e: self.config.sensor.gain_dn_per_e,
            read_noise_e: self.config.sensor.read_noise_e,
            black_level_dn: self.config.sensor.black_level_dn,
            anchors_px: per_row(self.anchors_px.clone()),
            magnification: self.config.true_magnification(),
            axes_um: per_row(self.optics.axes_um()),
            unit_e: self.config.scan.bead_e,
            effects: self.settings.clone(),
            config: self.config.clone(),
        };
        let json = serde_json::to_string_pretty(&truth);
        json.map_err(|e| BenchError::Syntax { path: TRUTH_FILE.into(), detail: e.to_string() })
    }

    /// A frame of a stack: exposed at even intervals, its light level 1.
    pub(super) fn info(&self, frame: usize) -> FrameInfo {
        let stacks = &self.config.stacks;
        let time_s = frame as f64 * stacks.interval_ms * 1e-3;
        FrameInfo { time_s, ..FrameInfo::plain(frame, stacks.exposure_ms) }
    }

    pub(super) fn context(&self, role: Role, info: &FrameInfo) -> FrameContext<'_> {
        FrameContext {
            role,
            array: [self.config.array.rows, self.config.array.cols],
            anchors_px: &self.anchors_px,
            gain_dn_per_e: self.config.sensor.gain_dn_per_e,
            temperature_c: info.temperature_c.unwrap_or(20.0),
            frame: info.frame,
            time_s: info.time_s,
            exposure_ms: info.exposure_ms,
            illumination: info.illumination,
            full_scale_e: self.config.full_scale_e(),
            black_level_dn: self.config.sensor.black_level_dn,
            ..FrameContext::default()
        }
    }

    pub(super) fn spec(&self, frames: usize, samples: SampleType) -> StackSpec {
        let sensor = &self.config.sensor;
        StackSpec { frames, rows: sensor.rows, cols: sensor.cols, samples, pixel_um: Some(sensor.pixel_pitch_um) }
    }

    /// The frame that the sensor makes of light.
    pub(super) fn read_out(&self, lit: &Lit, (role, seed): (Role, u64), info: &FrameInfo) -> Array2<f32> {
        let mut rng = rng::stream(seed, &format!("bench/{}", role.name()), info.frame as u64);
        self.sensor.expose(&lit.light_e, &self.effects, &lit.seen(self.context(role, info)), &mut rng)
    }

    /// Exposes frames in order: light by `light`; as many at a time as there are threads for.
    pub(super) fn expose(
        &self,
        frames: &mut FrameWriter,
        infos: &[FrameInfo],
        (role, seed): (Role, u64),
        light: impl Fn(&FrameInfo) -> Lit + Sync,
        done: &(impl Fn(usize) + Sync),
    ) -> Result<f64, SessionError> {
        let mut peak = 0.0f32;
        for group in infos.chunks(4 * rayon::current_num_threads()) {
            let exposed: Vec<_> = group
                .par_iter()
                .map(|info| {
                    let lit = light(info);
                    (lit.light_e.fold(0.0f32, |m, v| m.max(*v)), self.read_out(&lit, (role, seed), info))
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

    /// Light of one frame of darks, flats or beads, after that of the frame before it where an effect asks for it.
    ///
    /// The frame before is seen as if none had come before it: what an effect carries on it carries once.
    pub(super) fn lit(&self, role: Role, infos: &[FrameInfo], info: &FrameInfo) -> Lit {
        let previous = info.frame.checked_sub(1).and_then(|i| infos.get(i)).filter(|_| self.effects.needs_previous());
        let before = previous.map(|p| (self.light(role, p, &self.context(role, p)), p.time_s));
        let mut lit = Lit { light_e: Array2::zeros((0, 0)), before };
        lit.light_e = self.light(role, info, &lit.seen(self.context(role, info)));
        lit
    }

    /// Even light on the sensor, electrons, with the effects that act on light.
    fn even_light(&self, electrons: f64, cx: &FrameContext<'_>) -> Array2<f32> {
        let mut light = Array2::from_elem((self.config.sensor.rows, self.config.sensor.cols), electrons as f32);
        self.effects.on_light(&mut light, cx);
        light
    }

    /// Frames of several exposures, `each` times `levels` at every one; no exposure lasts into the next.
    fn ladder(&self, exposures_ms: &[f64], levels: &[f64], each: usize) -> Vec<FrameInfo> {
        let longest = if exposures_ms.len() > 1 { exposures_ms.iter().copied().fold(0.0, f64::max) } else { 0.0 };
        let interval_ms = self.config.stacks.interval_ms.max(longest);
        let frames = exposures_ms.iter().flat_map(|t| levels.iter().map(move |level| (*t, *level)));
        let frames = frames.flat_map(|frame| std::iter::repeat_n(frame, each)).enumerate();
        let info = |(i, (exposure_ms, illumination)): (usize, (f64, f64))| {
            let time_s = i as f64 * interval_ms * 1e-3;
            FrameInfo { illumination, time_s, ..FrameInfo::plain(i, exposure_ms) }
        };
        frames.map(info).collect()
    }

    /// What is known of each frame of a stack of darks, flats or beads.
    pub(super) fn infos(&self, role: Role) -> Vec<FrameInfo> {
        let (config, stacks) = (&self.config, &self.config.stacks);
        match role {
            Role::Dark => self.ladder(&config.dark_exposures_ms(), &[0.0], stacks.dark_frames),
            Role::Flat => self.ladder(&config.flat_exposures_ms(), &stacks.flat_levels, stacks.flat_frames),
            Role::Bead => {
                let place = |(i, ([y_um, x_um], z_um)): (usize, Point)| FrameInfo { x_um, y_um, z_um, ..self.info(i) };
                self.scan_points().into_iter().enumerate().map(place).collect()
            }
            Role::Scene => Vec::new(),
        }
    }

    /// Light of a frame of darks, flats or beads.
    fn light(&self, role: Role, info: &FrameInfo, cx: &FrameContext<'_>) -> Array2<f32> {
        match role {
            Role::Bead => self.bead_light((([info.y_um, info.x_um], info.z_um), self.keep.then_some(info.frame)), cx),
            Role::Flat => {
                let exposure = info.exposure_ms / self.config.stacks.exposure_ms;
                self.even_light(info.illumination * self.config.full_scale_e() * exposure, cx)
            }
            Role::Dark | Role::Scene => self.even_light(0.0, cx),
        }
    }

    /// Measures darks, flats or beads; the brightest expected pixel, electrons.
    fn stack(
        &self,
        writer: &mut SessionWriter,
        (role, seed): (Role, u64),
        done: &(impl Fn(usize) + Sync),
    ) -> Result<f64, BenchError> {
        let infos = self.infos(role);
        let entry = self.entry(role);
        let mut frames = writer.frames(&entry.file, self.spec(infos.len(), SampleType::U16))?;
        if self.keep && role == Role::Bead {
            // Before the frames are shared out among threads that all want the same foci.
            for l in 0..self.optics.lenses() {
                self.cache.scan(l, &self.optics, || self.scan_points());
            }
        }
        let lit = |info: &FrameInfo| self.lit(role, &infos, info);
        let peak = self.expose(&mut frames, &infos, (role, seed), lit, done)?;
        frames.finish()?;
        if let Some(table) = &entry.table {
            writer.table(table, &infos)?;
        }
        writer.add(entry);
        Ok(peak)
    }

    /// The entry of a stack in the manifest.
    pub(super) fn entry(&self, role: Role) -> StackEntry {
        let name = role.name();
        StackEntry {
            role,
            file: format!("{name}.npy"),
            exposure_ms: self.config.stacks.exposure_ms,
            table: Some(format!("{name}.csv")),
            truth: None,
            expected: None,
        }
    }

    /// Positions of the scan, (y, x) um: even steps from edge to edge of the object; a single one at its centre.
    pub(super) fn scan_um(&self) -> Vec<[f64; 2]> {
        let along = |i: usize, positions: usize, pixels: usize| {
            let half = (pixels as f64 - 1.0) / 2.0 * self.config.object.pixel_um;
            if positions == 1 { 0.0 } else { half * (2.0 * i as f64 / (positions as f64 - 1.0) - 1.0) }
        };
        let (scan, object) = (&self.config.scan, &self.config.object);
        let rows = (0..scan.rows).map(|i| along(i, scan.rows, object.rows));
        rows.flat_map(|y| (0..scan.cols).map(move |j| [y, along(j, scan.cols, object.cols)])).collect()
    }

    /// Points of the scan: every position at each depth.
    fn scan_points(&self) -> Vec<Point> {
        let positions = self.scan_um();
        self.config.scan.depths_um.iter().flat_map(|z| positions.iter().map(move |at_um| (*at_um, *z))).collect()
    }

    /// Expected electrons of the bead at a point; `kept` is its index in the scan where its foci are kept.
    pub(super) fn bead_light(&self, (point, kept): (Point, Option<usize>), cx: &FrameContext<'_>) -> Array2<f32> {
        let moves = Moves { effects: &self.effects, cx };
        let flux_e = self.config.scan.bead_e * self.emission_at(point.0, cx) * cx.illumination;
        let mut work = self.optics.work();
        let mut light = Array2::zeros((self.config.sensor.rows, self.config.sensor.cols));
        let per_lens = self.effects.acts_at(Stage::Lens);
        for l in 0..self.optics.lenses() {
            let foci = kept.and_then(|i| Some((self.cache.scan(l, &self.optics, || self.scan_points())?, i)));
            if per_lens {
                let mut image = Array2::zeros(light.dim());
                self.optics.add_point(l, (point, foci), flux_e, moves, &mut work, &mut image);
                self.effects.on_lens(&mut image, &FrameContext { lens: l, ..*cx });
                light += &image;
            } else {
                self.optics.add_point(l, (point, foci), flux_e, moves, &mut work, &mut light);
            }
        }
        self.effects.on_light(&mut light, cx);
        light
    }
}
