//! What every verb shares: global options, progress, and the one way to print.

use clap::Args;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::process::ExitCode;

/// Options that every verb takes.
#[derive(Clone, Debug, Args)]
pub struct Run {
    /// Print exactly one JSON object on stdout; everything else goes to stderr.
    #[arg(long, global = true)]
    pub json: bool,
    /// Seed of all that is drawn; the same seed and inputs give the same bytes.
    #[arg(long, global = true, default_value_t = 1, value_name = "N")]
    pub seed: u64,
    /// Threads to use (default: all cores); the result does not depend on it.
    #[arg(long, global = true, value_name = "N")]
    pub threads: Option<usize>,
    /// Say more on stderr (twice: everything).
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    pub verbose: u8,
    /// Say nothing on stderr but errors.
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    pub quiet: bool,
}

impl Run {
    /// A progress bar over `len` steps on stderr; silent with `--quiet` and where stderr is no terminal.
    pub fn progress(&self, len: u64, what: &'static str) -> ProgressBar {
        let bar = ProgressBar::with_draw_target(
            Some(len),
            if self.quiet { ProgressDrawTarget::hidden() } else { ProgressDrawTarget::stderr() },
        );
        let style = ProgressStyle::with_template("{msg:>12} [{bar:40}] {pos}/{len} {eta}");
        bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "));
        bar.set_message(what);
        bar
    }
}

/// What a verb found: the figures for programs, and the same figures for people.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// Every figure that the verb prints.
    pub json: serde_json::Value,
    /// The text for people.
    pub text: String,
}

/// Prints an outcome or an error and gives the exit code.
pub(super) fn finish(run: &Run, result: anyhow::Result<Outcome>) -> ExitCode {
    match result {
        Ok(outcome) if run.json => println!("{}", outcome.json),
        Ok(outcome) => print!("{}", outcome.text),
        Err(error) => {
            eprintln!("error: {error:#}");
            return ExitCode::FAILURE;
        }
    }
    ExitCode::SUCCESS
}
