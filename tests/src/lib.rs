//! What the tests share: where measured data lie, and how a test says that it was skipped.

use std::io::Write;
use std::path::PathBuf;

/// A folder of measured data: `$OMMATIDIA_DATA/NAME`, or `NAME` in `shared/data` beside the project.
///
/// Measured data are not part of the project. Where they are absent the calling test is recorded as skipped, with the
/// reason, and gets `None`.
pub fn measured_data(test: &str, name: &str) -> Option<PathBuf> {
    let beside = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/data");
    let folder = std::env::var_os("OMMATIDIA_DATA").map_or(beside, PathBuf::from).join(name);
    if folder.exists() {
        return Some(folder);
    }
    skip(test, &format!("no measured data at {}; set OMMATIDIA_DATA to the folder that holds them", folder.display()));
    None
}

/// Records that a test was skipped and why: on stderr, and in the file that `cargo verify` counts.
pub fn skip(test: &str, why: &str) {
    eprintln!("skipped {test}: {why}");
    let Some(path) = std::env::var_os("OMMATIDIA_SKIPPED") else { return };
    if let Ok(mut file) = std::fs::OpenOptions::new().create(true).append(true).open(path) {
        let _ = writeln!(file, "{test}: {why}");
    }
}
