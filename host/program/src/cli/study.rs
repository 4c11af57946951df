//! `study`: measures how far `close` can be trusted.

use super::common::{Outcome, Run};
use super::files::{Content, Files};
use super::retrain::Networks;
use super::shard::shard;
use ommatidia_bench::{MeasuredPsfs, StackOf};
use ommatidia_closing::study::intervals::Share;
use ommatidia_closing::study::run::{JSON, PAGE, PLAN, StudyRequest, run as study};
use ommatidia_closing::study::shard::Shard;
use ommatidia_closing::study::size::Size;
use std::fmt::Write;
use std::path::PathBuf;

/// Largest number of sessions with one effect at one strength in a study for development.
const DEVELOPMENT: u16 = 6;

/// Options of `study`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: ommatidia study -o study --quick")]
pub struct Args {
    /// Folder for the outcomes, study.json and study.md; an unfinished study in it is resumed
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Run a few sessions only, which checks in a minute or two that `close` and the study work
    #[arg(long, conflicts_with_all = ["null", "seeds", "strengths", "only", "instruments", "development", "sealed"])]
    quick: bool,
    /// Run about 70 sessions over all families of instruments and all strengths, for development
    #[arg(long, conflicts_with_all = ["null", "seeds", "strengths", "only", "instruments", "sealed"])]
    development: bool,
    /// Run sessions whose specimens nobody knows, on instruments of their own; truths that are withheld judge the
    /// closed instruments
    #[arg(long, conflicts_with_all = ["quick", "development", "psfs"])]
    unknown: bool,
    /// Largest number of sessions with one effect at one strength, drawn from all that were planned; of other kinds a
    /// sixth of it (default: all; with `--development` 6)
    #[arg(long, value_name = "N", conflicts_with = "quick", value_parser = clap::value_parser!(u16).range(1..))]
    most: Option<u16>,
    /// Run sealed instruments and sessions, on which no threshold may be set, and count in FILE that they were opened
    /// (docs/sealed.json; with `--unknown` docs/sealed-unknown.json)
    #[arg(long, value_name = "FILE")]
    sealed: Option<PathBuf>,
    /// Measured PSFs, as one more kind of instruments: files or folders of .npy or .tif stacks, separated by commas
    #[arg(long, value_name = "PATH,..", value_delimiter = ',')]
    psfs: Vec<String>,
    /// What the frames of such a stack are: one PSF at even steps of depth (depths), or PSFs on a square grid over the
    /// field (field)
    #[arg(long, value_name = "WHAT", requires = "psfs", default_value = "depths")]
    psfs_of: StackOf,
    /// Number of sessions without an effect (default: 300; with `--unknown` 18)
    #[arg(long, value_name = "N")]
    null: Option<usize>,
    /// Number of repetitions of all other sessions, each with its own scenes and noise
    #[arg(long, value_name = "N", default_value_t = Size::default().seeds)]
    seeds: u64,
    /// Number of instruments; their families take turns (default: 42; with `--unknown` 6)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    instruments: Option<u64>,
    /// Strengths of single effects, in units of the standard error that a session gives for the effect (default:
    /// 3,10,30,100,300,1000; with `--unknown` 10,30,100)
    #[arg(long, value_name = "K,..", value_delimiter = ',')]
    strengths: Vec<f64>,
    /// Ids of the effects to inject, separated by commas (default: all)
    #[arg(long, value_name = "ID,..", value_delimiter = ',')]
    only: Vec<String>,
    /// Run only the sessions whose key (as `study.json` has it) contains TEXT; the others stay planned
    #[arg(long, value_name = "TEXT", default_value = "", hide_default_value = true)]
    keys: String,
    /// Run only every N-th instrument, starting with number I (counted from 0), so that N computers share the work;
    /// auto: as the scheduler says (docs/clusters.md)
    #[arg(long, value_name = "I/N", default_value = "0/1", value_parser = |text: &str| shard::<Shard>(text, 0))]
    shard: Shard,
}

