//! A 3 x 3 instrument of Gaussian foci, small enough to be written by each test, and the faults it may have.

use ndarray::Array2;
use ommatidia_session::rng;
use ommatidia_session::stack::{SampleType, StackSpec};
use ommatidia_session::{
    ArrayGeometry, Existing, FrameInfo, Manifest, ObjectGrid, Optics, Role, SensorSpec, SessionWriter, StackEntry,
};
use rand_distr::{Distribution, StandardNormal};
use std::path::{Path, PathBuf};

/// What is wrong with the measurement (the files themselves are sound).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    None,
    /// The bead of this frame is so bright that its foci clip.
    Saturated(usize),
    /// The table puts the bead of this frame outside the field.
    Outside(usize),
    /// This lens shows nothing.
    DeadLens(usize),
}

const ROWS: usize = 80;
const OBJECT: usize = 24;
const PITCH: f64 = 20.0;
const BLACK: f64 = 100.0;
const GAIN: f64 = 0.5;
const READ_NOISE_E: f64 = 2.0;
const PIXEL_UM: f64 = 2.8;
const SATURATION: f64 = 4095.0;

/// A session on disk; the folder is removed with it.
pub struct TinySession {
    folder: tempfile::TempDir,
}

impl TinySession {
    /// Measures a session with the given fault.
    pub fn new(fault: Fault) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let session = Self { folder };
        session.measure(fault);
        session
    }

    /// The session's folder.
    pub fn path(&self) -> PathBuf {
        self.folder.path().join("session")
    }

    /// A path beside the session, for outputs.
    pub fn beside(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Replaces the bytes of one of the session's files.
    pub fn edit(&self, name: &str, edit: impl FnOnce(Vec<u8>) -> Vec<u8>) {
        let path = self.path().join(name);
        std::fs::write(&path, edit(std::fs::read(&path).unwrap())).unwrap();
    }

    fn measure(&self, fault: Fault) {
        let mut writer = SessionWriter::create(&self.path(), &manifest(), Existing::Keep).unwrap();
        let dark = |_: usize| Array2::zeros((ROWS, ROWS));
        write(&mut writer, Role::Dark, "dark", (0..8).map(|i| FrameInfo::plain(i, 10.0)).collect(), dark);
        let levels = |i: usize| [0.25, 0.5, 1.0][i / 8];
        let rows = (0..24).map(|i| FrameInfo { illumination: levels(i), ..FrameInfo::plain(i, 10.0) }).collect();
        write(&mut writer, Role::Flat, "flat", rows, |i| Array2::from_elem((ROWS, ROWS), 4000.0 * levels(i)));
        let positions: Vec<[f64; 2]> =
            (0..25).map(|i| [i / 5, i % 5].map(|k| (k as f64 - 2.0) * 5.5 * PIXEL_UM)).collect();
        let rows = positions.iter().enumerate().map(|(i, [y, x])| FrameInfo {
            y_um: if fault == Fault::Outside(i) { 900.0 } else { *y },
            x_um: *x,
            ..FrameInfo::plain(i, 10.0)
        });
        write(&mut writer, Role::Bead, "bead", rows.collect(), |i| {
            let peak = if fault == Fault::Saturated(i) { 60_000.0 } else { 4000.0 };
            foci(positions[i], peak, fault)
        });
        writer.finish().unwrap();
    }
}

fn manifest() -> Manifest {
    Manifest {
        format: 1,
        name: "tiny".into(),
        sensor: SensorSpec { rows: ROWS, cols: ROWS, pixel_pitch_um: 1.85, bit_depth: 12 },
        array: ArrayGeometry::grid(3, 3, PITCH),
        optics: Optics { magnification: 1.85 / PIXEL_UM, psf_window_px: 9, wavelength_um: None },
        object: ObjectGrid { rows: OBJECT, cols: OBJECT, pixel_um: PIXEL_UM },
        stacks: Vec::new(),
    }
}

/// Expected electrons of a bead at (y, x) um: one Gaussian a lens, wider and dimmer away from the lens's axis.
fn foci([y, x]: [f64; 2], peak_e: f64, fault: Fault) -> Array2<f64> {
    let mut light = Array2::zeros((ROWS, ROWS));
    let middle = (ROWS as f64 - 1.0) / 2.0;
    for lens in 0..9 {
        if fault == Fault::DeadLens(lens) {
            continue;
        }
        let [row, col] = [(lens / 3, y), (lens % 3, x)].map(|(k, p)| middle + (k as f64 - 1.0) * PITCH + p / PIXEL_UM);
        let radius2 = ((row - middle).powi(2) + (col - middle).powi(2)) / 1500.0;
        let variance = 1.0 + 0.4 * radius2;
        light.indexed_iter_mut().for_each(|((r, c), e)| {
            let d2 = (r as f64 - row).powi(2) + (c as f64 - col).powi(2);
            *e += peak_e / (1.0 + 0.2 * radius2) * (-d2 / (2.0 * variance)).exp();
        });
    }
    light
}

fn write(
    writer: &mut SessionWriter,
    role: Role,
    name: &str,
    rows: Vec<FrameInfo>,
    light: impl Fn(usize) -> Array2<f64>,
) {
    let (file, table) = (format!("{name}.npy"), format!("{name}.csv"));
    let spec = StackSpec { frames: rows.len(), rows: ROWS, cols: ROWS, samples: SampleType::U16, pixel_um: None };
    let mut frames = writer.frames(&file, spec).unwrap();
    for i in 0..rows.len() {
        let mut noise = rng::stream(1, name, i as u64);
        let frame = light(i).mapv(|e| {
            let g: f64 = StandardNormal.sample(&mut noise);
            let electrons = e + (e + READ_NOISE_E.powi(2)).sqrt() * g;
            (BLACK + GAIN * electrons).round().clamp(0.0, SATURATION) as f32
        });
        frames.push(frame.view()).unwrap();
    }
    frames.finish().unwrap();
    writer.table(&table, &rows).unwrap();
    writer.add(StackEntry { table: Some(table), ..StackEntry::plain(role, file, 10.0) });
}

/// Where a file of the session lies, for messages.
pub fn name(path: &Path) -> &str {
    path.file_name().unwrap().to_str().unwrap()
}
