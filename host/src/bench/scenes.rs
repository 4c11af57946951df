//! Scenes that the virtual instrument measures: specimens, what is told of them, their light through the lenses.

use super::BenchError;
use super::measure::{Lit, VirtualInstrument, up_to_sensor};
use super::optics::{Moves, Point};
use crate::effects::{Chain, FrameContext, Record, Stage};
use crate::rng;
use crate::session::{FrameInfo, Role, SampleType, SessionWriter, StackSpec};
use ndarray::{Array2, Axis};
use rand::RngExt;
use std::collections::BTreeMap;

/// Scenes whose light is summed at the same time: each PSF is computed once for all of them.
pub(super) const SCENES_AT_ONCE: usize = 16;

impl VirtualInstrument {
    /// What effects on the object make of unit emission at (y, x) um: an even object, interpolated there.
    pub(super) fn emission_at(&self, at_um: [f64; 2], cx: &FrameContext<'_>) -> f64 {
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

    /// Measures the scenes; the brightest expected pixel, electrons.
    pub(super) fn specimens(
        &self,
        writer: &mut SessionWriter,
        seed: u64,
        done: &(impl Fn(usize) + Sync),
    ) -> Result<f64, BenchError> {
        let (n, stacks) = (self.config.scene_count(), &self.config.stacks);
        let at = |i: usize| FrameInfo { z_um: stacks.scene_depths_um[i / stacks.scene_frames], ..self.info(i) };
        let infos: Vec<_> = (0..n).map(at).collect();
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
        let (mut peak, mut written, mut waiting) = (0.0f64, 0, BTreeMap::new());
        let mut before = None;
        for batch in infos.chunks(SCENES_AT_ONCE) {
            let (objects, lit) = self.scene_batch(batch, seed, &mut before);
            for ((info, object), lit) in batch.iter().zip(&objects).zip(&lit) {
                let (place, truth) = self.told(info, n, object);
                waiting.insert(place, truth);
                // A truth that stands in the place of a later one waits for those before it.
                while let Some(truth) = waiting.remove(&written) {
                    truths.push(truth.view())?;
                    written += 1;
                }
                let cx = lit.seen(self.context(Role::Scene, info));
                expected.push(self.sensor.expected(&lit.light_e, &self.effects, &cx).view())?;
            }
            let at = |info: &FrameInfo| lit[info.frame - batch[0].frame].clone();
            peak = peak.max(self.expose(&mut frames, batch, (Role::Scene, seed), at, done)?);
        }
        frames.finish()?;
        truths.finish()?;
        expected.finish()?;
        let told = |info: &FrameInfo| FrameInfo {
            exposure_ms: info.exposure_ms / self.record(info, n).exposure_factor,
            ..info.clone()
        };
        writer.table("scene.csv", &infos.iter().map(told).collect::<Vec<_>>())?;
        let mut entry = self.entry(Role::Scene);
        entry.truth = Some("scene_truth.npy".into());
        entry.expected = Some("scene_expected.npy".into());
        writer.add(entry);
        Ok(peak)
    }

    /// How a model that knows of the faults reads the record of a scene.
    fn record(&self, info: &FrameInfo, frames: usize) -> Record {
        let mut record = Record::honest(info.frame, frames);
        self.effects.on_record(&mut record, &self.context(Role::Scene, info));
        record
    }

    /// Where the object of a scene is written in the truths, and how: so that [`Record::object`] of the same faults finds it there and
    /// turns it back.
    fn told(&self, info: &FrameInfo, frames: usize, object: &Array2<f32>) -> (usize, Array2<f32>) {
        let record = self.record(info, frames);
        // To flip is its own inverse.
        let written = Record { truth: 0, ..record }.object(std::slice::from_ref(object));
        (record.truth, written.unwrap_or_else(|| object.clone()))
    }

    /// Objects in units of the bead, and their light on the sensor, expected electrons; `before` is the last light of the batch before.
    fn scene_batch(
        &self,
        infos: &[FrameInfo],
        seed: u64,
        before: &mut Option<(Array2<f32>, f64)>,
    ) -> (Vec<Array2<f32>>, Vec<Lit>) {
        let grid = self.config.manifest().object;
        // Every depth sees the same scenes.
        let scene = |info: &FrameInfo| (info.frame % self.config.stacks.scene_frames) as u64;
        let draw = |info: &FrameInfo| self.scenes.draw(&grid, seed, "bench/specimen", scene(info));
        let mut objects: Vec<Array2<f32>> = infos.iter().map(draw).collect();
        // The level of a scene is set by the clean optics, so that an effect changes the frames and not the specimens.
        let mut clean = self.light_of(&objects, infos, &Chain::default());
        let [low, high] = self.config.stacks.scene_peak.map(|p| (p * self.config.full_scale_e()).ln());
        for ((object, light), info) in objects.iter_mut().zip(&mut clean).zip(infos) {
            let mut rng = rng::stream(seed, "bench/level", self.scenes.video(scene(info)));
            let peak = light.fold(f32::MIN_POSITIVE, |m, v| m.max(*v));
            let scale = rng.random_range(low..=high).exp() as f32 / peak;
            object.mapv_inplace(|v| v * scale);
            light.mapv_inplace(|v| v * scale);
        }
        if !up_to_sensor(&self.effects) {
            return (objects, clean.into_iter().map(|light_e| Lit { light_e, before: None }).collect());
        }
        drop(clean);
        let mut lit = Vec::with_capacity(infos.len());
        for (light, info) in self.light_of(&objects, infos, &self.effects).into_iter().zip(infos) {
            let cx = self.context(Role::Scene, info);
            let mut this = Lit { light_e: light.clone(), before: before.take() };
            let seen = this.seen(cx);
            let mut with = light.clone();
            self.effects.on_light(&mut with, &seen);
            if self.effects.needs_previous() {
                let mut alone = light;
                self.effects.on_light(&mut alone, &cx);
                *before = Some((alone, info.time_s));
            }
            this.light_e = with;
            lit.push(this);
        }
        (objects, lit)
    }

    /// Electrons that the lenses bring of objects (in units of the bead), with effects up to the lenses.
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
        let still = !effects.acts_at(Stage::Geometry);
        let mut start = 0;
        while start < objects.len() {
            let z_um = infos[start].z_um;
            // Frames whose rays neither depth nor an effect can tell apart share their PSFs.
            let alike = |i: &usize| {
                infos[*i].z_um == z_um && (still || self.optics.same_rays(effects, &contexts[start], &contexts[*i]))
            };
            let end = (start + 1..objects.len()).find(|i| !alike(i)).unwrap_or(objects.len());
            let moves = Moves { effects, cx: &contexts[start] };
            for l in 0..self.optics.lenses() {
                let keeps = self.keep && z_um == self.first_depth_um();
                let kept = if keeps { self.cache.object(l, &self.optics, || self.object_points()) } else { None };
                let flux = (self.config.scan.bead_e, z_um);
                let images = self.optics.lens_images(l, &emitted[start..end], flux, moves, kept);
                for (i, image) in (start..end).zip(images.axis_iter(Axis(0))) {
                    let mut image = image.to_owned();
                    effects.on_lens(&mut image, &FrameContext { lens: l, ..contexts[i] });
                    lights[i] += &image;
                }
            }
            start = end;
        }
        lights
    }

    /// The depth whose foci are kept, um.
    fn first_depth_um(&self) -> f64 {
        self.config.stacks.scene_depths_um.first().copied().unwrap_or(0.0)
    }

    /// Points of the object's pixels, row by row.
    fn object_points(&self) -> Vec<Point> {
        let (object, z_um) = (&self.config.object, self.first_depth_um());
        let pixels = (0..object.rows).flat_map(|r| (0..object.cols).map(move |c| (r, c)));
        pixels.map(|(r, c)| (self.optics.position_um(r, c), z_um)).collect()
    }
}
