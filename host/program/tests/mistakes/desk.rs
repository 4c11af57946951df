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

use crate::common::{Fault, TinySession, ommatidia};
use ndarray::Array3;
use ommatidia_session::stack;
use std::path::Path;
use std::sync::LazyLock;
use tempfile::TempDir;

static ORIGINAL: LazyLock<TempDir> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let session = TinySession::new(Fault::None);
    copy(&session.path(), &folder.path().join("session"));
    let objects =
        Array3::from_shape_fn((3, 24, 24), |(i, r, c)| if (r + i) % 7 == 3 && c % 5 == 2 { 0.2 } else { 0.01 });
    stack::write(&folder.path().join("objects.npy"), objects.view()).unwrap();
    for command in [
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
