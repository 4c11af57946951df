//! `cargo verify`: everything that must hold before a change lands, in one command.
//!
//! Formatting, lints, documentation, the firmware image, all tests with QEMU parity, the Python package. What the
//! machine lacks is installed, or the run fails and says how to install it; nothing is left out in silence. The last
//! line is `N passed, N failed, N skipped`.
//!
//! `cargo verify TEXT...` runs only the steps whose names contain one of the texts, which is no proof of anything: it
//! is for work on that step.

mod counts;
mod disk;
mod python;
mod queue;
mod steps;
mod toolchain;

use counts::Counts;
use std::process::ExitCode;
use steps::Step;

fn main() -> ExitCode {
    let wanted: Vec<String> = std::env::args().skip(1).collect();
    let total = match wanted.as_slice() {
        [] => everything(),
        [flag, name] if flag == queue::FLAG => run(steps::rest().into_iter().filter(|step| step.name == name)),
        texts => match only(texts) {
            Some(total) => total,
            None => return ExitCode::FAILURE,
        },
    };
    println!("\n{total}");
    if total.failed == 0 && total.passed > 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// All steps.
fn everything() -> Counts {
    let program = match std::env::current_exe() {
        Ok(program) => program,
        Err(error) => {
            println!("this program does not find its own file: {error}");
            return Counts::check(false);
        }
    };
    let mut total = run(steps::first());
    total += queue::run(&program, steps::rest());
    total
}

/// The steps whose names contain one of some texts. None: there is none.
fn only(texts: &[String]) -> Option<Counts> {
    let is_wanted = |step: &Step| texts.iter().any(|text| step.name.contains(text.as_str()));
    let all = steps::first().into_iter().chain(steps::rest());
    let (wanted, others): (Vec<_>, Vec<_>) = all.partition(is_wanted);
    let others: Vec<_> = others.iter().map(|s| s.name).collect();
    if wanted.is_empty() {
        eprintln!("no step has a name with {texts:?}: there are {others:?}");
        return None;
    }
    let total = run(wanted);
    if !others.is_empty() {
        println!("\nnot run, as asked: {}", others.join(", "));
    }
    Some(total)
}

/// Runs steps one after the other.
fn run(steps: impl IntoIterator<Item = Step>) -> Counts {
    let mut total = Counts::default();
    for step in steps {
        println!("\n== {}", step.name);
        let started = std::time::Instant::now();
        let counts = (step.run)().unwrap_or_else(|error| {
            println!("{}: {error:#}", step.name);
            Counts::check(false)
        });
        println!("-- {}: {counts} ({:.0} s)", step.name, started.elapsed().as_secs_f64());
        total += counts;
    }
    total
}
