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
mod steps;
mod toolchain;

use counts::Counts;
use std::process::ExitCode;

fn main() -> ExitCode {
    let wanted: Vec<String> = std::env::args().skip(1).collect();
    let is_wanted =
        |step: &steps::Step| wanted.is_empty() || wanted.iter().any(|text| step.name.contains(text.as_str()));
    let (steps, others): (Vec<_>, Vec<_>) = steps::all().into_iter().partition(is_wanted);
    if steps.is_empty() {
        eprintln!(
            "no step has a name with {wanted:?}: there are {:?}",
            others.iter().map(|s| s.name).collect::<Vec<_>>()
        );
        return ExitCode::FAILURE;
    }
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
    if !others.is_empty() {
        println!("\nnot run, as asked: {}", others.iter().map(|s| s.name).collect::<Vec<_>>().join(", "));
    }
    println!("\n{total}");
    if total.failed == 0 && total.passed > 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
