//! `study`: how far `close` can be trusted.

use super::retrain::Networks;
use super::common::{Outcome, Run};
use crate::study::plan::Size;
use crate::study::run::{JSON, PAGE, run as study};
use crate::study::summary::Share;
use std::fmt::Write;
use std::path::PathBuf;

/// Options of `study`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: ommatidia study -o study --quick")]
pub struct Args {
    /// Folder for the sessions' outcomes, study.json and study.md; a study that is there already goes on
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// A few sessions: whether loop and study work, in a minute or two
    #[arg(long, conflicts_with_all = ["null", "seeds", "strengths", "only", "instruments"])]
    quick: bool,
    /// Sessions without an effect
    #[arg(long, value_name = "N", default_value_t = Size::default().nulls)]
    null: usize,
    /// Repetitions of all other sessions, each with scenes and noise of its own
    #[arg(long, value_name = "N", default_value_t = Size::default().seeds)]
    seeds: u64,
    /// Instruments that take turns
    #[arg(long, value_name = "N", default_value_t = Size::default().instruments, value_parser = clap::value_parser!(u64).range(1..))]
    instruments: u64,
    /// Strengths of the effects, in units of what a session can tell
    #[arg(long, value_name = "K,..", value_delimiter = ',', default_values_t = Size::default().strengths)]
    strengths: Vec<f64>,
    /// Effects to put in (default: all)
    #[arg(long, value_name = "ID,..", value_delimiter = ',')]
    only: Vec<String>,
    /// Run only every N-th session, from the I-th on, counted from 0
    #[arg(long, value_name = "I/N", value_parser = shard, default_value = "0/1")]
    shard: [usize; 2],
}

/// Runs the verb.
///
/// # Errors
/// The folder cannot be written.
pub fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    let size = if args.quick {
        Size::quick(run.seed)
    } else {
        Size {
            seed: run.seed,
            instruments: args.instruments,
            nulls: args.null,
            seeds: args.seeds,
            strengths: args.strengths.clone(),
            only: args.only.clone(),
            ..Size::default()
        }
    };
    let bar = run.progress(0, "study");
    let found = study(&args.output, &size, args.shard, &Networks, |done, all| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
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
    line("found where nothing is", s.null_found);
    for b in &s.single {
        line(&format!("true effect first at {} sigma", b.sigmas), b.first);
        line("  found or in the ambiguity set", b.covered);
    }
    line("pairs, both told", s.pairs_both);
    line("false naming, true effect not a candidate", s.minus_one.false_naming);
    for (k, o) in &s.foreign {
        line(&format!("false naming, foreign effect at {k} sigma"), o.false_naming);
    }
    line("faults of records", s.records);
    let _ = writeln!(
        text,
        "{} sessions, {:.1} s each\n-> {}\n-> {}",
        s.sessions,
        s.seconds[1],
        args.output.join(JSON).display(),
        args.output.join(PAGE).display()
    );
    Ok(Outcome { json: serde_json::to_value(s)?, text })
}

/// Parses `I/N`.
fn shard(text: &str) -> Result<[usize; 2], String> {
    let parts = text.split_once('/').and_then(|(i, n)| Some([i.parse().ok()?, n.parse().ok()?]));
    parts.filter(|[i, n]| i < n).ok_or_else(|| "expected I/N with I below N, e.g. 0/2".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shard_is_one_of_some() {
        assert_eq!(shard("1/4"), Ok([1, 4]));
        assert!(shard("4/4").is_err() && shard("1").is_err() && shard("a/b").is_err());
    }
}
