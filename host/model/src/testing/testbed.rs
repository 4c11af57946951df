//! A synthetic bench for tests: analytic foci whose width, elongation and brightness vary over the field, drawn noise,
//! and a session on disk. It shares nothing with the low-rank model: each focus is a formula.

// A fixture that cannot write its files fails the test.
#![allow(clippy::unwrap_used)]

use ndarray::Array2;
use ommatidia_session::rng;
use ommatidia_session::{
    ArrayGeometry, Existing, FrameInfo, Manifest, ObjectGrid, Optics, Role, SampleType, SensorSpec, SessionWriter,
    StackEntry, StackSpec,
};
use rand_distr::{Distribution, Normal, Poisson, StandardNormal};
use std::path::Path;

/// The bench: its optics, its sensor, and the frames that it measures.
#[derive(Clone)]
pub struct Testbed {
    /// Sizes of sensor, array, optics and object.
    pub manifest: Manifest,
    /// Focus of the on-axis source through each lens, [row, col], px.
    pub anchors_px: Vec<[f64; 2]>,
    /// Relative transmission of each lens.
    pub lens_gain: Vec<f64>,
    /// Gain, DN per electron.
    pub gain_dn_per_e: f64,
    /// Read noise, electrons rms.
    pub read_noise_e: f64,
    /// Black level, DN.
    pub black_level_dn: f64,
    /// Electrons of a bead through a lens of gain 1.
    pub bead_e: f64,
    /// Seed of the noise.
    pub seed: u64,
    /// Depths of the bead scan, um; foci widen by 1 % per um.
    pub depths_um: Vec<f64>,
    /// Bead positions along one side of the scan.
    pub scan: usize,
    /// Number of dark frames.
    pub dark_frames: usize,
    /// Flat levels, electrons.
    pub flat_levels_e: Vec<f64>,
    /// Number of flat frames at each level.
    pub flat_frames: usize,
    /// Pixel response non-uniformity, rms, relative.
    pub prnu: f64,
    /// Lamp flicker of the flats, rms, relative.
    pub flicker: f64,
    /// Shortfall of the response at full scale, relative: `Q - bend Q^2 / full scale`.
    pub bend: f64,
    /// Number of scene frames with truth.
    pub scenes: usize,
    /// Changes bead frame n (DN) before it is written.
    pub spoil: fn(usize, &mut Array2<f32>),
}

impl Default for Testbed {
    fn default() -> Self {
        Self::new()
    }
}

impl Testbed {
    /// A bench of 2 x 2 lenses with a bead scan of 9 x 9 positions.
    pub fn new() -> Self {
        Self {
            manifest: Manifest {
                format: 1,
                name: "analytic foci".into(),
                sensor: SensorSpec { rows: 118, cols: 122, pixel_pitch_um: 2.0, bit_depth: 12 },
                array: ArrayGeometry::grid(2, 2, 42.0),
                optics: Optics { magnification: 0.5, psf_window_px: 15, wavelength_um: None },
                object: ObjectGrid { rows: 48, cols: 50, pixel_um: 4.0 },
                stacks: Vec::new(),
            },
            anchors_px: vec![[37.9, 41.3], [36.6, 82.2], [81.2, 38.7], [78.8, 80.55]],
            lens_gain: vec![1.0, 0.9, 1.1, 1.0],
            gain_dn_per_e: 0.4,
            read_noise_e: 2.0,
            black_level_dn: 64.25,
            bead_e: 60_000.0,
            seed: 77,
            depths_um: vec![0.0],
            scan: 9,
            dark_frames: 12,
            flat_levels_e: vec![300.0, 1000.0, 2500.0, 5000.0],
            flat_frames: 8,
            prnu: 0.0,
            flicker: 0.005,
            bend: 0.0,
            scenes: 3,
            spoil: |_, _| {},
        }
    }

