//! Measures a session: darks, flats, a bead scan, scenes with truth.

use super::BenchError;
use super::config::BenchConfig;
use super::optics::{Moves, VirtualOptics};
use super::sensor::VirtualSensor;
use super::truth::{BenchTruth, TRUTH_FILE};
use crate::effects::{Chain, EffectSetting, FrameContext, Layout, Stage};
use crate::rng;
use crate::scene::Scenes;
use crate::session::{
    Existing, FrameInfo, FrameWriter, Role, SampleType, SessionError, SessionWriter, StackEntry, StackSpec,
};
use ndarray::{Array2, Axis};
use rand::RngExt;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;

/// Scenes whose light is summed at the same time: each PSF is computed once for all of them.
const SCENES_AT_ONCE: usize = 16;

/// The virtual instrument with its effects, ready to measure.
#[derive(Debug)]
pub struct VirtualInstrument {
    pub(super) config: BenchConfig,
    pub(super) optics: VirtualOptics,
    anchors_px: Vec<[f64; 2]>,
    sensor: VirtualSensor,
    settings: Vec<EffectSetting>,
    effects: Chain,
    scenes: Scenes,
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
        Ok(VirtualInstrument {
            config: self.clone(),
            anchors_px: optics.anchors_px(),
            optics,
            sensor: VirtualSensor::manufacture(&self.sensor, self.instrument_seed),
            settings: settings.to_vec(),
            effects: Chain::build(settings, Layout::of(&self.manifest()))?,
            scenes: self.scenes.build()?,
        })
    }
}

impl VirtualInstrument {
    /// Frames that a session will have.
    pub fn frames(&self) -> usize {
        let stacks = &self.config.stacks;
        stacks.dark_frames
            + stacks.flat_levels.len() * stacks.flat_frames
            + self.config.scan.rows * self.config.scan.cols
            + stacks.scene_frames
    }

