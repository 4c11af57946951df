//! `ablate`: networks that differ in one option each, trained in the same way and judged on the same scenes.

use super::files::{Content, Files};
use super::shard::shard;
use super::{Cli, Outcome, Run};
use anyhow::{Context, bail};
use clap::Parser;
use ommatidia_model::dataset::Share;
use ommatidia_network::evaluate::Evaluation;
use ommatidia_network::train::{Checkpoint, weights};
use serde_json::json;
use std::fmt::Write;
use std::path::PathBuf;

/// Default variants: loss, passes, number of filters, start of the filters, domain in which they are learned, other
/// networks.
const VARIANTS: [(&str, &str); 13] = [
    ("svfouriernet", ""),
    ("the published loss", "--loss bce-mse"),
    ("two passes", "--passes 2"),
    ("Richardson-Lucy first", "--richardson-lucy 20"),
    ("one filter", "--filters 1"),
    ("three filters", "--filters 3"),
    ("nine filters", "--filters 9"),
    ("start from PSFs", "--start psf"),
    ("start from regression", "--start regression"),
    ("learned in space, from PSFs", "--network multiflatnet"),
    ("learned in space, random start", "--network multiflatnet --start random"),
    ("multiwienernet", "--network multiwienernet"),
    ("multiwienernet, random start", "--network multiwienernet --start random"),
];

/// Options of `ablate`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Data set that all networks are trained on
    pairs: PathBuf,
    /// Instrument of the data set
    #[arg(long, value_name = "FILE")]
    instrument: PathBuf,
    /// Session that all networks are judged on
    #[arg(long, value_name = "SESSION")]
    session: PathBuf,
    /// Folder of the networks and the evaluation. A network that is already there, with the same shape and settings,
    /// is not trained again
    #[arg(short, long, value_name = "FOLDER")]
    output: PathBuf,
    /// Steps of each training
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = clap::value_parser!(u64).range(1..))]
    steps: u64,
    /// Variant instead of the default ones: a name and options of `train` (may be given again)
    #[arg(long = "variant", value_name = "NAME=OPTIONS", value_parser = variant)]
    variants: Vec<(String, String)>,
    /// Train only every N-th network, starting with number I (counted from 1), so that N computers share the work;
    /// auto: as the scheduler says (docs/clusters.md). The same command without it makes the table
    #[arg(long, value_name = "I/N", value_parser = |text: &str| shard::<Share>(text, 1))]
    shard: Option<Share>,
}

fn variant(text: &str) -> Result<(String, String), String> {
    let (name, options) = text.split_once('=').unwrap_or((text, ""));
    if name.is_empty() { Err("expected NAME=OPTIONS".into()) } else { Ok((name.into(), options.into())) }
}

impl Args {
    /// What the verb reads and writes.
    pub fn files(&self) -> Files {
        Files::reading([&self.pairs, &self.instrument, &self.session])
            .continuing([&self.output], Content::Named(|name| name.ends_with(".safetensors") || name == TABLE))
            .share_of(self.shard)
            .after_stop("the same command goes on with the networks that are missing")
    }
}

/// The table of an ablation, in its folder.
const TABLE: &str = "ablation.json";