impl Args {
    /// What the verb reads and writes.
    pub fn files(&self) -> Files {
        Files::reading(&self.psfs)
            .continuing([&self.output], Content::Named(of_study))
            .share(format!("{}/{}", self.shard.index, self.shard.count))
            .after_stop("the same command goes on with the sessions that are missing")
    }
}

/// Whether a file of this name is one of a study's.
fn of_study(name: &str) -> bool {
    let any = |start: &str, end: &str| name.starts_with(start) && name.ends_with(end);
    any("sessions", ".jsonl")
        || any("instrument-", ".instrument")
        || any("network-", ".checkpoint")
        || any("sensitivity-", ".json")
        || name == PLAN
        || name == "study.json"
        || name == "study.md"
}

/// Runs the verb.
///
/// # Errors
/// The folder cannot be written.
pub fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    let measured = MeasuredPsfs { paths: args.psfs.clone(), stack_of: args.psfs_of };
    let measured = Some(measured).filter(|m| !m.paths.is_empty());
    let size = if args.quick {
        Size::quick(run.seed)
    } else if args.development {
        Size { measured, ..Size::development(run.seed, args.most.unwrap_or(DEVELOPMENT).into()) }
    } else {
        let sealed = args.sealed.is_some();
        let usual = match args.unknown {
            true => Size::of_unknown_specimens(run.seed, sealed),
            false => Size { seed: run.seed, sealed, ..Size::default() },
        };
        Size {
            measured,
            instruments: args.instruments.unwrap_or(usual.instruments),
            nulls: args.null.unwrap_or(usual.nulls),
            seeds: args.seeds,
            strengths: Some(args.strengths.clone()).filter(|s| !s.is_empty()).unwrap_or(usual.strengths),
            only: args.only.clone(),
            quota: args.most.map(Into::into).or(usual.quota),
            ..usual
        }
    };
    let bar = run.progress(0, "study");
    let sealed = args.sealed.as_deref();
    let request = StudyRequest { dir: &args.output, size: &size, shard: args.shard, sealed, keys: &args.keys };
    let found = study(&request, &Networks, |progress| {
        bar.set_length(progress.planned as u64);
        bar.set_position(progress.done as u64);
    })?;
    bar.finish_and_clear();
    let s = &found.summary;
    let mut text = String::new();
    let mut line = |name: &str, share: Share| {
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "{name:<52} {:>4} of {:<4} {:>4.0} % ({:.0} to {:.0} %)",
            share.k,
            share.n,
            100.0 * share.share(),
            100.0 * share.low,
            100.0 * share.high
        );
    };
    line("anything found in sessions without an effect", s.null_found);
    for b in &s.single {
        line(&format!("true effect first at {} sigma", b.sigmas), b.first);
        line("  a false name, first or beside it", b.false_name);
        line("  of the excess nine tenths or more removed", b.removed);
    }
    line("pairs, both named", s.pairs_both);
    line("  a false name", s.pairs_false);
    for (k, o) in &s.minus_one {
        line(&format!("a false name, true effect no candidate, {k} sigma"), o.false_naming);
    }
    for (k, o) in &s.foreign {
        line(&format!("a false name, foreign effect at {k} sigma"), o.false_naming);
    }
    for (holds, named, wrong) in &s.holds {
        line(&format!("{}: true name", holds.words()), *named);
        line("  a false name", *wrong);
    }
    line("faults of records", s.records);
    let _ = writeln!(
        text,
        "held-out figures worse than before: {} sessions\n{} sessions, {:.1} s each, {} failed\n-> {}\n-> {}",
        s.worse.len(),
        s.sessions,
        s.seconds[1],
        s.failed,
        args.output.join(JSON).display(),
        args.output.join(PAGE).display()
    );
    Ok(Outcome { json: serde_json::to_value(s)?, text })
}
