//! What the tests of the program share: a tiny measured session, and the program itself.
#![allow(dead_code, clippy::unwrap_used)]

pub mod desk;
pub mod miniscope;
mod tiny;

pub use tiny::{Fault, TinySession};

use assert_cmd::Command;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// `ommatidia` with the given arguments, quiet.
pub fn ommatidia(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ommatidia"));
    command.arg("--quiet").args(args);
    command
}

/// Runs the program and expects a failure: exit code 1, one error on stderr that holds each of `words`, nothing on
/// stdout, and neither `output` nor a temporary file left in its folder.
pub fn refused(args: &[&str], output: Option<&Path>, words: &[&str]) {
    let before = output.map(siblings);
    let run = ommatidia(args).output().unwrap();
    let stderr = String::from_utf8_lossy(&run.stderr).into_owned();
    assert_eq!(run.status.code(), Some(1), "exit code of {args:?}; stderr: {stderr}");
    assert!(run.stdout.is_empty(), "stdout of {args:?} must be empty");
    assert!(!stderr.contains("panicked"), "panic: {stderr}");
    for word in words {
        assert!(stderr.contains(word), "`{word}` is not in the error of {args:?}:\n{stderr}");
    }
    assert_eq!(before, output.map(siblings), "{args:?} left something behind");
}

/// The bytes of all files of a folder and those below it, by path relative to it.
pub fn contents(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut all = BTreeMap::new();
    for entry in std::fs::read_dir(folder).unwrap().map(Result::unwrap) {
        let name = PathBuf::from(entry.file_name());
        if entry.path().is_dir() {
            all.extend(contents(&entry.path()).into_iter().map(|(path, bytes)| (name.join(path), bytes)));
        } else {
            all.insert(name, std::fs::read(entry.path()).unwrap());
        }
    }
    all
}

fn siblings(output: &Path) -> Vec<String> {
    let mut names: Vec<String> = std::fs::read_dir(output.parent().unwrap())
        .unwrap()
        .map(|e| e.unwrap().file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}
