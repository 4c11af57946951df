//! The command line: one verb a file, each thin: parse, call the library, print.

mod bench;
mod calibrate;
mod common;
mod demo;
mod device;
mod evaluate;
mod inspect;
mod predict;
mod quantize;
mod reconstruct;
mod report;
mod simulate;
mod train;

pub use common::{Outcome, Run};

use clap::{Parser, Subcommand};

/// From the optical bench to the chip beside the sensor: calibrate, simulate, train, quantize, reconstruct.
#[derive(Debug, Parser)]
#[command(name = "ommatidia", version, propagate_version = true)]
pub struct Cli {
    #[command(flatten)]
    run: Run,
    #[command(subcommand)]
    verb: Verb,
}

/// Each verb's first line here is what `--help` says of it.
#[derive(Debug, Subcommand)]
enum Verb {
    /// All verbs in a row on the virtual instrument; ends in report.html and a printed table
    Demo(demo::Args),
    /// Let the virtual instrument measure a session: darks, flats, a bead scan, scenes with truth
    Bench(bench::Args),
    /// Learn the instrument from a session: noise, chief rays, low-rank spatially varying PSFs
    Calibrate(calibrate::Args),
    /// Compute the frames that an instrument is expected to show for given objects
    Predict(predict::Args),
    /// Make training pairs with an instrument
    Simulate(simulate::Args),
    /// Train the network
    Train(train::Args),
    /// Turn a checkpoint into the network file of a device
    Quantize(quantize::Args),
    /// Reconstruct objects from raw frames
    Reconstruct(reconstruct::Args),
    /// Compare methods on scenes of known truth
    Evaluate(evaluate::Args),
    /// Render artifacts to one HTML file
    Report(report::Args),
    /// Run the firmware, under QEMU or on a board
    Device(device::Args),
    /// Say what a file is
    Inspect(inspect::Args),
}

/// Parses the command line, runs the verb, prints, and gives the exit code: 0 done, 1 failed, 2 usage.
pub fn main() -> std::process::ExitCode {
    let cli = Cli::parse();
    let run = &cli.run;
    let result = match &cli.verb {
        Verb::Demo(a) => demo::run(a, run),
        Verb::Bench(a) => bench::run(a, run),
        Verb::Calibrate(a) => calibrate::run(a, run),
        Verb::Predict(a) => predict::run(a, run),
        Verb::Simulate(a) => simulate::run(a, run),
        Verb::Train(a) => train::run(a, run),
        Verb::Quantize(a) => quantize::run(a, run),
        Verb::Reconstruct(a) => reconstruct::run(a, run),
        Verb::Evaluate(a) => evaluate::run(a, run),
        Verb::Report(a) => report::run(a, run),
        Verb::Device(a) => device::run(a, run),
        Verb::Inspect(a) => inspect::run(a, run),
    };
    common::finish(run, result)
}
