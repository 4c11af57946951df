//! One file of a sound session is replaced by the input: the session is refused in words, or read to its last frame.

use ommatidia_session::stack::{SampleType, StackSpec};
use ommatidia_session::*;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

const FILES: [&str; 6] = ["session.toml", "bead.csv", "bead.npy", "scene.tif", "truth.npy", "scene.csv"];

/// A folder with a sound session, and the bytes of its files.
static SOUND: LazyLock<(PathBuf, Vec<Vec<u8>>)> = LazyLock::new(|| {
    let base = Path::new("/dev/shm").is_dir().then(|| "/dev/shm".into()).unwrap_or_else(std::env::temp_dir);
    let folder = tempfile::tempdir_in(base).expect("a folder").keep().join("session");
    write(&folder).expect("a sound session");
    let bytes = FILES.map(|file| std::fs::read(folder.join(file)).expect("its files")).to_vec();
    (folder, bytes)
});

/// Tries one input. Panics where the module's claim does not hold.
pub fn try_input(data: &[u8]) {
    let Some((which, hostile)) = data.split_first() else { return };
    let (folder, sound) = &*SOUND;
    let which = usize::from(*which) % FILES.len();
    std::fs::write(folder.join(FILES[which]), hostile).expect("room");
    read(folder);
    std::fs::write(folder.join(FILES[which]), &sound[which]).expect("room");
}

/// Reads all that a session has. A stack may claim to be large; then its first frames will do.
fn read(folder: &Path) {
    let Ok(session) = Session::open(folder) else { return };
    for stack in session.stacks() {
        if let Ok(mut frames) = stack.frames() {
            (0..stack.len().min(4)).for_each(|i| drop(frames.read(i)));
        }
        if let Ok(Some(mut truth)) = stack.truth() {
            (0..truth.len().min(4)).for_each(|i| drop(truth.read(i)));
        }
    }
}

fn write(folder: &Path) -> Result<(), SessionError> {
    let manifest = Manifest {
        format: 1,
        name: "fuzz".into(),
        sensor: SensorSpec { rows: 4, cols: 5, pixel_pitch_um: 2.0, bit_depth: 12 },
        array: ArrayGeometry::grid(1, 1, 0.0),
        optics: Optics { magnification: 0.5, psf_window_px: 3, wavelength_um: None },
        object: ObjectGrid { rows: 3, cols: 2, pixel_um: 4.0 },
        stacks: Vec::new(),
    };
    let entry = |role, file: &str, table: &str, truth: Option<&str>| StackEntry {
        table: Some(table.into()),
        truth: truth.map(Into::into),
        ..StackEntry::plain(role, file, 10.0)
    };
    let mut writer = SessionWriter::create(folder, &manifest, Existing::Keep)?;
    let stacks = [
        ("bead.npy", 4, 5, SampleType::U16),
        ("scene.tif", 4, 5, SampleType::U16),
        ("truth.npy", 3, 2, SampleType::F32),
    ];
    for (name, rows, cols, samples) in stacks {
        let spec = StackSpec { frames: 2, rows, cols, samples, pixel_um: Some(2.0) };
        let mut frames = writer.frames(name, spec)?;
        for f in 0..2 {
            frames.push(ndarray::Array2::from_elem((rows, cols), f as f32).view())?;
        }
        frames.finish()?;
    }
    let rows: Vec<FrameInfo> = (0..2).map(|i| FrameInfo::plain(i, 10.0)).collect();
    writer.table("bead.csv", &rows)?;
    writer.table("scene.csv", &rows)?;
    writer.add(entry(Role::Bead, "bead.npy", "bead.csv", None));
    writer.add(entry(Role::Scene, "scene.tif", "scene.csv", Some("truth.npy")));
    writer.finish()
}
