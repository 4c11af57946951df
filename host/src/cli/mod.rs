//! The command line: one verb a file, each thin: parse, call the library, print.

mod common;

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

#[derive(Debug, Subcommand)]
enum Verb {}

/// Parses the command line, runs the verb, prints, and gives the exit code: 0 done, 1 failed, 2 usage.
pub fn main() -> std::process::ExitCode {
    let cli = Cli::parse();
    let result: anyhow::Result<Outcome> = match cli.verb {};
    common::finish(&cli.run, result)
}
