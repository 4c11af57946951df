//! The command line: one verb a file, each thin: parse, call the library, print.

mod ablate;
mod arena;
mod bench;
mod calibrate;
mod check;
mod close;
mod common;
mod coverage;
mod demo;
mod device;
mod erf;
mod evaluate;
mod hidden;
mod import;
mod import_pth;
mod inspect;
mod interrupt;
mod manual;
mod predict;
mod quantize;
mod reconstruct;
mod report;
mod residual;
mod resolution;
mod retrain;
mod shard;
mod simulate;
mod study;
mod train;
mod uncertainty;
mod view;

pub use common::{Outcome, Run};

use ommatidia_session::files::{self, Files};

use clap::{ArgMatches, CommandFactory, FromArgMatches, Parser, Subcommand};
use std::ffi::OsString;

/// From the optical bench to the chip beside the sensor: calibrate, simulate, train, quantize, reconstruct.
#[derive(Debug, Parser)]
#[command(name = "ommatidia", version, propagate_version = true, max_term_width = 110)]
#[command(after_help = "Begin with:\n  ommatidia demo -o demo")]
pub struct Cli {
    #[command(flatten)]
    run: Run,
    #[command(subcommand)]
    verb: Verb,
    /// The verb as it is typed, such as `device run`.
    #[arg(skip)]
    name: String,
}

