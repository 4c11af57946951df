//! The program that the tests run.
#![allow(clippy::unwrap_used)]

use std::path::{Path, PathBuf};
use std::process::Command;

/// The program, built as this test was: it lies two folders above the test (`cargo test --workspace` builds it), and is
/// built here if it is missing.
pub fn program() -> PathBuf {
    let test = std::env::current_exe().unwrap();
    let profile = test.parent().and_then(Path::parent).unwrap();
    let program = profile.join("ommatidia");
    if !program.exists() {
        let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
        cargo.args(["build", "--bin", "ommatidia"]).current_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join(".."));
        cargo.arg("--target-dir").arg(profile.parent().unwrap());
        if profile.ends_with("release") {
            cargo.arg("--release");
        }
        assert!(cargo.status().unwrap().success(), "the program cannot be built: {cargo:?}");
    }
    assert!(program.exists(), "{} is missing", program.display());
    program
}