/// Runs the verb.
///
/// # Errors
/// A training or the evaluation fails; networks that are finished stay.
pub fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    std::fs::create_dir_all(&args.output).with_context(|| args.output.display().to_string())?;
    let default = || VARIANTS.map(|(name, options)| (name.to_string(), options.to_string())).to_vec();
    let variants = if args.variants.is_empty() { default() } else { args.variants.clone() };
    let path = |name: &str| args.output.join(format!("{}.safetensors", name.replace([' ', ','], "-")));
    let mut rows = Vec::new();
    let mut evaluate = vec!["evaluate".to_string(), args.session.display().to_string()];
    let mut missing = 0;
    for (k, (name, options)) in variants.iter().enumerate() {
        let output = path(name);
        let mut words = vec!["train".to_string(), args.pairs.display().to_string()];
        words.extend(["--instrument".into(), args.instrument.display().to_string()]);
        words.extend(["-o".into(), output.display().to_string(), "--steps".into(), args.steps.to_string()]);
        words.extend(options.split_whitespace().map(String::from));
        let begun = Checkpoint::read(&output)
            .ok()
            .filter(|c| c.body.training.steps == args.steps && c.body.training.seed == run.seed);
        let mine = args.shard.is_none_or(|share| share.holds(k));
        if !mine && begun.as_ref().is_none_or(|c| c.body.step < args.steps) {
            missing += 1;
            continue;
        }
        let seconds = match begun {
            // That of another task is taken as it is.
            Some(_) if !mine => None,
            Some(_) => {
                resume_or_replace(&words, run).with_context(|| {
                    let file = output.display();
                    format!("variant `{name}`: {file} is another training; remove it, or replace it with --force")
                })?;
                None
            }
            None => play(&words, run).with_context(|| format!("variant `{name}`"))?["seconds"].as_f64(),
        };
        let network = Checkpoint::read(&output)?.body.network;
        let parameters = weights::count(&network);
        evaluate.extend(["--with".into(), output.display().to_string()]);
        rows.push((name, output, parameters, seconds));
    }
    if args.shard.is_some() {
        let (there, folder) = (rows.len(), args.output.display());
        let text = format!("{folder}: {there} networks, {missing} are missing; without --shard the table is made\n");
        return Ok(Outcome { json: json!({ "networks": there, "missing": missing, "steps": args.steps }), text });
    }
    let evaluation = args.output.join("evaluation.safetensors");
    evaluate.extend(["-o".into(), evaluation.display().to_string()]);
    // The evaluation of an earlier run, with fewer variants, is replaced.
    play(&evaluate, &Run { force: true, ..run.clone() })?;
    let (judged, _) = Evaluation::read(&evaluation)?;
    let mut text = format!(
        "{:32} {:>10} {:>10} {:>8} {:>7} {:>10}\n",
        "variant", "parameters", "PSNR (dB)", "SSIM", "NRMSE", "training"
    );
    let mut table = Vec::new();
    for (name, output, parameters, seconds) in rows {
        let source = output.display().to_string();
        let Some(m) = judged.summary.methods.iter().find(|m| m.source == source) else {
            bail!("{}: {source} is missing", evaluation.display());
        };
        let time = seconds.map_or("-".into(), |s| format!("{s:.0} s"));
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "{name:32} {parameters:>10} {:>10.2} {:>8.3} {:>7.3} {time:>10}",
            m.psnr_db, m.ssim, m.nrmse
        );
        table.push(json!({
            "variant": name, "parameters": parameters, "psnr_db": m.psnr_db, "ssim": m.ssim, "nrmse": m.nrmse,
            "train_seconds": seconds, "checkpoint": source,
        }));
    }
    let json = json!({
        "ablation": table, "steps": args.steps, "frames": judged.summary.frames,
        "evaluation": super::common::in_json(&evaluation),
    });
    ommatidia_session::artifact::write_whole(&args.output.join(TABLE), format!("{json}\n").as_bytes())?;
    Ok(Outcome { json, text })
}

/// Resumes the training of a network that is there, or a part of it. Resuming compares shape, noise and settings; where
/// they differ, `--force` trains again.
fn resume_or_replace(words: &[String], run: &Run) -> anyhow::Result<()> {
    let resumed: Vec<String> = words.iter().cloned().chain(["--resume".into()]).collect();
    match play(&resumed, run) {
        Err(_) if run.force => play(words, run).map(|_| ()),
        done => done.map(|_| ()),
    }
}

/// Runs a command line of this program inside this process.
fn play(words: &[String], run: &Run) -> anyhow::Result<serde_json::Value> {
    let named = || format!("`ommatidia {}`", words.join(" "));
    if !run.quiet {
        eprintln!("{}", named());
    }
    let mut cli = Cli::try_parse_from(std::iter::once("ommatidia".to_string()).chain(words.iter().cloned()))
        .with_context(named)?;
    cli.run = run.clone();
    Ok(cli.run().with_context(named)?.json)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_default_variant_is_a_valid_training() {
        for (name, options) in VARIANTS {
            let words = "ommatidia train pairs --instrument i -o o --steps 5".split_whitespace();
            let parsed = Cli::try_parse_from(words.chain(options.split_whitespace()));
            assert!(parsed.is_ok(), "{name}: {}", parsed.err().map(|e| e.to_string()).unwrap_or_default());
        }
        assert_eq!(variant("a=--filters 2"), Ok(("a".into(), "--filters 2".into())));
        assert!(variant("=x").is_err());
    }
}
