//! Every verb is killed at random times, as the system kills a program (SIGKILL): no input changes, each output is
//! whole or absent, and the same command then ends in the same bytes and leaves no unfinished file behind.
//!
//! `OMMATIDIA_KILLS` sets how often each verb is killed (default: 4).
#![cfg(unix)]
#![allow(clippy::unwrap_used)]

mod common;

use common::{contents, desk};
use ommatidia_session::rng;
use rand::RngExt;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

type Contents = BTreeMap<PathBuf, Vec<u8>>;

/// A command that writes files, and how it goes on after it was killed.
struct Verb {
    command: &'static str,
    /// Option of the second run where an output exists.
    again: &'static str,
    /// Whether two runs write the same bytes: not where times are measured.
    repeats: bool,
}

const fn verb(command: &'static str) -> Verb {
    Verb { command, again: "--force", repeats: true }
}

fn start(command: &str, again: &str, desk: &Path) -> Command {
    let mut process = Command::new(env!("CARGO_BIN_EXE_ommatidia"));
    process.args(["--quiet", "--threads", "1"]).args(command.split_whitespace()).args(again.split_whitespace());
    process.current_dir(desk).stdout(Stdio::null()).stderr(Stdio::null());
    process
}

/// Files that a run added or changed; locks and unfinished files of a killed run are not results.
fn results(before: &Contents, after: &Contents) -> Contents {
    let hidden = |path: &Path| path.iter().any(|part| part.to_string_lossy().starts_with('.'));
    let new = after.iter().filter(|(path, bytes)| before.get(*path) != Some(bytes) && !hidden(path));
    new.map(|(path, bytes)| (path.clone(), bytes.clone())).collect()
}

fn is_intermediate(verb: &Verb) -> bool {
    // A training replaces its checkpoint as it goes on: each is whole, and none but the last is the result.
    verb.again == "--resume"
}

/// Kills a verb, at times that depend on the name of the test.
fn loses_nothing(name: &str, verb: &Verb) {
    let kills: u64 = std::env::var("OMMATIDIA_KILLS").ok().and_then(|n| n.parse().ok()).unwrap_or(4);
    let whole = desk::new();
    let before = contents(whole.path());
    let begin = Instant::now();
    assert!(start(verb.command, "", whole.path()).status().unwrap().success(), "{}", verb.command);
    let length = begin.elapsed();
    let expected = results(&before, &contents(whole.path()));
    assert!(!expected.is_empty(), "{} wrote nothing", verb.command);
    let mut random = rng::stream(5, name, 0);
    for _ in 0..kills {
        let desk = desk::new();
        let after: f64 = random.random_range(0.0..1.0);
        let mut child = start(verb.command, "", desk.path()).spawn().unwrap();
        std::thread::sleep(Duration::from_secs_f64(after * length.as_secs_f64()));
        child.kill().unwrap();
        child.wait().unwrap();
        let named = || format!("{}, killed after {:.0} %", verb.command, 100.0 * after);
        let left = contents(desk.path());
        let unchanged = before.iter().all(|(path, bytes)| left.get(path) == Some(bytes));
        assert!(unchanged, "{}: an input changed", named());
        let found = results(&before, &left);
        for (path, bytes) in found.iter().filter(|_| !is_intermediate(verb)) {
            let whole = expected.get(path).unwrap_or_else(|| panic!("{}: {} is no result", named(), path.display()));
            let fits = if verb.repeats { whole == bytes } else { whole.len().abs_diff(bytes.len()) < 4096 };
            assert!(fits, "{}: {} is not whole", named(), path.display());
        }
        let again = if found.is_empty() { "" } else { verb.again };
        assert!(start(verb.command, again, desk.path()).status().unwrap().success(), "{}: again", named());
        let end = contents(desk.path());
        let results = results(&before, &end);
        assert!(results.keys().eq(expected.keys()), "{}: other files: {:?}", named(), results.keys());
        assert!(!verb.repeats || results == expected, "{}: other bytes", named());
        let hidden = |path: &&PathBuf| path.iter().any(|part| part.to_string_lossy().starts_with('.'));
        let rest: Vec<&PathBuf> = end.keys().filter(hidden).collect();
        assert!(rest.is_empty(), "{}: {rest:?} was left behind", named());
    }
}

/// A test for each verb, so that they run side by side.
macro_rules! killed {
    ($($name:ident: $verb:expr;)*) => {
        $(#[test]
        fn $name() {
            loses_nothing(stringify!($name), &$verb);
        })*
    };
}

killed! {
    calibrate: verb("calibrate session -o new");
    simulate: verb("simulate instrument -o new --count 80");
    train: Verb { again: "--resume", ..verb("train pairs -o new --filters 2 --steps 40") };
    quantize: verb("quantize network -o new");
    predict: verb("predict instrument objects.npy -o new.npy");
    predict_with_noise: verb("predict instrument objects.npy -o new.tif --noise");
    reconstruct_by_network: verb("reconstruct frames.npy -o new.tif --with network.omm");
    reconstruct_by_instrument: verb("reconstruct frames.npy -o new.npy --with instrument");
    residual: verb("residual scenes --instrument scenes.instrument -o new --report new.html");
    close: Verb { repeats: false, ..verb("close scenes --instrument scenes.instrument -o new --report new.html") };
    report: verb("report instrument network session -o new.html");
    erf: verb("erf network --instrument instrument -o new");
    export: verb("export network -o new");
    device: verb("device run --on host --with network.omm --frames frames.npy -o new.npy");
    bench: verb("bench new --frames 2 --config bench.toml");
    evaluate: Verb { repeats: false, ..verb("evaluate scenes --with scenes.instrument --methods wiener -o new") };
}
