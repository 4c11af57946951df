//! `erf`: effective receptive fields of a network beside PSFs, and its filters in real space.

use super::common::in_json;
use super::files::{Content, Files};
use super::{Outcome, Run};
use ndarray::Axis;
use ommatidia_model::instrument::Instrument;
use ommatidia_network::evaluate::receptive::receptive_fields;
use ommatidia_network::train::Checkpoint;
use ommatidia_session::artifact::Provenance;
use ommatidia_session::stack;
use std::fmt::Write;
use std::path::PathBuf;

/// Options of `erf`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Checkpoint of a network
    checkpoint: PathBuf,
    /// Instrument whose PSFs the receptive fields are compared with
    #[arg(long, value_name = "FILE")]
    instrument: PathBuf,
    /// Raw frames to average over [default: the held-out frames in the checkpoint]
    #[arg(long, value_name = "FRAMES")]
    frames: Option<PathBuf>,
    /// Artifact to write, for `report`
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
}

impl Args {
    /// What the verb reads and writes.
    pub fn files(&self) -> Files {
        Files::reading([&self.checkpoint, &self.instrument])
            .and_reading(&self.frames)
            .writing([&self.output], Content::artifact("receptive-field"))
    }
}

/// Runs the verb.
///
/// # Errors
/// A file cannot be read, sizes differ, or the output cannot be written.
pub fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    let checkpoint = Checkpoint::read(&args.checkpoint)?;
    let instrument = Instrument::read(&args.instrument)?;
    let frames: Vec<_> = match &args.frames {
        Some(path) => stack::read(path)?.axis_iter(Axis(0)).map(|f| f.to_owned()).collect(),
        None => checkpoint.cases.iter().map(|c| c.frame_dn.clone()).collect(),
    };
    let bar = run.progress(4 * frames.len() as u64, "erf");
    let found = receptive_fields(&checkpoint, &instrument, &frames, || bar.inc(1))?;
    bar.finish_and_clear();
    let config = serde_json::json!({ "frames": frames.len() });
    let mut provenance =
        Provenance::new("erf", run.seed, &config).with_input(&args.checkpoint)?.with_input(&args.instrument)?;
    if let Some(path) = &args.frames {
        provenance = provenance.with_input(path)?;
    }
    found.write(&args.output, provenance)?;
    let s = &found.summary;
    let mut text = format!(
        "{}: {}, mean over {} frames\n{:8} {:>12} {:>8} {:>10} {:>9} {:>10} {:>9}\n",
        args.output.display(),
        s.network,
        s.frames,
        "place",
        "pixel",
        "PCC",
        "elsewhere",
        "on foci",
        "foci area",
        "negative"
    );
    for p in &s.places {
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "{:8} {:>12} {:>8.3} {:>10.3} {:>8.1}% {:>9.1}% {:>8.1}%",
            p.name,
            format!("{}, {}", p.pixel[0], p.pixel[1]),
            p.pcc,
            p.pcc_elsewhere,
            100.0 * p.on_foci,
            100.0 * p.foci_area,
            100.0 * p.negative
        );
    }
    if !s.filters.is_empty() {
        let list = |f: &dyn Fn(usize) -> f64| {
            (0..s.filters.len()).map(|i| format!("{:.2}", f(i))).collect::<Vec<_>>().join(" ")
        };
        let _ = writeln!(text, "filters: PCC with the nearest pseudo-inverse {}", list(&|i| s.filters[i].pcc));
        let _ = writeln!(text, "         energy near multiples of the pitch {}", list(&|i| s.filters[i].on_lattice));
        let _ = writeln!(text, "         energy in the span of the pseudo-inverses {:.3}", s.in_span);
    }
    let mut json = serde_json::to_value(s)?;
    json["output"] = in_json(&args.output).into();
    Ok(Outcome { json, text })
}