    /// Adds the focus of a source of `light` electrons at object pixel `at` and depth `z_um` through every lens.
    fn add_source(&self, frame: &mut Array2<f64>, (at, z_um): ([f64; 2], f64), light: f64) {
        let size = [self.manifest.object.rows as f64, self.manifest.object.cols as f64];
        let off = [0, 1].map(|a| at[a] - (size[a] - 1.0) / 2.0);
        for (l, anchor) in self.anchors_px.iter().enumerate() {
            // Each lens has its own best place; width and stretch grow away from it.
            let best = [[-9.0, -9.0], [-8.0, 10.0], [10.0, -9.0], [8.0, 9.0]][l % 4];
            let h = [0, 1].map(|a| (off[a] - best[a]) / 24.0);
            let square = h[0] * h[0] + h[1] * h[1];
            let focus = [0, 1].map(|a| anchor[a] + off[a] + 0.08 * square * h[a]);
            let (base, stretch) = ((1.15 + 0.22 * square) * (1.0 + 0.01 * z_um), 0.12);
            let sigma = [base * (1.0 + stretch * (h[0] + 0.3 * h[1])), base * (1.0 - stretch * h[1])];
            let turn = 0.3 * h[0] * h[1];
            let light = light * self.lens_gain[l] / (1.0 + 0.15 * square);
            let norm = light / (std::f64::consts::TAU * sigma[0] * sigma[1]);
            for r in (focus[0] as isize - 12).max(0)..(focus[0] as isize + 13).min(frame.nrows() as isize) {
                for c in (focus[1] as isize - 12).max(0)..(focus[1] as isize + 13).min(frame.ncols() as isize) {
                    let (y, x) = (r as f64 - focus[0], c as f64 - focus[1]);
                    let (u, v) = (y * turn.cos() + x * turn.sin(), x * turn.cos() - y * turn.sin());
                    let exponent = (u / sigma[0]).powi(2) + (v / sigma[1]).powi(2);
                    frame[[r as usize, c as usize]] += norm * (-0.5 * exponent).exp();
                }
            }
        }
    }

    fn dark(&self) -> Array2<f64> {
        Array2::zeros((self.manifest.sensor.rows, self.manifest.sensor.cols))
    }

    /// The object of scene `i`, [object rows, object cols]: sparse points, in units of half a bead.
    pub fn object(&self, i: usize) -> Array2<f32> {
        Array2::from_shape_fn((self.manifest.object.rows, self.manifest.object.cols), |(r, c)| {
            let hash = (r * 7919 + c * 104_729 + i * 31) % 97;
            if hash == 5 { 0.1 + 0.05 * ((r + c) % 4) as f32 } else { 0.0 }
        })
    }

    /// Expected electrons of scene `i` in focus, [sensor rows, sensor cols].
    pub fn expected_e(&self, i: usize) -> Array2<f64> {
        self.expected_at(i, 0.0)
    }

    /// Expected electrons of scene `i` at depth `z_um`, [sensor rows, sensor cols].
    pub fn expected_at(&self, i: usize, z_um: f64) -> Array2<f64> {
        let mut frame = self.dark();
        for ((r, c), o) in self.object(i).indexed_iter().filter(|(_, o)| **o > 0.0) {
            self.add_source(&mut frame, ([r as f64, c as f64], z_um), 0.5 * self.bead_e * f64::from(*o));
        }
        frame
    }

    /// Response of each pixel, [sensor rows, sensor cols].
    pub fn response(&self) -> Array2<f64> {
        let mut rng = rng::stream(77, "response", 0);
        self.dark().mapv(|_| 1.0 + self.prnu * Distribution::<f64>::sample(&StandardNormal, &mut rng))
    }

    fn draw(&self, expected_e: &Array2<f64>, what: &str, i: usize) -> Array2<f32> {
        let mut rng = rng::stream(self.seed, what, i as u64);
        let read = Normal::new(0.0, self.read_noise_e).unwrap();
        let expected_e = expected_e * &self.response();
        let top = self.manifest.sensor.saturation_dn();
        let mut frame = expected_e.mapv(|e| {
            let photons = if e > 1e-9 { Poisson::new(e).unwrap().sample(&mut rng) } else { 0.0 };
            let full_e = (top - self.black_level_dn) / self.gain_dn_per_e;
            let charge = photons - self.bend * photons * photons / full_e;
            let dn = self.black_level_dn + self.gain_dn_per_e * (charge + read.sample(&mut rng));
            dn.round().clamp(0.0, top) as f32
        });
        // A fixed pattern of whole DN, and a hot pixel.
        for ((r, c), v) in frame.indexed_iter_mut() {
            *v = (*v + ((r * 13 + c * 7) % 3) as f32 - 1.0).clamp(0.0, top as f32);
        }
        frame[[3, 5]] = (frame[[3, 5]] + 500.0 + 40.0 * (i % 5) as f32).min(top as f32);
        frame
    }

