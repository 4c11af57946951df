//! `demo`: runs the other verbs one after another on the virtual instrument.

use super::common::{Outcome, Run};
use super::evaluate::table;
use super::files::{Content, Files};
use super::hidden::Hidden;
use anyhow::{Context, bail};
use ommatidia_network::evaluate::{Evaluation, MethodFigures};
use ommatidia_session::artifact;
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Options of `demo`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder for all results. That of an earlier demo is replaced, unless it holds files of yours
    #[arg(short, long, value_name = "DIR", default_value = "demo")]
    output: PathBuf,
    /// Number of scenes for the evaluation of the methods
    #[arg(long, value_name = "N", default_value_t = 12, value_parser = clap::value_parser!(u64).range(2..))]
    frames: u64,
    /// Number of training steps
    #[arg(long, value_name = "N", default_value_t = 4000, value_parser = clap::value_parser!(u64).range(1..))]
    steps: u64,
}

/// Parses a command line, program name included, and runs its verb under the given global options.
pub type Execute = fn(Vec<String>, Run) -> anyhow::Result<Outcome>;

/// One verb with its options, and its purpose.
struct Chapter {
    what: &'static str,
    /// Name of its figures; the verb, unless that comes twice.
    name: String,
    words: Vec<String>,
    /// Added to the seed of the run: the second session has other scenes and other noise.
    seed: u64,
}

impl Args {
    /// What the verb reads and writes.
    pub fn files(&self) -> Files {
        Files::default()
            .continuing([&self.output], Content::Named(is_own))
            .after_stop("the results so far are in the folder; the same command begins again")
    }
}

impl Chapter {
    /// The reconstructions of `device run` were made on this computer: no chapter calls them those of a device.
    fn name_the_host(&mut self) {
        for word in &mut self.words {
            if let Some(file) = word.strip_prefix("device=") {
                *word = format!("firmware-on-host={file}");
            }
        }
    }
}

/// Runs the verb.
///
/// # Errors
/// The folder holds something else, or a verb fails; what the verbs before it made is left in the folder.
pub fn run(args: &Args, run: &Run, execute: Execute) -> anyhow::Result<Outcome> {
    let start = Instant::now();
    let folder = &args.output;
    std::fs::create_dir_all(artifact::folder_of(folder)).with_context(|| folder.display().to_string())?;
    prepare(folder)?;
    let hidden = Hidden::draw(run.seed);
    let mut chapters = chapters(args, folder, &hidden);
    let (mut figures, mut line) = (serde_json::Map::new(), String::new());
    for i in 0..chapters.len() {
        let chapter = &chapters[i];
        let (json, seconds) = play(chapter, run, execute, [i + 1, chapters.len()], start)?;
        let name = chapter.name.clone();
        artifact::write_whole(&folder.join(format!("{name}.json")), format!("{json}\n").as_bytes())?;
        let mut entry = json;
        if let Some(fields) = entry.as_object_mut() {
            fields.insert("chapter_seconds".into(), json!(seconds));
        }
        if name == "close" {
            let (text, found) = hidden.outcome(&folder.join(CLOSED))?;
            let json = format!("{}\n", json!({ "hidden": found }));
            artifact::write_whole(&folder.join(HIDDEN), json.as_bytes())?;
            figures.insert("hidden".into(), found);
            line = text;
        }
        let not_on_a_device = entry["ran_on"] == "host";
        figures.insert(name, entry);
        if not_on_a_device {
            chapters[i + 1..].iter_mut().for_each(Chapter::name_the_host);
        }
    }
    closing(folder, &figures, &line, start.elapsed().as_secs_f64())
}

/// The files of a demo, without the figures of its chapters.
const FILES: [&str; 14] = [
    MARKER,
    TWO_PASSES,
    CLOSED,
    HIDDEN,
    "session",
    "hidden",
    "pairs",
    "instrument.safetensors",
    "network.safetensors",
    "network.omm",
    "device.npy",
    "objects.tif",
    "evaluation.safetensors",
    "closed.closing",
];
/// The chapters whose figures are kept as `NAME.json`.
const CHAPTERS: [&str; 11] = [
    "bench",
    "calibrate",
    "simulate",
    "train",
    "quantize",
    "device",
    "reconstruct",
    "evaluate",
    "changed",
    "close",
    "report",
];

