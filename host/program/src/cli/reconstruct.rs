//! `reconstruct`: raw frames in, objects out.

mod input;
mod limits;
mod parts;

use super::common::{ResultScale, Strict, in_json, warn};
use super::files::{Content, Files};
use super::shard::shard;
use super::uncertainty::instrument_for;
use super::{Outcome, Run};
use anyhow::{Context, ensure};
use input::Input;
use limits::Limits;
use ndarray::Array2;
use ommatidia_model::dataset::Share;
use ommatidia_network::methods::{MethodKind, Reconstruct, frame_range};
use ommatidia_physics::sensor::FrameWatch;
use ommatidia_session::artifact;
use ommatidia_session::kind::FileKind;
use ommatidia_session::{FrameWriter, SampleType, StackSpec};
use parts::Parts;
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
    /// Raw frames, DN: a file .npy, .tif, .avi or .mat, a folder of numbered .avi or .tif files (such as that of a UCLA
    /// Miniscope), an OME-Zarr, or a session with one stack of scenes
    frames: PathBuf,
    /// Objects, by suffix: .npy, .tif (OME-TIFF; BigTIFF from 4 GB on), .zarr (OME-Zarr 0.5), all float32; .avi or
    /// .mp4, 8 bits for the eye, by ffmpeg
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
    /// Write the time of each frame to this CSV, for recordings with timestamps
    #[arg(long, value_name = "FILE")]
    times: Option<PathBuf>,
    /// Keep finished parts in OUT.parts, and go on with those that are missing. Makes OUT when all are there
    #[arg(long)]
    resume: bool,
    /// Make only every N-th part, starting with number I (counted from 1), so that N computers share the work; auto: as
    /// the scheduler says (docs/clusters.md). Then --resume makes OUT
    #[arg(long, value_name = "I/N", value_parser = |text: &str| shard::<Share>(text, 1), conflicts_with = "resume")]
    shard: Option<Share>,
    /// Write intervals for each pixel, too: OUT.lower and OUT.upper before the suffix, by these widths (made by
    /// `uncertainty`; docs/uncertainty.md)
    #[arg(long, value_name = "WIDTHS", conflicts_with_all = ["resume", "shard"])]
    uncertainty: Option<PathBuf>,
    /// Instrument that the widths were made for [default: the file of --with, if it is an instrument]
    #[arg(long, value_name = "FILE", requires = "uncertainty")]
    instrument: Option<PathBuf>,
    #[command(flatten)]
    strict: Strict,
}

impl Args {
    /// What the verb reads and writes.
    pub fn files(&self) -> Files {
        let files = Files::reading([&self.frames, &self.with]);
        let files = files.and_reading(&self.uncertainty).and_reading(&self.instrument);
        let parts = |files: Files| {
            let folder = Parts::folder_of(&self.output);
            files.continuing([folder], Content::Folder(parts::PLAN)).after_stop("the same command goes on")
        };
        if let Some(share) = self.shard {
            return parts(files).share(share);
        }
        let zarr = self.output.extension().is_some_and(|e| e.eq_ignore_ascii_case("zarr"));
        let content = if zarr { Content::Zarr } else { Content::File(FileKind::Stack) };
        let limits = self.uncertainty.as_ref().map(|_| limits::beside(&self.output)).into_iter().flatten();
        let files = files
            .writing([self.output.clone()].into_iter().chain(limits), content)
            .writing(&self.times, Content::Text(input::TABLE));
        if self.resume { parts(files) } else { files }
    }
}

/// The output, which is begun with the first object: all have its size.
struct Output<'a> {
    path: &'a Path,
    frames: usize,
    pixel_um: Option<f64>,
    interval_s: Option<f64>,
    writer: Option<FrameWriter>,
}

impl Output<'_> {
    fn push(&mut self, object: &Array2<f32>) -> anyhow::Result<()> {
        let writer = match &mut self.writer {
            Some(writer) => writer,
            None => {
                let (rows, cols) = object.dim();
                let spec =
                    StackSpec { frames: self.frames, rows, cols, samples: SampleType::F32, pixel_um: self.pixel_um };
                self.writer.insert(FrameWriter::create(self.path, spec)?.with_interval(self.interval_s))
            }
        };
        Ok(writer.push(object.view())?)
    }

    fn finish(self) -> anyhow::Result<()> {
        self.writer.map_or(Ok(()), |writer| Ok(writer.finish()?))
    }
}

/// Reconstructs frames, and keeps count of the time.
struct Work<'a> {
    limits: Option<Limits<'a>>,
    input: Input,
    method: Box<dyn Reconstruct>,
    watch: Option<FrameWatch>,
    path: &'a Path,
    seconds: f64,
    done: usize,
}

impl Work<'_> {
    fn object(&mut self, i: usize) -> anyhow::Result<Array2<f32>> {
        let frame = self.input.frames.read(i)?;
        if let Some(watch) = &mut self.watch {
            watch.see(i, frame.view());
        }
        let start = Instant::now();
        let object = self.method.reconstruct(frame.view());
        self.seconds += start.elapsed().as_secs_f64();
        self.done += 1;
        let at = || format!("{}: frame {i}", self.path.display());
        let object = object.with_context(at)?;
        if let Some(limits) = &mut self.limits {
            limits.push(frame.view(), &object).with_context(at)?;
        }
        Ok(object)
    }
}

