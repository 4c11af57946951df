//! What every verb shares: global options, progress, logging, and the one way to print.

use anyhow::Context;
use clap::Args;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use ommatidia_physics::sensor::{self, FrameRange};
use ommatidia_session::kind::FileKind;
use ommatidia_session::{MANIFEST, Session, causes};
use std::io::{ErrorKind, IsTerminal, Write};
use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;

/// Options that every verb takes.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Global options")]
pub struct Run {
    /// Print one JSON object to stdout instead of text; everything else goes to stderr
    #[arg(long, global = true)]
    pub json: bool,
    /// Seed of all random draws; the same seed and inputs give the same bytes
    #[arg(long, global = true, default_value_t = 1, value_name = "N")]
    pub seed: u64,
    /// Number of threads (default: one per core); the result does not depend on it
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub threads: Option<u16>,
    /// Replace outputs that exist. An input, or a file of another kind, is never replaced
    #[arg(long, global = true)]
    pub force: bool,
    /// Log more to stderr; repeat for more detail
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    pub verbose: u8,
    /// Print only errors to stderr: no warnings, no notes, no progress. Results are still printed to stdout
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    pub quiet: bool,
}

/// Scale of reconstructions, for the metadata of an OME-TIFF or OME-Zarr.
#[derive(Clone, Copy, Debug, Args)]
pub(super) struct ResultScale {
    /// Side of an object pixel, um, for the metadata of the result [default: that of the instrument, if there is one;
    /// networks do not know it]
    #[arg(long, value_name = "UM", value_parser = positive)]
    pub pixel_um: Option<f64>,
    /// Time between raw frames, s, for the metadata of the result [default: as the recording says; of a stream 1 /
    /// --fps]
    #[arg(long, value_name = "S", value_parser = positive)]
    pub interval_s: Option<f64>,
}

/// Parses a number above 0.
pub(super) fn positive(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|v: &f64| v.is_finite() && *v > 0.0).ok_or_else(|| "expected a number above 0".into())
}

/// Parses yes or no.
pub(super) fn yes_or_no(text: &str) -> Result<bool, String> {
    match text {
        "yes" | "true" => Ok(true),
        "no" | "false" => Ok(false),
        _ => Err("expected yes or no".into()),
    }
}

/// Parses a share above 0, at most 1.
pub(super) fn part(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(part) if part > 0.0 && part <= 1.0 => Ok(part),
        _ => Err("expected a number above 0, at most 1".into()),
    }
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
        if !self.quiet && !std::io::stderr().is_terminal() {
            print_lines(&bar);
        }
        bar
    }

    /// A line on stderr with the current work; silent as [`Run::progress`].
    pub fn spinner(&self, what: &'static str) -> ProgressBar {
        let bar = self.progress(0, what);
        let style = ProgressStyle::with_template("{spinner} {msg} {elapsed}");
        bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_spinner()));
        bar
    }

    /// Sends the log to stderr at the level of `-v`/`-q` (`RUST_LOG` wins), and sets the number of threads.
    ///
    /// # Errors
    /// The threads cannot be started.
    pub(super) fn set_up(&self) -> anyhow::Result<()> {
        let level = match (self.quiet, self.verbose) {
            (true, _) => LevelFilter::ERROR,
            (false, 0) => LevelFilter::WARN,
            (false, 1) => LevelFilter::INFO,
            (false, 2) => LevelFilter::DEBUG,
            (false, _) => LevelFilter::TRACE,
        };
        let wanted = std::env::var("RUST_LOG").ok().filter(|text| !text.trim().is_empty());
        let parsed = wanted.as_ref().map(|text| text.parse::<Targets>());
        let filter = match &parsed {
            Some(Ok(targets)) => targets.clone(),
            _ => Targets::new().with_default(level),
        };
        let log = tracing_subscriber::fmt::layer().with_writer(std::io::stderr).without_time();
        let colours = std::io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none();
        let log = log.with_ansi(colours);
        // A second call in one process (a test) keeps the first log.
        let _ = tracing_subscriber::registry().with(log.with_target(self.verbose > 1)).with(filter).try_init();
        if let Some(Err(error)) = parsed {
            let text = wanted.unwrap_or_default();
            tracing::warn!("RUST_LOG={text}: expected LEVEL or TARGET=LEVEL, with commas between; left aside: {error}");
        }
        if let Some(n) = self.threads {
            rayon::ThreadPoolBuilder::new()
                .num_threads(usize::from(n))
                .build_global()
                .with_context(|| format!("--threads {n}: the thread pool cannot be set up"))?;
        }
        Ok(())
    }
}

