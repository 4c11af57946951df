//! Ctrl-C: says how to go on, and leaves no unfinished file behind.

use super::files::Files;
use anyhow::Context;
use ommatidia_session::artifact::remove_leftovers;
use std::io::Write;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// What the runs of this process write, the innermost last: verbs such as `demo` run other verbs.
static RUNS: Mutex<Vec<Stopped>> = Mutex::new(Vec::new());

/// What is to be done when a run is stopped.
struct Stopped {
    outputs: Vec<PathBuf>,
    /// Their locks, which this process holds.
    locks: Vec<PathBuf>,
    how_to_go_on: &'static str,
}

/// Exit code of a program that Ctrl-C ends: 128 and the number of the signal.
const EXIT_CODE: i32 = 130;

fn runs() -> MutexGuard<'static, Vec<Stopped>> {
    RUNS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Installs the handler of Ctrl-C and of a request to terminate.
///
/// # Errors
/// The system refuses.
pub fn listen() -> anyhow::Result<()> {
    ctrlc::set_handler(|| {
        let runs = runs();
        runs.iter().flat_map(|run| &run.outputs).for_each(|output| remove_leftovers(output));
        runs.iter().flat_map(|run| &run.locks).for_each(|lock| drop(std::fs::remove_file(lock)));
        // The outermost run is the command that the user gave.
        let how = runs.first().map_or("nothing was begun", |run| run.how_to_go_on);
        let _ = writeln!(std::io::stderr(), "\nstopped; {how}");
        std::process::exit(EXIT_CODE);
    })
    .context("Ctrl-C cannot be handled")
}

/// Says how to go on, until it is dropped.
pub struct Advice;

impl Drop for Advice {
    fn drop(&mut self) {
        runs().pop();
    }
}

/// From now on Ctrl-C says how to go on with a run that writes these files, and holds their locks.
pub fn advise(files: &Files) -> Advice {
    let (outputs, how_to_go_on) = files.advice();
    runs().push(Stopped { outputs, locks: files.locks(), how_to_go_on });
    Advice
}