/// The verbs; the first line of each is its description in `--help`.
#[derive(Debug, Subcommand)]
enum Verb {
    /// Run the whole chain on the virtual instrument; ends with report.html and a printed table
    #[command(after_help = "Example:\n  ommatidia demo -o demo")]
    Demo(demo::Args),
    /// Measure a session with the virtual instrument: darks, flats, a bead scan, scenes of known truth
    #[command(after_help = "Example:\n  ommatidia bench session --frames 12 --seed 7")]
    Bench(bench::Args),
    /// Make a session of recordings: folders of a UCLA Miniscope, numbered TIFFs or AVIs, single files
    #[command(after_help = "Example:\n  ommatidia import recording/ -o session")]
    Import(import::Args),
    /// Check a session before it is calibrated: axes, order and units of the table, single positions, array, bit depth,
    /// saturation, black level, light levels, drift
    #[command(after_help = "Example:\n  ommatidia check session -o check.png")]
    Check(check::Args),
    /// Calibrate an instrument from a session: noise, chief rays, low-rank spatially varying PSFs
    #[command(after_help = "Example:\n  ommatidia calibrate session -o lab.instrument")]
    Calibrate(calibrate::Args),
    /// Compare an instrument with a session: measured minus predicted, and what the residual depends on
    #[command(after_help = "Example:\n  ommatidia residual session --instrument lab.instrument --report residual.html")]
    Residual(residual::Args),
    /// Find effects that the instrument lacks, add them, and report before and after on held-out data
    #[command(after_help = "Example:\n  ommatidia close session --instrument lab.instrument -o closed.instrument")]
    Close(close::Args),
    /// Measure how far `close` can be trusted, with many virtual sessions that have undeclared effects
    #[command(after_help = "Example:\n  ommatidia study -o study --quick")]
    Study(study::Args),
    /// Compute the expected frames of an instrument for given objects
    #[command(after_help = "Example:\n  ommatidia predict lab.instrument objects.npy -o frames.npy")]
    Predict(predict::Args),
    /// Simulate training pairs with an instrument
    #[command(after_help = "Example:\n  ommatidia simulate lab.instrument -o pairs --count 500")]
    Simulate(simulate::Args),
    /// Train the network
    #[command(after_help = "Example:\n  ommatidia train pairs -o net.checkpoint --preset nano")]
    Train(train::Args),
    /// Convert a checkpoint into the network file of a device
    #[command(after_help = "Example:\n  ommatidia quantize net.checkpoint -o net.omm")]
    Quantize(quantize::Args),
    /// Reconstruct objects from raw frames
    #[command(after_help = "Example:\n  ommatidia reconstruct frames.npy -o objects.tif --with net.omm")]
    Reconstruct(reconstruct::Args),
    /// Compare methods on scenes of known truth
    #[command(after_help = "Example:\n  ommatidia evaluate session --with net.omm --with lab.instrument \
            --methods wiener,central")]
    Evaluate(evaluate::Args),
    /// Compare methods on virtual scenes of many specimens, light levels and instruments; writes a page
    #[command(after_help = "Example:\n  ommatidia arena --with net.omm --with lab.instrument --effect \
            array_shift=0.3 -o arena")]
    Arena(arena::Args),
    /// Find the finest line pairs that methods resolve, at the centre and the edges of the field
    #[command(after_help = "Example:\n  ommatidia resolution targets --with net.checkpoint --with \
            lab.instrument --methods wiener,central")]
    Resolution(resolution::Args),
    /// Compare the effective receptive fields of a network with PSFs, and its filters with pseudo-inverses
    #[command(after_help = "Example:\n  ommatidia erf net.checkpoint --instrument lab.instrument -o \
            erf.safetensors")]
    Erf(erf::Args),
    /// Train networks that differ in one choice each, and print their figures in a table
    #[command(after_help = "Example:\n  ommatidia ablate pairs --instrument lab.instrument --session session -o \
            ablation")]
    Ablate(ablate::Args),
    /// Learn intervals for each pixel of a method's reconstructions, on the virtual instrument
    #[command(after_help = "Example:\n  ommatidia uncertainty lab.instrument --with net.omm -o \
            net.widths")]
    Uncertainty(uncertainty::Args),
    /// Measure how often the truth lies inside the intervals, by specimen, photon level and field radius
    #[command(after_help = "Example:\n  ommatidia coverage net.widths --with net.omm --instrument \
            lab.instrument")]
    Coverage(coverage::Args),
    /// Render artifacts to one HTML file
    #[command(after_help = "Example:\n  ommatidia report lab.instrument scenes.evaluation -o report.html")]
    Report(report::Args),
    /// Show files in the browser: frames, instruments, PSFs, residuals, data sets, reconstructions
    #[command(after_help = "Example:\n  ommatidia view demo")]
    View(view::Args),
    /// Run the firmware, under QEMU or on a board
    #[command(after_help = "Example:\n  ommatidia device run --with net.omm --frames frames.npy -o objects.npy")]
    Device(device::Args),
    /// Convert the published PyTorch weights of an SV-FourierNet into a checkpoint
    #[command(after_help = "Example:\n  ommatidia import-pth svfourier.pth -o published.checkpoint --instrument \
            lab.instrument")]
    ImportPth(import_pth::Args),
    /// Write the weights of a checkpoint in the layout of the published network
    #[command(after_help = "Example:\n  ommatidia export net.checkpoint -o weights.safetensors")]
    Export(import_pth::Export),
    /// Describe a file
    #[command(after_help = "Example:\n  ommatidia inspect lab.instrument")]
    Inspect(inspect::Args),
    /// Print completions for a shell
    #[command(after_help = "Example:\n  ommatidia completions bash > ommatidia.bash")]
    Completions(manual::Completions),
    /// Print the manual page
    #[command(after_help = "Example:\n  ommatidia man > ommatidia.1")]
    Man(manual::Man),
}

impl Cli {
    /// Parses a command line and runs its verb under the given global options.
    fn execute(words: Vec<String>, run: Run) -> anyhow::Result<Outcome> {
        let cli = Self::parsed(words)?;
        Self { run, ..cli }.run()
    }