/// Whether a file of this name is one of a demo's.
fn is_own(name: &str) -> bool {
    let of_chapter = |name: &str| name.strip_suffix(".json").is_some_and(|name| CHAPTERS.contains(&name));
    FILES.contains(&name) || of_chapter(name) || name == "report.html"
}

/// A network of two passes that comes with the program, and its name in the folder. It was trained for this instrument
/// (docs/results.md says how), which takes longer than a demo should.
const TRAINED: &[u8] = include_bytes!("../../networks/two-passes.omm");
const TWO_PASSES: &str = "two-passes.omm";

/// Marks a folder as one that a demo may replace.
const MARKER: &str = "demo.toml";

fn prepare(folder: &Path) -> anyhow::Result<()> {
    let named = || folder.display().to_string();
    if folder.exists() {
        let empty = std::fs::read_dir(folder).with_context(named)?.next().is_none();
        if !empty && !folder.join(MARKER).exists() {
            bail!(
                "{}: expected a new or empty folder, or that of an earlier demo, found other files; choose another \
                    with -o",
                named()
            );
        }
        std::fs::remove_dir_all(folder).with_context(named)?;
    }
    std::fs::create_dir_all(folder).with_context(named)?;
    let text = format!(
        "# Made by `ommatidia demo`, which replaces this folder.\nversion = \"{}\"\n",
        env!("CARGO_PKG_VERSION")
    );
    artifact::write_whole(&folder.join(TWO_PASSES), TRAINED)?;
    Ok(artifact::write_whole(&folder.join(MARKER), text.as_bytes())?)
}

/// The instrument whose loop is closed.
const CLOSED: &str = "closed.safetensors";
/// The hidden effect and what `close` found, for the report.
const HIDDEN: &str = "hidden.json";

fn chapters(args: &Args, folder: &Path, hidden: &Hidden) -> Vec<Chapter> {
    let at = |name: &str| folder.join(name).display().to_string();
    let chapter = |what, text: &str| {
        // `@name` stands for a file of the folder, whose path may hold blanks.
        let word = |w: &str| match w.split_once('@') {
            Some((before, name)) => format!("{before}{}", at(name)),
            None => w.to_string(),
        };
        let words: Vec<String> = text.split_whitespace().map(word).collect();
        Chapter { what, name: words[0].clone(), words, seed: 0 }
    };
    let bench = format!("bench @session --frames {}", args.frames);
    // A short training on few kinds of specimens bears long steps.
    let train = format!(
        "train @pairs --instrument @instrument.safetensors -o @network.safetensors --preset nano --learning-rate 5e-3 \
         --steps {}",
        args.steps
    );
    let changed = format!("bench @hidden --frames {SCENES} --effect {}", hidden.option());
    let what = "a second session, of the same instrument with a hidden effect";
    let changed = Chapter { name: "changed".into(), seed: 1, ..chapter(what, &changed) };
    vec![
        chapter("the virtual instrument measures darks, flats, a bead scan and scenes of known truth", &bench),
        chapter(
            "noise, chief rays and low-rank PSFs from that session",
            "calibrate @session -o @instrument.safetensors",
        ),
        chapter(
            "simulated training pairs of the calibrated model, of the specimens and the light of the session",
            "simulate @instrument.safetensors -o @pairs --count 1024 --specimen \
             beads,cells,neurons,vessels,worms,target --peak-e 1000 8000",
        ),
        chapter("training of the network", &train),
        chapter(
            "the network file for a device: half precision, memory plan",
            "quantize @network.safetensors -o @network.omm",
        ),
        chapter(
            "the firmware reconstructs the scenes",
            "device run --with @network.omm --frames @session/scene.npy -o @device.npy",
        ),
        chapter(
            "the host reconstructs the same scenes",
            "reconstruct @session/scene.npy -o @objects.tif --with \
            @network.omm",
        ),
        chapter(
            "comparison of all methods on the scenes, which no step before has used; two-passes.omm comes with the \
             program, trained for longer",
            "evaluate @session --with @network.safetensors --with @network.omm --with @two-passes.omm \
             --with @instrument.safetensors --stack device=@device.npy -o @evaluation.safetensors",
        ),
        changed,
        chapter(
            "closing the loop: which effect does the calibrated model lack now?",
            &format!("close @hidden --instrument @instrument.safetensors -o @{CLOSED}"),
        ),
        chapter(
            "one page with all results",
            "report @evaluation.safetensors @hidden.json @closed.closing @device.json @network.omm \
                @instrument.safetensors @network.safetensors @session \
             -o @report.html",
        ),
    ]
}

