//! The command line: one verb a file, each thin: parse, call the library, print.

mod ablate;
mod bench;
mod calibrate;
mod close;
mod common;
mod demo;
mod device;
mod erf;
mod evaluate;
mod hidden;
mod import_pth;
mod inspect;
mod manual;
mod predict;
mod quantize;
mod reconstruct;
mod report;
mod residual;
mod resolution;
mod retrain;
mod simulate;
mod study;
mod train;

pub use common::{Outcome, Run};

use clap::{Parser, Subcommand};

/// From the optical bench to the chip beside the sensor: calibrate, simulate, train, quantize, reconstruct.
#[derive(Debug, Parser)]
#[command(name = "ommatidia", version, propagate_version = true, max_term_width = 110)]
#[command(after_help = "Begin with:\n  ommatidia demo -o demo")]
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
    #[command(after_help = "Example:\n  ommatidia demo -o demo")]
    Demo(demo::Args),
    /// Let the virtual instrument measure a session: darks, flats, a bead scan, scenes with truth
    #[command(after_help = "Example:\n  ommatidia bench session --frames 12 --seed 7")]
    Bench(bench::Args),
    /// Learn the instrument from a session: noise, chief rays, low-rank spatially varying PSFs
    #[command(after_help = "Example:\n  ommatidia calibrate session -o instrument.safetensors")]
    Calibrate(calibrate::Args),
    /// Hold an instrument against a session: measured minus predicted, and what the residual depends on
    #[command(
        after_help = "Example:\n  ommatidia residual session --instrument instrument.safetensors --report residual.html"
    )]
    Residual(residual::Args),
    /// Find what the instrument lacks, add it, and report before and after on held-out data
    #[command(
        after_help = "Example:\n  ommatidia close session --instrument instrument.safetensors -o closed.safetensors"
    )]
    Close(close::Args),
    /// Measure how far `close` can be trusted: many virtual sessions with undeclared effects in them
    #[command(after_help = "Example:\n  ommatidia study -o study --quick")]
    Study(study::Args),
    /// Compute the frames that an instrument is expected to show for given objects
    #[command(after_help = "Example:\n  ommatidia predict instrument.safetensors objects.npy -o frames.npy")]
    Predict(predict::Args),
    /// Make training pairs with an instrument
    #[command(after_help = "Example:\n  ommatidia simulate instrument.safetensors -o pairs --count 500")]
    Simulate(simulate::Args),
    /// Train the network
    #[command(after_help = "Example:\n  ommatidia train pairs -o network.safetensors --preset nano")]
    Train(train::Args),
    /// Turn a checkpoint into the network file of a device
    #[command(after_help = "Example:\n  ommatidia quantize network.safetensors -o network.omm")]
    Quantize(quantize::Args),
    /// Reconstruct objects from raw frames
    #[command(after_help = "Example:\n  ommatidia reconstruct frames.npy -o objects.tif --with network.omm")]
    Reconstruct(reconstruct::Args),
    /// Compare methods on scenes of known truth
    #[command(
        after_help = "Example:\n  ommatidia evaluate session --with network.omm --with instrument.safetensors --methods wiener,central"
    )]
    Evaluate(evaluate::Args),
    /// Find the finest bars that methods still show, at the centre and the edges of the field
    #[command(
        after_help = "Example:\n  ommatidia resolution targets --with network.safetensors --with instrument.safetensors --methods wiener,central"
    )]
    Resolution(resolution::Args),
    /// Hold a network's effective receptive fields against PSFs, and its filters against pseudo-inverses
    #[command(
        after_help = "Example:\n  ommatidia erf network.safetensors --instrument instrument.safetensors -o erf.safetensors"
    )]
    Erf(erf::Args),
    /// Train networks that differ in one thing each, and make the table
    #[command(
        after_help = "Example:\n  ommatidia ablate pairs --instrument instrument.safetensors --session session -o ablation"
    )]
    Ablate(ablate::Args),
    /// Render artifacts to one HTML file
    #[command(after_help = "Example:\n  ommatidia report instrument.safetensors evaluation.safetensors -o report.html")]
    Report(report::Args),
    /// Run the firmware, under QEMU or on a board
    #[command(after_help = "Example:\n  ommatidia device run --with network.omm --frames frames.npy -o objects.npy")]
    Device(device::Args),
    /// Turn the published PyTorch weights of an SV-FourierNet into a checkpoint
    #[command(
        after_help = "Example:\n  ommatidia import-pth svfourier.pth -o published.safetensors --instrument instrument.safetensors"
    )]
    ImportPth(import_pth::Args),
    /// Write the weights of a checkpoint as the published network keeps them
    #[command(after_help = "Example:\n  ommatidia export network.safetensors -o weights.safetensors")]
    Export(import_pth::Export),
    /// Say what a file is
    #[command(after_help = "Example:\n  ommatidia inspect instrument.safetensors")]
    Inspect(inspect::Args),
    /// Print the completions of a shell
    #[command(hide = true, after_help = "Example:\n  ommatidia completions bash > ommatidia.bash")]
    Completions(manual::Completions),
    /// Print the manual page
    #[command(hide = true, after_help = "Example:\n  ommatidia man > ommatidia.1")]
    Man(manual::Man),
}

impl Cli {
    /// Runs the verb.
    fn run(&self) -> anyhow::Result<Outcome> {
        let run = &self.run;
        match &self.verb {
            Verb::Demo(a) => demo::run(a, run),
            Verb::Bench(a) => bench::run(a, run),
            Verb::Calibrate(a) => calibrate::run(a, run),
            Verb::Residual(a) => residual::run(a, run),
            Verb::Close(a) => close::run(a, run),
            Verb::Study(a) => study::run(a, run),
            Verb::Predict(a) => predict::run(a, run),
            Verb::Simulate(a) => simulate::run(a, run),
            Verb::Train(a) => train::run(a, run),
            Verb::Quantize(a) => quantize::run(a, run),
            Verb::Reconstruct(a) => reconstruct::run(a, run),
            Verb::Evaluate(a) => evaluate::run(a, run),
            Verb::Resolution(a) => resolution::run(a, run),
            Verb::Erf(a) => erf::run(a, run),
            Verb::Ablate(a) => ablate::run(a, run),
            Verb::Report(a) => report::run(a, run),
            Verb::Device(a) => device::run(a, run),
            Verb::ImportPth(a) => import_pth::run(a, run),
            Verb::Export(a) => import_pth::export(a, run),
            Verb::Inspect(a) => inspect::run(a, run),
            Verb::Completions(a) => manual::completions(a),
            Verb::Man(a) => manual::man(a),
        }
    }
}

/// Parses the command line, runs the verb, prints, and gives the exit code: 0 done, 1 failed, 2 usage.
pub fn main() -> std::process::ExitCode {
    let cli = Cli::parse();
    let result = cli.run.set_up().and_then(|()| cli.run());
    common::finish(&cli.run, result)
}
