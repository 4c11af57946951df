//! Stacks without scenes: darks, flats and the bead scan.

use super::error::BenchError;
use super::foci::{Kept, Point};
use super::instrument::{Before, Draw, Lit, VirtualInstrument};
use super::optics::{Moves, PointSource};
use ndarray::Array2;
use ommatidia_physics::effects::{FrameContext, Stage};
use ommatidia_session::{FrameInfo, Role, SampleType, SessionWriter};

/// Roles of the stacks from which an instrument is calibrated.
pub(super) const CALIBRATION_ROLES: [Role; 3] = [Role::Dark, Role::Flat, Role::Bead];

/// A source of the bead scan.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bead {
    pub(super) point: Point,
    /// Index in the scan, if the foci of the scan are stored.
    pub(super) index: Option<usize>,
}

impl VirtualInstrument {
    /// Light of a frame of darks, flats or beads, and of the frame before it if an effect needs that.
    ///
    /// The frame before is formed as if it were the first: an effect carries light over one frame only.
    pub(super) fn lit(&self, role: Role, infos: &[FrameInfo], info: &FrameInfo) -> Lit {
        let previous = info.frame.checked_sub(1).and_then(|i| infos.get(i)).filter(|_| self.effects.needs_previous());
        let before =
            previous.map(|p| Before { light_e: self.light(role, p, &self.context(role, p)), start_s: p.time_s });
        let mut lit = Lit { light_e: Array2::zeros((0, 0)), before };
        lit.light_e = self.light(role, info, &lit.seen(self.context(role, info)));
        lit
    }

    /// Even light on the sensor, [sensor rows, sensor cols], electrons, with the effects that act on light.
    fn even_light(&self, electrons: f64, cx: &FrameContext<'_>) -> Array2<f32> {
        let mut light = Array2::from_elem((self.config.sensor.rows, self.config.sensor.cols), electrons as f32);
        self.effects.on_light(&mut light, cx);
        light
    }

    /// Frames at several exposures: `each` frames of every light level at every exposure. Exposures do not overlap.
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

    /// Metadata of each frame of a stack of darks, flats or beads; none for scenes.
    pub(super) fn infos(&self, role: Role) -> Vec<FrameInfo> {
        let (config, stacks) = (&self.config, &self.config.stacks);
        match role {
            Role::Dark => self.ladder(&config.dark_exposures_ms(), &[0.0], stacks.dark_frames),
            Role::Flat => self.ladder(&config.flat_exposures_ms(), &stacks.flat_levels, stacks.flat_frames),
            Role::Bead => {
                let place = |(i, Point { at_um: [y_um, x_um], z_um })| FrameInfo { x_um, y_um, z_um, ..self.info(i) };
                FrameInfo::travelled(self.scan_points().into_iter().enumerate().map(place).collect())
            }
            Role::Scene => Vec::new(),
        }
    }

    /// Light of a frame of darks, flats or beads, [sensor rows, sensor cols], electrons.
    fn light(&self, role: Role, info: &FrameInfo, cx: &FrameContext<'_>) -> Array2<f32> {
        match role {
            Role::Bead => {
                let point = Point { at_um: [info.y_um, info.x_um], z_um: info.z_um };
                self.bead_light(Bead { point, index: self.keep.then_some(info.frame) }, cx)
            }
            Role::Flat => {
                let exposure = info.exposure_ms / self.config.stacks.exposure_ms;
                self.even_light(info.illumination * self.config.full_scale_e() * exposure, cx)
            }
            Role::Dark | Role::Scene => self.even_light(0.0, cx),
        }
    }

    /// Measures darks, flats or beads. Returns the brightest expected pixel, electrons.
    pub(super) fn stack(
        &self,
        writer: &mut SessionWriter,
        draw: Draw,
        done: &(dyn Fn(usize) + Sync),
    ) -> Result<f64, BenchError> {
        let role = draw.role;
        let infos = self.infos(role);
        let entry = self.entry(role);
        let mut frames = writer.frames(&entry.file, self.spec(infos.len(), SampleType::U16))?;
        if self.keep && self.moved.is_none() && role == Role::Bead {
            // Before the threads start, which all need the same foci.
            for l in 0..self.optics.lenses() {
                self.cache.scan(l, &self.optics, || self.scan_points());
            }
        }
        let lit = |info: &FrameInfo| self.lit(role, &infos, info);
        let peak = self.expose(&mut frames, &infos, draw, lit, done)?;
        frames.finish()?;
        if let Some(table) = &entry.table {
            writer.table(table, &infos)?;
        }
        writer.add(entry);
        Ok(peak)
    }

    /// Positions of the scan, (y, x) um, in order: even steps from edge to edge of the object, or its centre for a
    /// single position.
    fn scan_um(&self) -> Vec<[f64; 2]> {
        let along = |i: usize, positions: usize, pixels: usize| {
            let half = (pixels as f64 - 1.0) / 2.0 * self.config.object.pixel_um;
            if positions == 1 { 0.0 } else { half * (2.0 * i as f64 / (positions as f64 - 1.0) - 1.0) }
        };
        let (scan, object) = (&self.config.scan, &self.config.object);
        let rows = (0..scan.rows).map(|i| along(i, scan.rows, object.rows));
        let place = |(i, y): (usize, f64)| {
            let back = scan.serpentine && i % 2 == 1;
            (0..scan.cols).map(move |j| [y, along(if back { scan.cols - 1 - j } else { j }, scan.cols, object.cols)])
        };
        rows.enumerate().flat_map(place).collect()
    }

    /// Points of the scan: every position at each depth.
    fn scan_points(&self) -> Vec<Point> {
        let positions = self.scan_um();
        let at_depth = |z_um: f64| positions.iter().map(move |at_um| Point { at_um: *at_um, z_um });
        self.config.scan.depths_um.iter().flat_map(|z_um| at_depth(*z_um)).collect()
    }

    /// Light of the bead, [sensor rows, sensor cols], expected electrons.
    pub(super) fn bead_light(&self, bead: Bead, cx: &FrameContext<'_>) -> Array2<f32> {
        let moves = Moves { effects: &self.effects, cx };
        let flux_e = self.config.scan.bead_e * self.emission_at(bead.point.at_um, cx) * cx.illumination;
        let optics = self.optics_now();
        let mut work = optics.work();
        let mut light = Array2::zeros((self.config.sensor.rows, self.config.sensor.cols));
        let per_lens = self.effects.acts_at(Stage::Lens);
        for l in 0..optics.lenses() {
            let kept = bead.index.filter(|_| self.moved.is_none()).and_then(|index| {
                let foci = self.cache.scan(l, optics, || self.scan_points())?;
                Some(Kept { foci, index })
            });
            let source = PointSource { point: bead.point, flux_e, kept };
            if per_lens {
                let mut image = Array2::zeros(light.dim());
                optics.add_point(l, &source, moves, &mut work, &mut image);
                self.effects.on_lens(&mut image, &FrameContext { lens: l, ..*cx });
                light += &image;
            } else {
                optics.add_point(l, &source, moves, &mut work, &mut light);
            }
        }
        self.effects.on_light(&mut light, cx);
        light
    }

    /// Emission at (y, x) um of a source of unit light, as effects on the object change it: an even object is changed
    /// and interpolated there.
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
}