/// Time between two lines of progress where stderr is no terminal.
const LINE_EVERY: Duration = Duration::from_secs(15);

/// Prints a line on stderr from time to time until the bar is finished or dropped, for logs and pipes.
fn print_lines(bar: &ProgressBar) {
    let bar = bar.downgrade();
    std::thread::spawn(move || {
        loop {
            std::thread::sleep(LINE_EVERY);
            let Some(bar) = bar.upgrade().filter(|bar| !bar.is_finished()) else { return };
            let count =
                bar.length().filter(|n| *n > 0).map_or(String::new(), |n| format!(" {} of {n},", bar.position()));
            // A closed stderr ends the lines, not the run.
            if writeln!(std::io::stderr(), "{}:{count} {:.0} s", bar.message(), bar.elapsed().as_secs_f64()).is_err() {
                return;
            }
        }
    });
}

/// Prints warnings on stderr, unless `--quiet`, and gives them back for the JSON.
pub(super) fn warn(warnings: impl IntoIterator<Item = String>) -> Vec<String> {
    let warnings: Vec<String> = warnings.into_iter().collect();
    warnings.iter().for_each(|text| tracing::warn!("{text}"));
    warnings
}

/// Opens a session, measured or virtual (a configuration of the virtual instrument).
///
/// # Errors
/// The path is the manifest instead of its folder, or the session cannot be opened.
pub(super) fn any_session(path: &Path, seed: u64) -> anyhow::Result<Session> {
    anyhow::ensure!(
        path.file_name().is_none_or(|name| name != MANIFEST),
        "{}: this is {}{}",
        path.display(),
        FileKind::Manifest,
        FileKind::Manifest.advice()
    );
    let session = ommatidia_bench::open_session(path, seed)?;
    warn(session.notes());
    Ok(session)
}

/// Warns of frames that are left out since the session marks them as damaged.
pub(super) fn left_out(session: &Session) -> Vec<String> {
    warn(session.stacks().iter().filter_map(|stack| stack.damaged_note("they are left out")))
}

/// Warns of scenes whose frames do not fit what is known of the sensor.
///
/// # Errors
/// A frame cannot be read.
pub(super) fn odd_scenes(session: &Session, range: Option<FrameRange>) -> anyhow::Result<Vec<String>> {
    Ok(warn(range.map(|range| sensor::odd_scenes(session, range)).transpose()?.unwrap_or_default()))
}

/// The result of a verb: its figures for programs, and for people.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// Every figure that the verb prints.
    pub json: serde_json::Value,
    /// The text for people.
    pub text: String,
}

/// Findings that make a verb fail, for people and for programs.
#[derive(Debug, thiserror::Error)]
#[error("{text}")]
pub(super) struct Findings {
    /// For people.
    pub text: String,
    /// For programs: printed with `--json` in place of the error.
    pub json: serde_json::Value,
}

/// An outcome whose frames are not all that were recorded, where `--strict` asks for an exit code that says so. All
/// outputs are written.
#[derive(Debug, thiserror::Error)]
#[error("frames are lost, left out or damaged")]
struct Lossy(Outcome);

/// Exit code of a run that succeeded with [`Lossy`] frames.
const LOSSY: u8 = 3;

/// An option of verbs that read recordings.
#[derive(Clone, Copy, Debug, Args)]
pub(super) struct Strict {
    /// End with exit code 3 where a frame was lost, left out or damaged; the output is written all the same
    #[arg(long)]
    strict: bool,
}

impl Strict {
    /// The outcome of a verb; `lossy` says whether frames were lost, left out or damaged.
    ///
    /// # Errors
    /// They were, and the option is given: [`finish`] prints the outcome and gives the exit code.
    pub fn judge(self, lossy: bool, outcome: Outcome) -> anyhow::Result<Outcome> {
        if self.strict && lossy { Err(Lossy(outcome).into()) } else { Ok(outcome) }
    }
}

/// Names the verb in the figures for programs, so that a file of them says what it is. Figures that name one already,
/// and lists, stay as they are.
pub(super) fn named(result: anyhow::Result<Outcome>, verb: &str) -> anyhow::Result<Outcome> {
    let name = |json: &mut serde_json::Value| {
        if let Some(fields) = json.as_object_mut() {
            fields.entry("verb").or_insert_with(|| verb.into());
        }
    };
    match result {
        Ok(mut outcome) => {
            name(&mut outcome.json);
            Ok(outcome)
        }
        Err(error) => Err(match error.downcast::<Findings>().map_err(|other| other.downcast::<Lossy>()) {
            Ok(mut findings) => {
                name(&mut findings.json);
                findings.into()
            }
            Err(Ok(mut lossy)) => {
                name(&mut lossy.0.json);
                lossy.into()
            }
            Err(Err(other)) => other,
        }),
    }
}

