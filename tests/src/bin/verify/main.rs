//! `cargo verify`: everything that must hold before a change lands, in one command.
//!
//! Formatting, lints, documentation, the firmware image, all tests with QEMU parity, the Python package. What the
//! machine lacks is installed, or the run fails and says how to install it; nothing is left out in silence. The last
//! line is `N passed, N failed, N skipped`.

mod counts;
mod disk;
mod python;
mod steps;
mod toolchain;

use counts::Counts;
use std::process::ExitCode;

fn main() -> ExitCode {
    let mut total = Counts::default();
    for step in steps::all() {
        println!("\n== {}", step.name);
        let started = std::time::Instant::now();
        let counts = (step.run)().unwrap_or_else(|error| {
            println!("{}: {error:#}", step.name);
            Counts::check(false)
        });
        println!("-- {}: {counts} ({:.0} s)", step.name, started.elapsed().as_secs_f64());
        total += counts;
    }
    println!("\n{total}");
    if total.failed == 0 && total.passed > 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