/// Runs the verb.
///
/// # Errors
/// A file cannot be read or does not fit the method, or the output cannot be written. No output is left then; parts
/// stay.
pub fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    FrameWriter::check_name(&args.output)?;
    let mut input = Input::open(&args.frames)?;
    let table = args.times.as_ref().map(|_| input.table()).transpose()?;
    let kind = args.method.map_or_else(|| MethodKind::default_for(&args.with), Ok)?;
    let count = input.frames.len();
    let parts = match args.resume || args.shard.is_some() {
        true => {
            let plan = Parts::plan(&mut input.frames, &args.with, kind.name(), run.seed)?;
            Some(Parts::open(&args.output, plan)?)
        }
        false => None,
    };
    let (planning, start) = (run.spinner(planning(kind)), Instant::now());
    let method = kind.open(&args.with, run.seed)?;
    let plan_seconds = start.elapsed().as_secs_f64();
    planning.finish_and_clear();
    let name = method.name().to_string();
    let pixel_um = args.scale.pixel_um.map_or_else(|| object_pixel_um(&args.with), |um| Ok(Some(um)))?;
    let interval_s = args.scale.interval_s.or(input.interval_s());
    let watch = frame_range(&args.with)?.map(FrameWatch::new);
    let to = |path| Output { path, frames: count, pixel_um, interval_s, writer: None };
    let beside = limits::beside(&args.output);
    let limits = match &args.uncertainty {
        Some(widths) => {
            let suffix = args.output.extension().unwrap_or_default().to_ascii_lowercase();
            ensure!(
                suffix != "avi" && suffix != "mp4",
                "{}: a video of 8 bits cannot hold intervals; choose .npy, .tif or .zarr",
                args.output.display()
            );
            let instrument = instrument_for(&args.with, args.instrument.as_ref())?;
            Some(Limits::open(widths, &name, &args.with, &instrument, [to(&beside[0]), to(&beside[1])])?)
        }
        None => None,
    };
    let mut output = to(&args.output);
    let mut work = Work { limits, input, method, watch, path: &args.frames, seconds: 0.0, done: 0 };
    let mut missing = 0;
    match parts {
        None => {
            let bar = run.progress(count as u64, "reconstruct");
            for i in 0..count {
                output.push(&work.object(i)?)?;
                bar.inc(1);
            }
            bar.finish_and_clear();
            output.finish()?;
        }
        Some(parts) => {
            let todo = parts.missing(args.shard.unwrap_or(Share::ALL));
            let mut ahead: usize = todo.iter().map(|(_, frames)| frames.len()).sum();
            let bar = run.progress(ahead as u64, "reconstruct");
            // The output is made beside the parts.
            ahead += if args.shard.is_none() { count } else { 0 };
            for (k, frames) in todo {
                let made = frames.len();
                parts.make(k, frames, ahead, |i| {
                    bar.inc(1);
                    work.object(i)
                })?;
                ahead -= made;
            }
            bar.finish_and_clear();
            missing = parts.missing(Share::ALL).len();
            if args.shard.is_none() {
                parts.each(|object| output.push(&object))?;
                output.finish()?;
                parts.remove();
            }
        }
    }
    if let (Some(path), Some(table)) = (&args.times, table) {
        artifact::write_whole(path, table.as_bytes())?;
    }
    let losses = work.input.losses();
    let found = work.input.warnings(&losses, args.times.is_some());
    let limited = work.limits.take().map(|limits| limits.finish(&args.frames)).transpose()?;
    let (doubts, intervals) = limited.unwrap_or_default();
    let watched = work.watch.and_then(|watch| watch.warning(&args.frames));
    let warnings = warn(found.into_iter().chain(watched).chain(doubts));
    let (seconds, done) = (work.seconds, work.done);
    let per_frame = seconds / done.max(1) as f64;
    let mut text = format!(
        "{} ({}, {}): {} a frame, after {} of planning\n",
        args.output.display(),
        losses.used(count),
        ommatidia_network::methods::title(&name),
        ommatidia_report::seconds(per_frame),
        ommatidia_report::seconds(plan_seconds)
    );
    if args.uncertainty.is_some() {
        text += &format!("intervals: {} to {}\n", beside[0].display(), beside[1].display());
    }
    if args.shard.is_some() {
        let folder = Parts::folder_of(&args.output);
        let made = if done == 1 { "1 frame".into() } else { format!("{done} frames") };
        let absent = if missing == 1 { "1 part is".into() } else { format!("{missing} parts are") };
        text = format!("{made} made in {}; {absent} missing\n", folder.display());
        if missing == 0 {
            text += "all parts are there: the same command with --resume in place of --shard makes the output\n";
        }
    }
    let outcome = Outcome {
        json: serde_json::json!({
            "method": name, "frames": count, "seconds_per_frame": per_frame, "plan_seconds": plan_seconds,
            "pixel_um": pixel_um, "interval_s": interval_s, "output": in_json(&args.output), "warnings": warnings,
            "frames_made": done, "parts_missing": missing, "gaps": losses.gaps.len(),
            "times": args.times.as_ref().map(in_json), "intervals": intervals, "lost": losses.lost, "losses": losses,
        }),
        text,
    };
    args.strict.judge(losses.any() || work.input.is_damaged(), outcome)
}
