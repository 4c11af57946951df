//! A desk: a folder with the files of one project, made by the program itself.
//!
//! | path | what |
//! |---|---|
//! | `session/` | measured session of a tiny instrument: darks, flats, a bead scan |
//! | `instrument` | calibrated from it |
//! | `pairs/` | eight training pairs |
//! | `network` | checkpoint of a training of two steps |
//! | `network.omm` | its network file |
//! | `frames.npy`, `objects.npy` | three objects and their predicted frames |
//! | `report.html` | report of the instrument |
//! | `bench.toml`, `scenes/` | a small virtual instrument, and its session with scenes of known objects |
//! | `scenes.instrument` | calibrated from it |

use super::{Fault, TinySession, ommatidia};
use ndarray::Array3;
use ommatidia_session::stack;
use std::path::Path;
use std::sync::LazyLock;
use tempfile::TempDir;

/// Two lenses, and no more light paths than needed.
const BENCH: &str = "
sensor = { rows = 50, cols = 70 }
array = { rows = 1, cols = 2, pitch_px = 20.0, placement_rms_px = 0.3 }
optics = { aperture_um = 20.0, psf_window_px = 13, object_distance_um = 300.0, psf_field_px = 31 }
object = { rows = 18, cols = 22, pixel_um = 2.8 }
scan = { rows = 5, cols = 5, bead_e = 30000.0 }
stacks = { dark_frames = 4, flat_levels = [0.2, 0.4], flat_frames = 4, scene_frames = 4 }
";

static ORIGINAL: LazyLock<TempDir> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let session = TinySession::new(Fault::None);
    copy(&session.path(), &folder.path().join("session"));
    let objects =
        Array3::from_shape_fn((3, 24, 24), |(i, r, c)| if (r + i) % 7 == 3 && c % 5 == 2 { 0.2 } else { 0.01 });
    stack::write(&folder.path().join("objects.npy"), objects.view()).unwrap();
    std::fs::write(folder.path().join("bench.toml"), BENCH).unwrap();
    for command in [
        "bench scenes --config bench.toml --frames 4",
        "calibrate scenes -o scenes.instrument",
        "calibrate session -o instrument",
        "simulate instrument -o pairs --count 8",
        "train pairs -o network --filters 2 --steps 2",
        "quantize network -o network.omm",
        "predict instrument objects.npy -o frames.npy",
        "report instrument -o report.html",
    ] {
        let words: Vec<&str> = command.split_whitespace().collect();
        ommatidia(&words).current_dir(folder.path()).assert().success();
    }
    folder
});

/// A fresh copy of the desk; it is removed with the value.
pub fn new() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    copy(ORIGINAL.path(), folder.path());
    folder
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap().map(Result::unwrap) {
        let to = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy(&entry.path(), &to)
        } else {
            std::fs::copy(entry.path(), to).map(|_| ()).unwrap()
        }
    }
}
