//! Runs steps two at a time, each as a process of its own whose output is kept and printed when it ends.

use crate::counts::Counts;
use crate::steps::Step;
use crate::toolchain::target_dir;
use anyhow::{Context, Result};
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Condvar, Mutex, PoisonError};

/// The argument that makes this program run one step, whose name follows.
pub const FLAG: &str = "--step";

/// Steps that run at the same time. A compiler that optimises a large crate as one unit, and a test under the emulator,
/// use one processor each.
const WORKERS: usize = 2;

struct Queue {
    waiting: Vec<Step>,
    running: usize,
    ended: Vec<&'static str>,
    total: Counts,
}

impl Queue {
    /// Takes the first step whose predecessors have ended.
    fn take(&mut self) -> Option<Step> {
        let is_ready = |step: &Step| step.after.iter().all(|name| self.ended.contains(name));
        let step = self.waiting.remove(self.waiting.iter().position(is_ready)?);
        self.running += 1;
        Some(step)
    }

    fn end(&mut self, step: &Step, counts: Counts) {
        self.running -= 1;
        self.ended.push(step.name);
        self.total += counts;
    }
}

/// Runs all steps with `program`, this program's file, and counts. Its path must be found before anything is built: the
/// build of all tests puts another file in its place.
pub fn run(program: &Path, steps: Vec<Step>) -> Counts {
    let queue = Queue { waiting: steps, running: 0, ended: Vec::new(), total: Counts::default() };
    let (queue, changed) = (Mutex::new(queue), Condvar::new());
    let lock = || queue.lock().unwrap_or_else(PoisonError::into_inner);
    let work = || {
        let mut state = lock();
        loop {
            if let Some(step) = state.take() {
                let log = log(step.name);
                println!("\nbegins: {}; its output comes when it ends (now in {})", step.name, log.display());
                drop(state);
                let counts = run_one(program, step.name, &log);
                state = lock();
                print(&log, &counts);
                state.end(&step, counts.unwrap_or_else(|_| Counts::check(false)));
                changed.notify_all();
            } else if state.running == 0 {
                return;
            } else {
                state = changed.wait(state).unwrap_or_else(PoisonError::into_inner);
            }
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..WORKERS {
            scope.spawn(work);
        }
    });
    let state = lock();
    let mut total = state.total;
    for step in &state.waiting {
        println!("\n{} did not run: one of {:?} is no step, or comes after it", step.name, step.after);
        total += Counts::check(false);
    }
    total
}

/// Where the output of a step goes.
fn log(name: &str) -> PathBuf {
    let name = name.replace(|c: char| !c.is_ascii_alphanumeric(), "-");
    target_dir().join("verify").join(format!("{name}.log"))
}

/// Runs a step as a process of its own. One that ends without a total has failed.
fn run_one(program: &Path, name: &str, log: &Path) -> Result<Counts> {
    let folder = log.parent().context("a log lies in a folder")?;
    std::fs::create_dir_all(folder).with_context(|| format!("{} cannot be created", folder.display()))?;
    let out = File::create(log).with_context(|| format!("{} cannot be written", log.display()))?;
    let mut command = Command::new(program);
    command.args([FLAG, name]).stdout(out.try_clone()?).stderr(out);
    let status = command.status().with_context(|| format!("{command:?} could not be started"))?;
    let text = std::fs::read(log).with_context(|| format!("{} cannot be read", log.display()))?;
    let text = String::from_utf8_lossy(&text);
    let total = text.trim_end().lines().last().and_then(Counts::of_total);
    total.with_context(|| format!("{name} did not end: {status}"))
}

/// Prints what a step has written, without its total, or why it could not run.
fn print(log: &Path, counts: &Result<Counts>) {
    let text = std::fs::read(log).unwrap_or_default();
    let text = String::from_utf8_lossy(&text);
    match counts {
        Ok(_) => println!("{}", text.trim_end().rsplit_once('\n').unwrap_or_default().0.trim_end()),
        Err(error) => println!("{}\n{error:#}", text.trim_end()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_waits_for_those_before_it_and_the_first_ready_one_is_taken() {
        let step = |name, after| Step { name, after, run: || Ok(Counts::check(true)) };
        let waiting = vec![step("tests", &["build", "images"]), step("build", &[]), step("images", &[])];
        let mut queue = Queue { waiting, running: 0, ended: Vec::new(), total: Counts::default() };
        let (build, images) = (queue.take().unwrap(), queue.take().unwrap());
        assert_eq!((build.name, images.name, queue.running), ("build", "images", 2));
        assert!(queue.take().is_none());
        queue.end(&images, Counts::check(false));
        assert!(queue.take().is_none(), "one of the two still runs");
        queue.end(&build, Counts::check(true));
        assert_eq!(queue.take().unwrap().name, "tests");
        assert_eq!(queue.total, Counts { passed: 1, failed: 1, skipped: 0 });
    }

    #[test]
    fn steps_that_cannot_begin_are_failures() {
        let never = Step { name: "never", after: &["no step"], run: || Ok(Counts::check(true)) };
        assert_eq!(run(Path::new("not started"), vec![never]), Counts::check(false));
    }
}