    /// Parses a command line, its first word the name of the program.
    ///
    /// # Errors
    /// It is no command line of this program.
    fn parsed(words: impl IntoIterator<Item = impl Into<OsString> + Clone>) -> Result<Self, clap::Error> {
        let matches = Self::command().try_get_matches_from(words)?;
        let inner = |matches: &ArgMatches| matches.subcommand().map(|(name, inner)| (name.to_string(), inner.clone()));
        let names = std::iter::successors(inner(&matches), |(_, matches)| inner(matches)).map(|(name, _)| name);
        let name = names.collect::<Vec<_>>().join(" ");
        Ok(Self { name, ..Self::from_arg_matches(&matches).map_err(|e| e.format(&mut Self::command()))? })
    }

    /// What the verb reads and writes.
    fn files(&self) -> Files {
        match &self.verb {
            Verb::Demo(a) => a.files(),
            Verb::Bench(a) => a.files(),
            Verb::Import(a) => a.files(),
            Verb::Check(a) => a.files(),
            Verb::Calibrate(a) => a.files(),
            Verb::Residual(a) => a.files(),
            Verb::Close(a) => a.files(),
            Verb::Study(a) => a.files(),
            Verb::Predict(a) => a.files(),
            Verb::Simulate(a) => a.files(),
            Verb::Train(a) => a.files(),
            Verb::Quantize(a) => a.files(),
            Verb::Reconstruct(a) => a.files(),
            Verb::Evaluate(a) => a.files(),
            Verb::Arena(a) => a.files(),
            Verb::Resolution(a) => a.files(),
            Verb::Erf(a) => a.files(),
            Verb::Ablate(a) => a.files(),
            Verb::Uncertainty(a) => a.files(),
            Verb::Coverage(a) => a.files(),
            Verb::Report(a) => a.files(),
            Verb::View(a) => a.files(),
            Verb::Device(a) => a.files(),
            Verb::ImportPth(a) => a.files(),
            Verb::Export(a) => a.files(),
            Verb::Inspect(_) | Verb::Completions(_) | Verb::Man(_) => Files::default(),
        }
    }

    /// Runs the verb, if no file is at risk.
    fn run(&self) -> anyhow::Result<Outcome> {
        let run = &self.run;
        let files = self.files();
        let _locks = files.hold(run.force)?;
        let _advice = interrupt::advise(&files);
        let result = match &self.verb {
            Verb::Demo(a) => demo::run(a, run, Self::execute),
            Verb::Bench(a) => bench::run(a, run),
            Verb::Import(a) => import::run(a, run),
            Verb::Check(a) => check::run(a, run),
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
            Verb::Arena(a) => arena::run(a, run),
            Verb::Resolution(a) => resolution::run(a, run),
            Verb::Erf(a) => erf::run(a, run),
            Verb::Ablate(a) => ablate::run(a, run),
            Verb::Uncertainty(a) => uncertainty::run(a, run),
            Verb::Coverage(a) => coverage::run(a, run),
            Verb::Report(a) => report::run(a, run),
            Verb::View(a) => view::run(a, run),
            Verb::Device(a) => device::run(a, run),
            Verb::ImportPth(a) => import_pth::run(a, run),
            Verb::Export(a) => import_pth::export(a, run),
            Verb::Inspect(a) => inspect::run(a, run),
            Verb::Completions(a) => manual::completions(a, Self::command()),
            Verb::Man(a) => manual::man(a, Self::command()),
        };
        common::named(result, &self.name)
    }
}

/// Parses the command line, runs the verb, prints, and gives the exit code: 0 done, 1 failed, 2 usage, 3 done
/// with frames lost (`--strict`).
pub fn main() -> std::process::ExitCode {
    let cli = Cli::parsed(std::env::args_os()).unwrap_or_else(|error| {
        if error.use_stderr() && std::env::args_os().any(|word| word == "--json") {
            // If stdout is closed, the text on stderr and the exit code remain.
            let _ = common::print(format!("{}\n", common::json_error(error.to_string().trim(), &[])).as_bytes());
        }
        error.exit()
    });
    let result = cli.run.set_up().and_then(|()| interrupt::listen()).and_then(|()| cli.run());
    common::finish(&cli.run, result)
}
