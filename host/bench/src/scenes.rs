//! Scenes of the virtual instrument: specimens, their truth, and their light through the lenses.

use super::config::SCENES_AT_ONCE;
use super::error::BenchError;
use super::foci::Point;
use super::instrument::{Before, Draw, Lit, VirtualInstrument};
use super::optics::{Emission, Moves, VirtualOptics};
use ndarray::{Array2, Axis};
use ommatidia_physics::effects::{Chain, FrameContext, Record, Stage};
use ommatidia_session::rng;
use ommatidia_session::{FrameInfo, Role, SampleType, SessionWriter, StackSpec};
use rand::RngExt;
use std::collections::BTreeMap;

impl VirtualInstrument {
    /// Measures the scenes. Returns the brightest expected pixel, electrons.
    pub(super) fn specimens(
        &self,
        writer: &mut SessionWriter,
        seed: u64,
        done: &(dyn Fn(usize) + Sync),
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
                let (place, truth) = self.recorded(info, n, object);
                waiting.insert(place, truth);
                // Truths are written in order: one with the place of a later scene waits.
                while let Some(truth) = waiting.remove(&written) {
                    truths.push(truth.view())?;
                    written += 1;
                }
                let cx = lit.seen(self.context(Role::Scene, info));
                expected.push(self.sensor.expected(&lit.light_e, &self.effects, &cx).view())?;
            }
            let at = |info: &FrameInfo| lit[info.frame - batch[0].frame].clone();
            peak = peak.max(self.expose(&mut frames, batch, Draw { role: Role::Scene, seed }, at, done)?);
        }
        frames.finish()?;
        truths.finish()?;
        expected.finish()?;
        let recorded = |info: &FrameInfo| FrameInfo {
            exposure_ms: info.exposure_ms / self.record(info, n).exposure_factor,
            ..info.clone()
        };
        writer.table("scene.csv", &infos.iter().map(recorded).collect::<Vec<_>>())?;
        let mut entry = self.entry(Role::Scene);
        entry.truth = Some("scene_truth.npy".into());
        entry.expected = Some("scene_expected.npy".into());
        writer.add(entry);
        Ok(peak)
    }

    /// The record of a scene as a model that knows its faults reads it.
    fn record(&self, info: &FrameInfo, frames: usize) -> Record {
        let mut record = Record::honest(info.frame, frames);
        self.effects.on_record(&mut record, &self.context(Role::Scene, info));
        record
    }

    /// Place of a scene's object among the written truths, and the object as it is written there, so that
    /// [`Record::object`] with the same faults restores it.
    fn recorded(&self, info: &FrameInfo, frames: usize, object: &Array2<f32>) -> (usize, Array2<f32>) {
        let record = self.record(info, frames);
        // A flip is its own inverse.
        let written = Record { truth: 0, ..record }.object(std::slice::from_ref(object));
        (record.truth, written.unwrap_or_else(|| object.clone()))
    }

    /// Objects in units of the bead's light, and their light on the sensor, expected electrons. `before` is the last
    /// frame of the previous batch, and is updated.
    fn scene_batch(&self, infos: &[FrameInfo], seed: u64, before: &mut Option<Before>) -> (Vec<Array2<f32>>, Vec<Lit>) {
        let grid = self.config.manifest().object;
        // The same scenes are measured at every depth.
        let scene = |info: &FrameInfo| (info.frame % self.config.stacks.scene_frames) as u64;
        let draw = |info: &FrameInfo| self.scenes.draw(&grid, seed, "bench/specimen", scene(info));
        let mut objects: Vec<Array2<f32>> = infos.iter().map(draw).collect();
        // The light level of a scene is set without effects, so that effects change the frames and not the specimens.
        let mut clean = self.light_of(&objects, infos, (&self.optics, &Chain::default()));
        let [low, high] = self.config.stacks.scene_peak.map(|p| (p * self.config.full_scale_e()).ln());
        for ((object, light), info) in objects.iter_mut().zip(&mut clean).zip(infos) {
            let mut rng = rng::stream(seed, "bench/level", self.scenes.video(scene(info)));
            let peak = light.fold(f32::MIN_POSITIVE, |m, v| m.max(*v));
            let scale = rng.random_range(low..=high).exp() as f32 / peak;
            object.mapv_inplace(|v| v * scale);
            light.mapv_inplace(|v| v * scale);
        }
        if !self.changes_light() {
            return (objects, clean.into_iter().map(|light_e| Lit { light_e, before: None }).collect());
        }
        drop(clean);
        let mut lit = Vec::with_capacity(infos.len());
        for (light, info) in self.light_of(&objects, infos, (self.optics_now(), &self.effects)).into_iter().zip(infos) {
            let cx = self.context(Role::Scene, info);
            let mut this = Lit { light_e: light.clone(), before: before.take() };
            let seen = this.seen(cx);
            let mut with = light.clone();
            self.effects.on_light(&mut with, &seen);
            if self.effects.needs_previous() {
                let mut alone = light;
                self.effects.on_light(&mut alone, &cx);
                *before = Some(Before { light_e: alone, start_s: info.time_s });
            }
            this.light_e = with;
            lit.push(this);
        }
        (objects, lit)
    }

    /// Light of objects (in units of the bead's light) on the sensor, expected electrons, with the effects on object,
    /// rays and lenses.
    fn light_of(
        &self,
        objects: &[Array2<f32>],
        infos: &[FrameInfo],
        (optics, effects): (&VirtualOptics, &Chain),
    ) -> Vec<Array2<f32>> {
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
            // Frames at the same depth whose chief rays are equal share their PSFs.
            let alike = |i: &usize| {
                infos[*i].z_um == z_um && (still || optics.same_rays(effects, &contexts[start], &contexts[*i]))
            };
            let end = (start + 1..objects.len()).find(|i| !alike(i)).unwrap_or(objects.len());
            let moves = Moves { effects, cx: &contexts[start] };
            for l in 0..optics.lenses() {
                // Foci are stored for the optics as they were made.
                let keeps = self.keep && z_um == self.first_depth_um() && std::ptr::eq(optics, &self.optics);
                let kept = if keeps { self.cache.object(l, optics, || self.object_points()) } else { None };
                let objects = &emitted[start..end];
                let emission = Emission { objects, unit_e: self.config.scan.bead_e, z_um, kept };
                let images = optics.lens_images(l, &emission, moves);
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

    /// The depth whose foci are stored, um.
    fn first_depth_um(&self) -> f64 {
        self.config.stacks.scene_depths_um.first().copied().unwrap_or(0.0)
    }

    /// Points at the object pixels, row by row.
    fn object_points(&self) -> Vec<Point> {
        let (object, z_um) = (&self.config.object, self.first_depth_um());
        let pixels = (0..object.rows).flat_map(|r| (0..object.cols).map(move |c| (r, c)));
        pixels.map(|(r, c)| Point { at_um: self.optics.position_um(r, c), z_um }).collect()
    }
}