    fn bead_at_um(&self, n: usize) -> [f64; 2] {
        let place = |i: usize, size: usize| {
            let last = size as f64 - 1.0;
            (i as f64 / (self.scan as f64 - 1.0) - 0.5) * last * self.manifest.object.pixel_um
        };
        [place(n / self.scan, self.manifest.object.rows), place(n % self.scan, self.manifest.object.cols)]
    }

    /// Writes the session into folder `dir`.
    ///
    /// # Panics
    /// A file cannot be written.
    pub fn write(&self, dir: &Path) {
        let mut writer = SessionWriter::create(dir, &self.manifest, Existing::Keep).unwrap();
        let dark = self.dark();
        let darks: Vec<_> = (0..self.dark_frames).map(|i| self.draw(&dark, "dark", i)).collect();
        self.stack(&mut writer, Role::Dark, "dark", &darks, None);
        let (mut flats, mut rows) = (Vec::new(), Vec::new());
        for e in &self.flat_levels_e {
            for i in 0..self.flat_frames {
                let n = rows.len();
                let lamp = 1.0 + self.flicker * [-1.0, 0.3, 1.4, -0.7, 0.0, 0.9, -1.2, 0.3][i % 8];
                let shape = Array2::from_shape_fn(dark.dim(), |(r, _)| e * lamp * (1.0 - 0.001 * r as f64));
                flats.push(self.draw(&shape, "flat", n));
                let illumination = e / 1000.0;
                rows.push(FrameInfo { illumination, ..FrameInfo::plain(n, 10.0) });
            }
        }
        self.stack(&mut writer, Role::Flat, "flat", &flats, Some(&rows));
        let (mut beads, mut rows) = (Vec::new(), Vec::new());
        for n in 0..self.scan * self.scan * self.depths_um.len() {
            let ([y_um, x_um], z_um) =
                (self.bead_at_um(n % (self.scan * self.scan)), self.depths_um[n / (self.scan * self.scan)]);
            let mut light = dark.clone();
            self.add_source(&mut light, (self.manifest.object.pixel_of_um(y_um, x_um), z_um), self.bead_e);
            let mut frame = self.draw(&light, "bead", n);
            (self.spoil)(n, &mut frame);
            beads.push(frame);
            rows.push(FrameInfo { y_um, x_um, z_um, ..FrameInfo::plain(n, 10.0) });
        }
        self.stack(&mut writer, Role::Bead, "bead", &beads, Some(&rows));
        if self.scenes > 0 {
            let scenes: Vec<_> = (0..self.scenes).map(|i| self.draw(&self.expected_e(i), "scene", i)).collect();
            let truths: Vec<_> = (0..self.scenes).map(|i| self.object(i)).collect();
            self.frames(&writer, "truth.npy", &truths);
            self.frames(&writer, "scene.npy", &scenes);
            let truth = Some("truth.npy".into());
            writer.add(StackEntry { truth, ..entry(Role::Scene, "scene") });
        }
        writer.finish().unwrap();
    }

    fn stack(&self, w: &mut SessionWriter, role: Role, name: &str, frames: &[Array2<f32>], rows: Option<&[FrameInfo]>) {
        if frames.is_empty() {
            return;
        }
        self.frames(w, &format!("{name}.npy"), frames);
        let table = rows.map(|rows| {
            let table = format!("{name}.csv");
            w.table(&table, rows).unwrap();
            table
        });
        w.add(StackEntry { table, ..entry(role, name) });
    }

    fn frames(&self, w: &SessionWriter, file: &str, frames: &[Array2<f32>]) {
        let (rows, cols) = frames[0].dim();
        let spec = StackSpec { frames: frames.len(), rows, cols, samples: SampleType::F32, pixel_um: None };
        let mut out = w.frames(file, spec).unwrap();
        frames.iter().for_each(|f| out.push(f.view()).unwrap());
        out.finish().unwrap();
    }
}

fn entry(role: Role, name: &str) -> StackEntry {
    StackEntry::plain(role, format!("{name}.npy"), 10.0)
}