/// Scenes of the second session.
const SCENES: usize = 8;

/// Runs a chapter as a command line of its own, inside this process.
fn play(
    chapter: &Chapter,
    run: &Run,
    execute: Execute,
    [number, of]: [usize; 2],
    begin: Instant,
) -> anyhow::Result<(Value, f64)> {
    let say = |text: String| {
        if !run.quiet {
            eprintln!("{text}");
        }
    };
    say(format!("[{number}/{of}] {}\n      ommatidia {}", chapter.what, chapter.words.join(" ")));
    let start = Instant::now();
    let words = std::iter::once("ommatidia".to_string()).chain(chapter.words.iter().cloned());
    let run = Run { seed: run.seed.wrapping_add(chapter.seed), ..run.clone() };
    let outcome = execute(words.collect(), run).with_context(|| format!("`ommatidia {}`", chapter.words.join(" ")))?;
    let seconds = start.elapsed().as_secs_f64();
    for line in outcome.text.lines() {
        say(format!("      {line}"));
    }
    let elapsed = begin.elapsed().as_secs();
    say(format!("      chapter {seconds:.1} s, since the start {}:{:02}\n", elapsed / 60, elapsed % 60));
    Ok((outcome.json, seconds))
}

/// The table of methods, the targets, and the path of the report.
fn closing(
    folder: &Path,
    figures: &serde_json::Map<String, Value>,
    hidden: &str,
    seconds: f64,
) -> anyhow::Result<Outcome> {
    let (evaluation, _) = Evaluation::read(&folder.join("evaluation.safetensors"))?;
    let methods = &evaluation.summary.methods;
    let device = figures.get("device").unwrap_or(&Value::Null);
    let targets = targets(methods, device);
    let mut text = table(methods);
    text.push('\n');
    for t in &targets {
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "{:34} {:>12}   target {:<16} {}",
            t.what,
            t.found,
            t.target,
            match t.holds {
                Some(true) => "holds",
                Some(false) => "MISSED",
                None => "not tested",
            }
        );
    }
    let _ = writeln!(text, "\n{hidden}");
    let page = folder.join("report.html");
    let page = page.canonicalize().unwrap_or(page);
    let _ = writeln!(text, "\nTotal time {}. Report: {}", ommatidia_report::seconds(seconds), page.display());
    let targets: Vec<Value> = targets
        .iter()
        .map(|t| json!({ "what": t.what, "found": t.found, "target": t.target, "holds": t.holds }))
        .collect();
    let report = super::common::in_json(&page);
    Ok(Outcome { json: json!({ "seconds": seconds, "report": report, "targets": targets, "chapters": figures }), text })
}

/// A target of the demo.
struct Target {
    what: &'static str,
    found: String,
    target: &'static str,
    /// `None`: nothing was measured.
    holds: Option<bool>,
}

