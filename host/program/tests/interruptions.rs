//! What a training is worth that is killed, or whose disk is full: the program as a process, ended as the system ends
//! it.
#![allow(clippy::unwrap_used)]

mod common;

use common::{Fault, TinySession, ommatidia};
use ommatidia_network::train::Checkpoint;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

const STEPS: u64 = 600;

/// Training pairs of a tiny instrument, in a folder that is removed with them.
fn pairs() -> (TinySession, PathBuf) {
    let session = TinySession::new(Fault::None);
    let [instrument, pairs] = ["instrument", "pairs"].map(|name| session.beside(name));
    let text = |path: &Path| path.to_str().unwrap().to_string();
    ommatidia(&["calibrate", &text(&session.path()), "-o", &text(&instrument)]).assert().success();
    ommatidia(&["simulate", &text(&instrument), "-o", &text(&pairs), "--count", "16"]).assert().success();
    (session, pairs)
}

/// Options of a training that takes some seconds.
fn train(pairs: &Path, output: &Path) -> Vec<String> {
    let steps = STEPS.to_string();
    let words = ["train", pairs.to_str().unwrap(), "-o", output.to_str().unwrap(), "--filters", "2", "--steps", &steps];
    words.map(String::from).to_vec()
}

fn start(words: &[String]) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ommatidia"));
    command.arg("--quiet").args(words).stdout(Stdio::null()).spawn().unwrap()
}

fn step(path: &Path) -> u64 {
    if path.exists() { Checkpoint::read(path).unwrap().body.step } else { 0 }
}

/// Waits until a training has written something newer, and a little longer, so that it is in the midst of a step or of
/// the next file.
fn wait_for_more_than(step_before: u64, path: &Path, longer: Duration) {
    let begin = Instant::now();
    while step(path) <= step_before {
        assert!(begin.elapsed() < Duration::from_secs(120), "no checkpoint after two minutes");
        std::thread::sleep(Duration::from_millis(5));
    }
    std::thread::sleep(longer);
}

#[test]
fn a_training_that_is_killed_ends_in_the_same_bytes() {
    let (session, pairs) = pairs();
    let [whole, killed] = ["whole", "killed"].map(|name| session.beside(name));
    assert!(start(&train(&pairs, &whole)).wait().unwrap().success());
    let mut words = train(&pairs, &killed);
    for longer in [0, 7, 23].map(Duration::from_millis) {
        let before = step(&killed);
        let mut child = start(&words);
        wait_for_more_than(before, &killed, longer);
        child.kill().unwrap();
        assert!(!child.wait().unwrap().success(), "it was over before it was killed");
        // Whatever it was doing, a whole checkpoint stands.
        assert!((before + 1..STEPS).contains(&step(&killed)));
        words = train(&pairs, &killed);
        words.push("--resume".into());
    }
    assert!(start(&words).wait().unwrap().success());
    assert!(std::fs::read(whole).unwrap() == std::fs::read(killed).unwrap());
}

#[test]
fn a_training_that_is_interrupted_leaves_no_lock() {
    let (session, pairs) = pairs();
    let output = session.beside("network");
    let mut child = start(&train(&pairs, &output));
    wait_for_more_than(0, &output, Duration::ZERO);
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    assert_eq!(child.wait().unwrap().code(), Some(130));
    let names = std::fs::read_dir(session.beside("")).unwrap().flatten().map(|e| e.file_name());
    let hidden: Vec<_> = names.filter(|name| name.to_string_lossy().starts_with('.')).collect();
    assert!(hidden.is_empty(), "{hidden:?} was left");
}

/// A limit on the size of files acts as a full disk does: the write fails in its midst.
#[test]
fn a_full_disk_leaves_the_last_checkpoint() {
    let (session, pairs) = pairs();
    let output = session.beside("network");
    let limited = |words: &[String]| {
        let script = r#"trap '' XFSZ; ulimit -f 200; exec "$@""#;
        let mut command = Command::new("sh");
        command.args(["-c", script, "sh", env!("CARGO_BIN_EXE_ommatidia"), "--quiet"]).args(words).output().unwrap()
    };
    let failed = |words: &[String]| {
        let run = limited(words);
        let error = String::from_utf8_lossy(&run.stderr).into_owned();
        assert_eq!(run.status.code(), Some(1), "{error}");
        assert!(error.contains("network") && error.contains("too large"), "{error}");
        let litter = std::fs::read_dir(session.beside(""))
            .unwrap()
            .flatten()
            .find(|e| e.file_name().to_string_lossy().starts_with(".ommatidia"));
        assert!(litter.is_none(), "{litter:?} was left");
    };
    let words = train(&pairs, &output);
    failed(&words);
    assert!(!output.exists());
    let mut child = start(&words);
    wait_for_more_than(0, &output, Duration::ZERO);
    child.kill().unwrap();
    child.wait().unwrap();
    let before = std::fs::read(&output).unwrap();
    std::fs::read_dir(session.beside(""))
        .unwrap()
        .flatten()
        .filter(|e| e.file_name().to_string_lossy().starts_with(".ommatidia"))
        .for_each(|e| std::fs::remove_file(e.path()).unwrap());
    failed(&[words, vec!["--resume".into()]].concat());
    assert!(std::fs::read(&output).unwrap() == before);
}
