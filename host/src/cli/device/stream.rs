//! `device stream`: frames in, reconstructions out, a live view in the browser.

use super::target::Target;
use crate::artifact::write_whole;
use crate::blob::{BlobFile, raw_codes};
use crate::cli::{Outcome, Run};
use crate::device::{FrameFeed, StreamReport, View, stream};
use crate::session::{FrameReader, FrameWriter, SampleType, StackSpec};
use anyhow::Context;
use ndarray::Array2;
use ommatidia_shared::blob::Size;
use serde_json::json;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

/// Options of `device stream`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Network file
    #[arg(long, value_name = "BLOB")]
    with: PathBuf,
    /// Raw frames, DN: .npy or .tif
    #[arg(long, value_name = "STACK")]
    frames: PathBuf,
    /// Frames that come in a second; those that the device has no time for are dropped and counted (default: each waits for the device)
    #[arg(long, value_name = "RATE", value_parser = rate)]
    fps: Option<f64>,
    /// Show the reconstructions in a browser at this address, e.g. 127.0.0.1:8080
    #[arg(long, value_name = "ADDRESS")]
    view: Option<SocketAddr>,
    /// Record the reconstructions: OME-TIFF or .npy, by suffix; their numbers and times go to a .csv beside it
    #[arg(short, long, value_name = "STACK")]
    output: Option<PathBuf>,
    #[command(flatten)]
    target: Target,
}

fn rate(text: &str) -> Result<f64, String> {
    let rate = text.parse().map_err(|e| format!("{e}"))?;
    if (1e-3..1e6).contains(&rate) { Ok(rate) } else { Err("expected 0.001 to 1000000 frames a second".into()) }
}

/// Runs the verb.
pub(super) fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    let blob = BlobFile::read(&args.with)?;
    let header = blob.network()?.header;
    let mut reader = FrameReader::open(&args.frames)?;
    let runtime = args.target.runtime(run)?;
    let view = match args.view {
        None => View::none(),
        Some(address) => View::serve(address).with_context(|| format!("{address}: no view can be served there"))?,
    };
    if let (Some(address), false) = (view.address(), run.quiet) {
        eprintln!("live view: http://{address}/");
    }
    let bar = run.progress(reader.len() as u64, "stream");
    let mut read = |i: usize| {
        bar.set_position(i as u64);
        let frame = reader.read(i)?;
        raw_codes(&header, frame.view()).with_context(|| format!("{}: frame {i}", args.frames.display()))
    };
    let len = FrameReader::open(&args.frames)?.len();
    let feed = FrameFeed { len, fps: args.fps, read: &mut read };
    let report = stream(&runtime, args.target.state.as_deref(), &blob, feed, &view)?;
    bar.finish_and_clear();
    if let Some(output) = &args.output {
        record(output, &report, header.object)?;
    }
    Ok(outcome(&report))
}

/// Writes the reconstructions, and beside them which frame each is and when it was there.
fn record(path: &Path, report: &StreamReport, size: Size) -> anyhow::Result<()> {
    let (rows, cols) = (size.rows.into(), size.cols.into());
    let spec = StackSpec { frames: report.frames.len(), rows, cols, samples: SampleType::F32, pixel_um: None };
    let mut writer = FrameWriter::create(path, spec)?;
    let mut table = String::from("page,frame,time_s,dropped_before,saturated_px\n");
    for (page, frame) in report.frames.iter().enumerate() {
        let values = frame.object.iter().map(|half| half.to_f32()).collect();
        writer.push(Array2::from_shape_vec((rows, cols), values)?.view())?;
        let (time, saturated) = (frame.at.as_secs_f64(), frame.report.saturated_px);
        table += &format!("{page},{},{time:.6},{},{saturated}\n", frame.frame, frame.dropped_before);
    }
    writer.finish()?;
    Ok(write_whole(&path.with_extension("csv"), table.as_bytes())?)
}

fn outcome(report: &StreamReport) -> Outcome {
    let (shown, seconds) = (report.frames.len(), report.took.as_secs_f64());
    let rate = shown as f64 / seconds.max(1e-9);
    let t = &report.telemetry;
    let json = json!({
        "board": report.board, "frames": shown + report.dropped, "reconstructed": shown, "dropped": report.dropped,
        "failed_on_the_line": report.failed, "seconds": seconds, "frames_per_second": rate,
        "device_dropped_frames": t.dropped_frames, "crc_errors": t.crc_errors, "dropped_packets": t.dropped_packets,
    });
    let text = format!(
        "board         {}\nframes        {} came, {shown} reconstructed, {} dropped ({} of them by the line)\nrate          {rate:.2} a second\n",
        report.board,
        shown + report.dropped,
        report.dropped,
        report.failed,
    );
    Outcome { json, text }
}