fn targets(methods: &[MethodFigures], device: &Value) -> Vec<Target> {
    // Beside a second network file the name of the first has its file behind it.
    let own = |m: &&MethodFigures, name: &str| m.name == name || m.name == format!("{name}@network.omm");
    let psnr = |name: &str| methods.iter().find(|m| own(m, name)).map(|m| m.psnr_db);
    let mut targets = Vec::new();
    if let (Some(network), Some(wiener)) = (psnr("svfouriernet"), psnr("wiener")) {
        let gain = network - wiener;
        let (what, target) = ("network minus Wiener deconvolution", ">= 2 dB");
        targets.push(Target { what, found: format!("{gain:+.2} dB"), target, holds: Some(gain >= 2.0) });
    }
    if let (Some(network), Some(blob)) = (psnr("svfouriernet"), psnr("svfouriernet-blob")) {
        let change = blob - network;
        let (what, target) = ("network file minus float network", ">= -0.1 dB");
        targets.push(Target { what, found: format!("{change:+.3} dB"), target, holds: Some(change >= -0.1) });
    }
    if let Some(exact) = device["bit_exact"].as_bool() {
        let (what, target) = ("bits that differ, device and host", "0");
        let bits = device["differing_bits"].as_u64().map(|n| n.to_string());
        let found = bits.unwrap_or_else(|| if exact { "0".into() } else { "some".into() });
        targets.push(match device["ran_on"] == "host" {
            true => Target { what, found: "no device".into(), target, holds: None },
            false => Target { what, found, target, holds: Some(exact) },
        });
    }
    targets
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::cli::Cli;
    use clap::Parser;
    use ommatidia_network::network_file::NetworkFile;

    #[test]
    fn each_chapter_is_a_command_line_that_the_program_takes() {
        let args = Args { output: "a folder".into(), frames: 4, steps: 10 };
        for chapter in chapters(&args, &args.output, &Hidden::draw(1)) {
            let words = std::iter::once("ommatidia".to_string()).chain(chapter.words.iter().cloned());
            let parsed = Cli::try_parse_from(words);
            assert!(parsed.is_ok(), "{}: {}", chapter.words.join(" "), parsed.unwrap_err());
        }
    }

    #[test]
    fn a_folder_of_something_else_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("thesis.tex");
        std::fs::write(&file, "years of work").unwrap();
        assert!(prepare(folder.path()).unwrap_err().to_string().contains("earlier demo"));
        assert!(file.exists());
        std::fs::write(folder.path().join(MARKER), "").unwrap();
        prepare(folder.path()).unwrap();
        assert!(!file.exists() && folder.path().join(MARKER).exists());
    }

    #[test]
    fn the_network_that_comes_with_the_program_has_two_passes_and_the_sizes_of_the_instrument() {
        let file = NetworkFile::from_bytes(Path::new(TWO_PASSES), TRAINED).unwrap();
        let header = file.header().unwrap();
        assert_eq!(header.passes.as_ref().map(|p| p.later), Some(1));
        assert_eq!([header.frame.rows, header.frame.cols, header.object.rows, header.object.cols], [214, 214, 96, 96]);
        assert!(TRAINED.len() < 2_000_000);
    }

    #[test]
    fn targets_show_the_measured_values() {
        let method = |name: &str, psnr_db| MethodFigures { name: name.into(), psnr_db, ..MethodFigures::default() };
        let methods = [method("svfouriernet", 25.0), method("svfouriernet-blob", 24.8), method("wiener", 22.0)];
        let found = targets(&methods, &json!({ "bit_exact": false, "differing_bits": 7 }));
        let beside_another = [
            method("svfouriernet", 25.0),
            method("svfouriernet-blob@two-passes.omm", 26.0),
            method("svfouriernet-blob@network.omm", 24.8),
        ];
        assert_eq!(targets(&beside_another, &Value::Null)[0].found, "-0.200 dB");
        let lines: Vec<_> = found.iter().map(|t| (t.found.as_str(), t.holds)).collect();
        assert_eq!(lines, [("+3.00 dB", Some(true)), ("-0.200 dB", Some(false)), ("7", Some(false))]);
        // Without an emulator the host was compared with itself: no target of a device holds by that.
        let here = json!({ "bit_exact": true, "differing_bits": 0, "ran_on": "host" });
        let found = targets(&methods, &here);
        assert_eq!((found[2].found.as_str(), found[2].holds), ("no device", None));
        let mut chapters =
            chapters(&Args { output: "x".into(), frames: 4, steps: 10 }, Path::new("x"), &Hidden::draw(1));
        chapters.iter_mut().for_each(Chapter::name_the_host);
        let words: Vec<&String> = chapters.iter().flat_map(|chapter| &chapter.words).collect();
        assert!(words.iter().any(|word| word.starts_with("firmware-on-host=")));
        assert!(!words.iter().any(|word| word.starts_with("device=")));
        assert!(targets(&methods[..1], &Value::Null).is_empty());
    }
}
