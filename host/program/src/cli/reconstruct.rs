//! `reconstruct`: raw frames in, objects out.

use super::common::warn;
use super::files::{Content, Files};
use super::{Outcome, Run};
use anyhow::Context;
use ommatidia_network::methods::{MethodKind, frame_range};
use ommatidia_physics::sensor::FrameWatch;
use ommatidia_session::kind::FileKind;
use ommatidia_session::{FrameReader, FrameWriter, SampleType, StackSpec};
use std::path::PathBuf;
use std::time::Instant;

/// Options of `reconstruct`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Raw frames, DN, [frames, rows, cols]: .npy or .tif
    frames: PathBuf,
    /// Objects, float32 [frames, rows, cols]: .npy or OME-TIFF, by suffix
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Checkpoint, network file, or instrument
    #[arg(long = "with", value_name = "FILE")]
    with: PathBuf,
    /// Method [default: svfouriernet for checkpoints and network files, wiener for instruments]
    #[arg(long, value_name = "METHOD")]
    method: Option<MethodKind>,
}

impl Args {
    /// What the verb reads and writes.
    pub fn files(&self) -> Files {
        Files::reading([&self.frames, &self.with]).writing([&self.output], Content::File(FileKind::Stack))
    }
}

/// Runs the verb.
///
/// # Errors
/// A file cannot be read or does not fit the method, or the output cannot be written. No output is left then.
pub fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    let mut frames = FrameReader::open(&args.frames)?;
    let kind = args.method.map_or_else(|| MethodKind::default_for(&args.with), Ok)?;
    let start = Instant::now();
    let method = kind.open(&args.with, run.seed)?;
    let plan_seconds = start.elapsed().as_secs_f64();
    let count = frames.len();
    let mut watch = frame_range(&args.with)?.map(FrameWatch::new);
    let bar = run.progress(count as u64, "reconstruct");
    let mut writer: Option<FrameWriter> = None;
    let mut seconds = 0.0;
    for i in 0..count {
        let frame = frames.read(i)?;
        if let Some(watch) = &mut watch {
            watch.see(i, frame.view());
        }
        let start = Instant::now();
        let object = method.reconstruct(frame.view());
        seconds += start.elapsed().as_secs_f64();
        let object = object.with_context(|| format!("{}: frame {i}", args.frames.display()))?;
        let writer = match &mut writer {
            Some(writer) => writer,
            // All objects have the size of the first.
            None => writer.insert(FrameWriter::create(
                &args.output,
                StackSpec {
                    frames: count,
                    rows: object.nrows(),
                    cols: object.ncols(),
                    samples: SampleType::F32,
                    pixel_um: None,
                },
            )?),
        };
        writer.push(object.view())?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    if let Some(writer) = writer {
        writer.finish()?;
    }
    let warnings = warn(watch.and_then(|watch| watch.warning(&args.frames)));
    let per_frame = seconds / count.max(1) as f64;
    Ok(Outcome {
        json: serde_json::json!({
            "method": method.name(), "frames": count, "seconds_per_frame": per_frame, "plan_seconds": plan_seconds,
            "output": args.output, "warnings": warnings,
        }),
        text: format!(
            "{} ({} frames, {}): {} a frame, after {} of planning\n",
            args.output.display(),
            count,
            ommatidia_network::methods::title(method.name()),
            ommatidia_report::seconds(per_frame),
            ommatidia_report::seconds(plan_seconds)
        ),
    })
}