/// Prints an outcome or an error and gives the exit code.
///
/// A reader that has gone away (`ommatidia ... | head`) is no failure.
pub(super) fn finish(run: &Run, result: anyhow::Result<Outcome>) -> ExitCode {
    let (result, code) = match result.map_err(|error| error.downcast::<Lossy>()) {
        Ok(outcome) => (Ok(outcome), ExitCode::SUCCESS),
        Err(Ok(Lossy(outcome))) => (Ok(outcome), ExitCode::from(LOSSY)),
        Err(Err(error)) => (Err(error), ExitCode::FAILURE),
    };
    let error = match result {
        Ok(outcome) => {
            let text = if run.json { format!("{}\n", outcome.json) } else { outcome.text };
            match print(text.as_bytes()) {
                Ok(()) => return code,
                Err(e) => anyhow::Error::new(e).context("standard output"),
            }
        }
        Err(error) => error,
    };
    let causes = causes(error.as_ref());
    if run.json {
        let findings = error.downcast_ref::<Findings>().map(|findings| findings.json.clone());
        let json = findings.unwrap_or_else(|| json_error(&causes[0], &causes[1..]));
        let _ = print(format!("{json}\n").as_bytes());
    }
    // If stderr is closed too, nothing can be printed.
    let _ = writeln!(std::io::stderr(), "error: {}", causes.join("\n  because: "));
    ExitCode::FAILURE
}

/// A path in figures for programs: JSON is text, and a path need not be, so bytes that are no text become U+FFFD.
pub(super) fn in_json(path: impl AsRef<Path>) -> String {
    path.as_ref().to_string_lossy().into_owned()
}

/// An error as one JSON object, for programs.
pub(super) fn json_error(message: &str, causes: &[String]) -> serde_json::Value {
    serde_json::json!({ "error": { "message": message, "causes": causes } })
}

/// Writes to stdout; a broken pipe ends the text quietly.
pub(super) fn print(bytes: &[u8]) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    match out.write_all(bytes).and_then(|()| out.flush()) {
        Err(e) if e.kind() == ErrorKind::BrokenPipe => Ok(()),
        other => other,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use clap::{CommandFactory, Parser};

    #[test]
    fn the_command_line_is_sound_and_every_verb_has_an_example() {
        let command = crate::cli::Cli::command();
        command.clone().debug_assert();
        for verb in command.get_subcommands().filter(|v| !v.is_hide_set()) {
            let help = verb.get_after_help().map(ToString::to_string).unwrap_or_default();
            let example = help.lines().find_map(|l| l.trim().strip_prefix("ommatidia "));
            let example = example.unwrap_or_else(|| panic!("{} has no example", verb.get_name()));
            // What a shell does with the output is no word of the program.
            let example = example.split(" > ").next().unwrap_or(example);
            let words = std::iter::once("ommatidia").chain(example.split_whitespace());
            let parsed = crate::cli::Cli::try_parse_from(words);
            assert!(parsed.is_ok(), "the example of {} does not parse: {}", verb.get_name(), parsed.unwrap_err());
        }
    }

    #[test]
    #[cfg(unix)]
    fn a_path_that_is_no_text_is_read_and_shown() {
        use std::os::unix::ffi::OsStrExt;
        let path = std::ffi::OsStr::from_bytes(b"dark=caf\xe9.avi");
        assert_eq!(super::in_json(path), "dark=caf\u{fffd}.avi");
        let words = ["ommatidia", "import"].map(std::ffi::OsStr::new).into_iter();
        for word in [path, std::ffi::OsStr::from_bytes(b"caf\xe9.avi")] {
            let words = words.clone().chain([word, "-o".as_ref(), std::ffi::OsStr::from_bytes(b"s\xe9")]);
            let parsed = crate::cli::Cli::try_parse_from(words).unwrap();
            assert!(format!("{parsed:?}").contains(r#""caf\xE9.avi""#), "{parsed:?}");
        }
    }

    #[test]
    fn no_thread_is_a_usage_error() {
        let error = crate::cli::Cli::try_parse_from(["ommatidia", "demo", "--threads", "0"]).unwrap_err();
        assert_eq!(error.exit_code(), 2);
    }
}
