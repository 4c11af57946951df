//! `reconstruct`: raw frames in, objects out.

use super::common::{ResultScale, warn};
use super::files::{Content, Files};
use super::{Outcome, Run};
use anyhow::Context;
use ommatidia_network::methods::{MethodKind, frame_range};
use ommatidia_physics::sensor::FrameWatch;
use ommatidia_session::artifact;
use ommatidia_session::kind::FileKind;
use ommatidia_session::{FrameReader, FrameWriter, SampleType, StackSpec};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Side of an object pixel, um, of the instrument at `path`; None for other files.
fn object_pixel_um(path: &Path) -> anyhow::Result<Option<f64>> {
    Ok(match FileKind::of(path)? {
        FileKind::Artifact(kind) if kind == "instrument" => {
            artifact::inspect(path)?["body"]["manifest"]["object"]["pixel_um"].as_f64()
        }
        _ => None,
    })
}

/// What a method does before the first frame.
fn planning(kind: MethodKind) -> &'static str {
    match kind {
        MethodKind::Wiener => "planning: choosing the regularisation on simulated scenes",
        _ => "planning: reading and preparing the method",
    }
}

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
    #[command(flatten)]
    scale: ResultScale,
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
    let (planning, start) = (run.spinner(planning(kind)), Instant::now());
    let method = kind.open(&args.with, run.seed)?;
    let plan_seconds = start.elapsed().as_secs_f64();
    planning.finish_and_clear();
    let pixel_um = args.scale.pixel_um.map_or_else(|| object_pixel_um(&args.with), |um| Ok(Some(um)))?;
    let interval_s = args.scale.interval_s.or(frames.scale().interval_s);
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
            None => writer.insert(
                FrameWriter::create(
                    &args.output,
                    StackSpec {
                        frames: count,
                        rows: object.nrows(),
                        cols: object.ncols(),
                        samples: SampleType::F32,
                        pixel_um,
                    },
                )?
                .with_interval(interval_s),
            ),
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
            "pixel_um": pixel_um, "interval_s": interval_s, "output": args.output, "warnings": warnings,
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