    /// Measures a session into folder `target`, whole or not at all; calls `done` with the number of frames measured.
    ///
    /// # Errors
    /// The place is taken by something that is no virtual session, or cannot be written.
    pub fn measure(&self, target: &Path, seed: u64, done: impl Fn(usize) + Sync) -> Result<Summary, BenchError> {
        let mut writer = SessionWriter::create(target, &self.config.manifest(), Existing::ReplaceIfHas(TRUTH_FILE))?;
        self.darks(&mut writer, seed, &done)?;
        self.flats(&mut writer, seed, &done)?;
        let bead_peak_e = self.beads(&mut writer, seed, &done)?;
        let scene_peak_e = self.specimens(&mut writer, seed, &done)?;
        writer.extra(TRUTH_FILE, self.truth(seed)?.as_bytes())?;
        writer.finish()?;
        let stacks = &self.config.stacks;
        let frames = BTreeMap::from([
            ("dark", stacks.dark_frames),
            ("flat", stacks.flat_levels.len() * stacks.flat_frames),
            ("bead", self.config.scan.rows * self.config.scan.cols),
            ("scene", stacks.scene_frames),
        ]);
        Ok(Summary { frames, bead_peak_e, scene_peak_e, full_scale_e: self.config.full_scale_e() })
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
    fn info(&self, frame: usize) -> FrameInfo {
        let stacks = &self.config.stacks;
        let time_s = frame as f64 * stacks.interval_ms * 1e-3;
        FrameInfo { time_s, ..FrameInfo::plain(frame, stacks.exposure_ms) }
    }

    fn context(&self, role: Role, info: &FrameInfo) -> FrameContext<'_> {
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

    fn spec(&self, frames: usize, samples: SampleType) -> StackSpec {
        let sensor = &self.config.sensor;
        StackSpec { frames, rows: sensor.rows, cols: sensor.cols, samples, pixel_um: Some(sensor.pixel_pitch_um) }
    }

    /// Exposes frames in order: light by `light`, noise of stream `what`; as many at a time as there are threads for.
    fn expose(
        &self,
        frames: &mut FrameWriter,
        infos: &[FrameInfo],
        (role, seed, what): (Role, u64, &str),
        light: impl Fn(&FrameInfo, &FrameContext<'_>) -> Array2<f32> + Sync,
        done: &(impl Fn(usize) + Sync),
    ) -> Result<f64, SessionError> {
        let mut peak = 0.0f32;
        for group in infos.chunks(4 * rayon::current_num_threads()) {
            let exposed: Vec<_> = group
                .par_iter()
                .map(|info| {
                    let cx = self.context(role, info);
                    let light_e = light(info, &cx);
                    let mut rng = rng::stream(seed, what, info.frame as u64);
                    let frame = self.sensor.expose(&light_e, &self.effects, &cx, &mut rng);
                    (light_e.fold(0.0f32, |m, v| m.max(*v)), frame)
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

    /// Even light on the sensor, electrons, with the effects that act on light.
    fn even_light(&self, electrons: f64, cx: &FrameContext<'_>) -> Array2<f32> {
        let mut light = Array2::from_elem((self.config.sensor.rows, self.config.sensor.cols), electrons as f32);
        self.effects.on_light(&mut light, cx);
        light
    }

    fn darks(&self, writer: &mut SessionWriter, seed: u64, done: &(impl Fn(usize) + Sync)) -> Result<(), BenchError> {
        let n = self.config.stacks.dark_frames;
        let infos: Vec<_> = (0..n).map(|i| FrameInfo { illumination: 0.0, ..self.info(i) }).collect();
        let mut frames = writer.frames("dark.npy", self.spec(n, SampleType::U16))?;
        self.expose(&mut frames, &infos, (Role::Dark, seed, "bench/dark"), |_, cx| self.even_light(0.0, cx), done)?;
        frames.finish()?;
        writer.table("dark.csv", &infos)?;
        writer.add(entry(Role::Dark, "dark.npy", self.config.stacks.exposure_ms, Some("dark.csv")));
        Ok(())
    }

    fn flats(&self, writer: &mut SessionWriter, seed: u64, done: &(impl Fn(usize) + Sync)) -> Result<(), BenchError> {
        let stacks = &self.config.stacks;
        let levels = stacks.flat_levels.iter().flat_map(|level| std::iter::repeat_n(*level, stacks.flat_frames));
        let infos: Vec<_> =
            levels.enumerate().map(|(i, level)| FrameInfo { illumination: level, ..self.info(i) }).collect();
        let mut frames = writer.frames("flat.npy", self.spec(infos.len(), SampleType::U16))?;
        let light = |info: &FrameInfo, cx: &FrameContext<'_>| {
            self.even_light(info.illumination * self.config.full_scale_e(), cx)
        };
        self.expose(&mut frames, &infos, (Role::Flat, seed, "bench/flat"), light, done)?;
        frames.finish()?;
        writer.table("flat.csv", &infos)?;
        writer.add(entry(Role::Flat, "flat.npy", stacks.exposure_ms, Some("flat.csv")));
        Ok(())
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

    fn beads(&self, writer: &mut SessionWriter, seed: u64, done: &(impl Fn(usize) + Sync)) -> Result<f64, BenchError> {
        let position = |(i, [y_um, x_um]): (usize, [f64; 2])| FrameInfo { x_um, y_um, ..self.info(i) };
        let infos: Vec<_> = self.scan_um().into_iter().enumerate().map(position).collect();
        let mut frames = writer.frames("bead.npy", self.spec(infos.len(), SampleType::U16))?;
        let light = |info: &FrameInfo, cx: &FrameContext<'_>| self.bead_light(([info.y_um, info.x_um], info.z_um), cx);
        let peak = self.expose(&mut frames, &infos, (Role::Bead, seed, "bench/bead"), light, done)?;
        frames.finish()?;
        writer.table("bead.csv", &infos)?;
        writer.add(entry(Role::Bead, "bead.npy", self.config.stacks.exposure_ms, Some("bead.csv")));
        Ok(peak)
    }

    /// Expected electrons of the bead at (y, x) um and depth z um.
    pub(super) fn bead_light(&self, at: ([f64; 2], f64), cx: &FrameContext<'_>) -> Array2<f32> {
        let moves = Moves { effects: &self.effects, cx };
        let flux_e = self.config.scan.bead_e * self.emission_at(at.0, cx) * cx.illumination;
        let mut work = self.optics.work();
        let mut light = Array2::zeros((self.config.sensor.rows, self.config.sensor.cols));
        let per_lens = self.effects.acts_at(Stage::Lens);
        for l in 0..self.optics.lenses() {
            if per_lens {
                let mut image = Array2::zeros(light.dim());
                self.optics.add_point(l, at, flux_e, moves, &mut work, &mut image);
                self.effects.on_lens(&mut image, &FrameContext { lens: l, ..*cx });
                light += &image;
            } else {
                self.optics.add_point(l, at, flux_e, moves, &mut work, &mut light);
            }
        }
        self.effects.on_light(&mut light, cx);
        light
    }

    /// What effects on the object make of unit emission at (y, x) um: an even object, interpolated there.
    fn emission_at(&self, at_um: [f64; 2], cx: &FrameContext<'_>) -> f64 {
        if !self.effects.acts_at(Stage::Object) {
            return 1.0;
        }
        let grid = self.config.manifest().object;
        let mut even = Array2::from_elem((grid.rows, grid.cols), 1.0f32);
        self.effects.on_object(&mut even, cx);
        let [r, c] = grid.pixel_of_um(at_um[0], at_um[1]);
        let split = |at: f64, n: usize| {
            let low = (at.floor().max(0.0) as usize).min(n.saturating_sub(2));
            (low, (low + 1).min(n - 1), (at - low as f64).clamp(0.0, 1.0))
        };
        let ((r0, r1, fr), (c0, c1, fc)) = (split(r, grid.rows), split(c, grid.cols));
        let value = |r: usize, c: usize| f64::from(even[[r, c]]);
        let row = |r: usize| value(r, c0) * (1.0 - fc) + value(r, c1) * fc;
        row(r0) * (1.0 - fr) + row(r1) * fr
    }

    fn specimens(
        &self,
        writer: &mut SessionWriter,
        seed: u64,
        done: &(impl Fn(usize) + Sync),
    ) -> Result<f64, BenchError> {
        let n = self.config.stacks.scene_frames;
        let infos: Vec<_> = (0..n).map(|i| self.info(i)).collect();
        let object = &self.config.object;
        let object_spec = StackSpec {
            frames: n,
            rows: object.rows,
            cols: object.cols,
            samples: SampleType::F32,
            pixel_um: Some(object.pixel_um),
        };
        let mut frames = writer.frames("scene.npy", self.spec(n, SampleType::U16))?;
        let mut truths = writer.frames("scene_truth.npy", object_spec)?;
        let mut expected = writer.frames("scene_expected.npy", self.spec(n, SampleType::F32))?;
        let mut peak = 0.0f64;
        for batch in infos.chunks(SCENES_AT_ONCE) {
            let (objects, lights) = self.scene_batch(batch, seed);
            for ((info, object), light) in batch.iter().zip(&objects).zip(&lights) {
                truths.push(object.view())?;
                expected.push(self.sensor.expected(light, &self.effects, &self.context(Role::Scene, info)).view())?;
            }
            let at = |info: &FrameInfo, _: &FrameContext<'_>| lights[info.frame - batch[0].frame].clone();
            peak = peak.max(self.expose(&mut frames, batch, (Role::Scene, seed, "bench/scene"), at, done)?);
        }
        frames.finish()?;
        truths.finish()?;
        expected.finish()?;
        writer.table("scene.csv", &infos)?;
        let mut entry = entry(Role::Scene, "scene.npy", self.config.stacks.exposure_ms, Some("scene.csv"));
        entry.truth = Some("scene_truth.npy".into());
        entry.expected = Some("scene_expected.npy".into());
        writer.add(entry);
        Ok(peak)
    }

    /// Objects in units of the bead, and their light on the sensor, expected electrons.
    fn scene_batch(&self, infos: &[FrameInfo], seed: u64) -> (Vec<Array2<f32>>, Vec<Array2<f32>>) {
        let grid = self.config.manifest().object;
        let draw = |info: &FrameInfo| self.scenes.draw(&grid, seed, "bench/specimen", info.frame as u64);
        let mut objects: Vec<Array2<f32>> = infos.iter().map(draw).collect();
        // The level of a scene is set by the clean optics, so that an effect changes the frames and not the specimens.
        let clean = self.light_of(&objects, infos, &Chain::default());
        let [low, high] = self.config.stacks.scene_peak.map(|p| (p * self.config.full_scale_e()).ln());
        let mut lights = clean;
        for ((object, light), info) in objects.iter_mut().zip(&mut lights).zip(infos) {
            let mut rng = rng::stream(seed, "bench/level", info.frame as u64);
            let peak = light.fold(f32::MIN_POSITIVE, |m, v| m.max(*v));
            let scale = rng.random_range(low..=high).exp() as f32 / peak;
            object.mapv_inplace(|v| v * scale);
            light.mapv_inplace(|v| v * scale);
        }
        let before_sensor = [Stage::Object, Stage::Geometry, Stage::Lens, Stage::Light];
        if before_sensor.iter().any(|s| self.effects.acts_at(*s)) {
            lights = self.light_of(&objects, infos, &self.effects);
        }
        (objects, lights)
    }

    /// Expected electrons of objects (in units of the bead) with effects up to the sensor.
    fn light_of(&self, objects: &[Array2<f32>], infos: &[FrameInfo], effects: &Chain) -> Vec<Array2<f32>> {
        let contexts: Vec<_> = infos.iter().map(|i| self.context(Role::Scene, i)).collect();
        let emitted: Vec<_> = objects
            .iter()
            .zip(&contexts)
            .map(|(object, cx)| {
                let mut emitted = object * cx.illumination as f32;
                effects.on_object(&mut emitted, cx);
                emitted
            })
            .collect();
        let mut lights = vec![Array2::zeros((self.config.sensor.rows, self.config.sensor.cols)); objects.len()];
        // Frames whose rays no effect can tell apart share their PSFs.
        let together = if effects.acts_at(Stage::Geometry) { 1 } else { objects.len() };
        for start in (0..objects.len()).step_by(together.max(1)) {
            let range = start..start + together;
            let moves = Moves { effects, cx: &contexts[start] };
            for l in 0..self.optics.lenses() {
                let images = self.optics.lens_images(l, &emitted[range.clone()], self.config.scan.bead_e, moves);
                for (i, image) in range.clone().zip(images.axis_iter(Axis(0))) {
                    let mut image = image.to_owned();
                    effects.on_lens(&mut image, &FrameContext { lens: l, ..contexts[i] });
                    lights[i] += &image;
                }
            }
        }
        for (light, cx) in lights.iter_mut().zip(&contexts) {
            effects.on_light(light, cx);
        }
        lights
    }
}

fn entry(role: Role, file: &str, exposure_ms: f64, table: Option<&str>) -> StackEntry {
    StackEntry { role, file: file.into(), exposure_ms, table: table.map(Into::into), truth: None, expected: None }
}
