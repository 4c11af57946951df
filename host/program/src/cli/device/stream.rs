//! `device stream`: frames in, reconstructions out, a live view in the browser.

use super::camera::CameraArgs;
use super::target::Target;
use crate::cli::common::{Outcome, ResultScale, Run, warn};
use crate::cli::files::{Content, Files};
use crate::device::{
    FrameFeed, Frames, LiveView, PageScale, Place, StreamRecording, StreamReport, active_fraction, stream, watch_json,
    watch_text,
};
use anyhow::{Context, bail};
use ommatidia_network::methods::frame_range;
use ommatidia_network::network_file::NetworkFile;
use ommatidia_physics::sensor::FrameWatch;
use ommatidia_session::FrameReader;
use ommatidia_session::kind::FileKind;
use ommatidia_shared::wire::CameraChange;
use serde_json::json;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

/// Options of `device stream`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Network file of a device, from `ommatidia quantize`
    #[arg(long, value_name = "BLOB")]
    with: PathBuf,
    /// Raw frames, DN: .npy, .tif, .avi, .mat, .zarr, or the folder of a recording
    #[arg(long, value_name = "STACK", required_unless_present = "live")]
    frames: Option<PathBuf>,
    /// Take N frames from the device's own camera
    #[arg(long, value_name = "N", conflicts_with = "frames", value_parser = clap::value_parser!(u32).range(1..))]
    live: Option<u32>,
    /// Frame rate, frames per second; frames that arrive while the device is busy are dropped and counted (default:
    /// each frame waits for the device)
    #[arg(long, value_name = "RATE", value_parser = rate)]
    fps: Option<f64>,
    /// Reconstruct only every N-th frame; the device sleeps meanwhile
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    every: u32,
    #[command(flatten)]
    scope: super::scope::ScopeArgs,
    /// Show the reconstructions in a browser at this address, e.g. 127.0.0.1:8080
    #[arg(long, value_name = "ADDRESS")]
    view: Option<SocketAddr>,
    /// Record the reconstructions to an OME-TIFF, readable at any time. A .csv beside it lists the number and time of
    /// each, the frame whose statistics of the field were used, and for frames of a camera the start of the exposure
    /// and the settings
    #[arg(short, long, value_name = "TIF")]
    output: Option<PathBuf>,
    #[command(flatten)]
    scale: ResultScale,
    #[command(flatten)]
    camera: CameraArgs,
    #[command(flatten)]
    target: Target,
}

fn rate(text: &str) -> Result<f64, String> {
    let rate = text.parse().map_err(|e| format!("{e}"))?;
    if (1e-3..1e6).contains(&rate) { Ok(rate) } else { Err("expected 0.001 to 1000000 frames a second".into()) }
}

impl Args {
    /// What the verb reads and writes.
    pub(super) fn files(&self) -> Files {
        let table = self.output.as_ref().map(|output| StreamRecording::table_path(output));
        let files = Files::reading([&self.with])
            .and_reading(&self.frames)
            .writing(&self.output, Content::File(FileKind::Stack))
            .writing(table, Content::Text(StreamRecording::START));
        self.target.with_files(files).after_stop("the recording so far can be read")
    }

    /// Pixel size and interval of the pages. `of_frames_s` is the time between the frames that their file states.
    fn page_scale(&self, of_frames_s: Option<f64>) -> PageScale {
        let every_frame_s = self.scale.interval_s.or(of_frames_s).or(self.fps.map(|fps| 1.0 / fps));
        let interval_s = every_frame_s.map(|s| s * f64::from(self.every));
        PageScale { pixel_um: self.scale.pixel_um, interval_s }
    }
}

/// Runs the verb.
pub(super) fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    let change = args.camera.change();
    if args.live.is_none() && change != CameraChange::default() {
        bail!("settings of the camera are for its own frames: give `--live N` in place of `--frames STACK`");
    }
    let blob = NetworkFile::read(&args.with)?;
    let header = blob.network()?.into_header();
    let mut reader = args.frames.as_deref().map(FrameReader::open).transpose()?;
    let len = reader.as_ref().map_or(args.live.unwrap_or_default() as usize, FrameReader::len);
    let region = args.scope.region(&header);
    let mut watch = frame_range(&args.with)?.map(FrameWatch::new);
    let runtime = args.target.runtime(run)?;
    let view = match args.view {
        None => LiveView::none(),
        Some(address) => LiveView::serve(address).with_context(|| {
            format!(
                "{address}: the live view cannot be served \
            there"
            )
        })?,
    };
    if let (Some(address), false) = (view.address(), run.quiet) {
        eprintln!("live view: http://{address}/");
    }
    let scale = args.page_scale(reader.as_ref().and_then(|reader| reader.scale().interval_s));
    let mut record = args.output.as_deref().map(|path| StreamRecording::create(path, region, scale)).transpose()?;
    let bar = run.progress(len as u64, "stream");
    let mut read = |i: usize| {
        let reader = reader.as_mut().context("no frames were given with --frames")?;
        let frame = reader.read(i)?;
        if let Some(watch) = &mut watch {
            watch.see(i, frame.view());
        }
        blob.codes(frame.view()).with_context(|| format!("{}: frame {i}", reader.path().display()))
    };
    let source = if args.frames.is_some() { Frames::Stack(&mut read) } else { Frames::Camera(change) };
    let feed = FrameFeed { len, fps: args.fps, nth: args.every as usize, scope: args.scope.scope(), source };
    let report = stream(&runtime, args.target.state.as_deref(), &blob, feed, &mut |frame| {
        bar.set_position(frame.frame as u64 + 1);
        view.show(frame);
        record.as_mut().map_or(Ok(()), |record| record.push(frame))
    })?;
    bar.finish_and_clear();
    view.end();
    let stack = args.frames.as_deref().unwrap_or(&args.with);
    let warnings = warn(watch.and_then(|watch| watch.warning(stack)));
    let mut outcome = outcome(&report, len, runtime.place());
    outcome.json["warnings"] = json!(warnings);
    if let Some((file, record)) = args.output.as_ref().zip(record) {
        let scale = PageScale { interval_s: record.interval_s(), ..scale };
        (outcome.json["pixel_um"], outcome.json["interval_s"]) = (json!(scale.pixel_um), json!(scale.interval_s));
        outcome.text += &recorded(file, scale);
    }
    Ok(outcome)
}

/// What a recording says of space and time, and where to find what it does not say.
fn recorded(file: &Path, scale: PageScale) -> String {
    let pixel = scale.pixel_um.map_or("no pixel size (give --pixel-um)".into(), |um| format!("pixels of {um} um"));
    let interval =
        scale.interval_s.map_or("no interval (the .csv lists frames and times)".into(), |s| format!("{s} s a page"));
    format!("recording     {}: {pixel}, {interval}\n", file.display())
}

fn outcome(report: &StreamReport, came: usize, place: Place) -> Outcome {
    let (shown, seconds) = (report.reconstructed, report.took.as_secs_f64());
    let left_out = came - shown - report.dropped;
    let rate = shown as f64 / seconds.max(1e-9);
    let t = &report.telemetry;
    let json = json!({
        "board": report.board, "ran_on": place.name(), "frames": came, "reconstructed": shown,
        "dropped": report.dropped, "left_out": left_out,
        "failed_on_the_line": report.failed, "not_delivered": report.undelivered, "restarts": report.restarts,
        "held": report.held, "seconds": seconds, "frames_per_second": rate,
        "active_fraction": active_fraction(t),
        "device_dropped_frames": t.dropped_frames, "crc_errors": t.crc_errors, "dropped_packets": t.dropped_packets,
    });
    let text = format!(
        "board         {}\nframes        {came} arrived, {shown} reconstructed, {} dropped ({} of them lost on the \
            line, {} not delivered by the sensor), {left_out} skipped by --every\nfield         {}\n\
            rate          {rate:.2} frames per second\nawake         {}\n",
        place.board(&report.board),
        report.dropped,
        report.failed,
        report.undelivered,
        super::scope::exactness(report.held, shown),
        super::status::active_text(t),
    );
    let mut outcome = Outcome { json, text };
    if report.restarts > 0 {
        outcome.text +=
            &format!("restarts      {} of the device; its camera got its settings again\n", report.restarts);
    }
    let since = |_: &_| report.moved_since.map_or("before this stream".into(), |frame| format!("frame {frame}"));
    if let Some(sentence) = watch_text(&t.watch, since) {
        outcome.text += &format!("optics        {sentence}\n");
        outcome.json["watch"] = watch_json(&t.watch);
        outcome.json["watch"]["moved_since_frame"] = json!(report.moved_since);
    }
    if let Some((status, missed)) = &report.camera {
        outcome.json["camera"] = super::camera::json(status);
        outcome.json["camera"]["frames_not_taken"] = json!(missed);
        outcome.text += &format!("{missed} frames of the camera's grid were not taken (see the .csv)\n");
        outcome.text += &super::camera::text(status);
    }
    outcome
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Command {
        #[command(flatten)]
        args: Args,
    }

    /// Pixel size and interval of a recording of frames whose file states 0.1 s.
    fn scale(options: &str) -> [Option<f64>; 2] {
        let words = ["stream", "--with", "a", "--frames", "b"].into_iter().chain(options.split_whitespace());
        let PageScale { pixel_um, interval_s } = Command::parse_from(words).args.page_scale(Some(0.1));
        [pixel_um, interval_s]
    }

    #[test]
    fn the_time_between_pages_is_that_of_the_frames_that_are_reconstructed() {
        assert_eq!(scale(""), [None, Some(0.1)]);
        assert_eq!(scale("--fps 50 --every 3 --pixel-um 2.8"), [Some(2.8), Some(0.1 * 3.0)]);
        assert_eq!(scale("--interval-s 0.5 --every 2"), [None, Some(1.0)]);
        let live = ["stream", "--with", "a", "--live", "9", "--fps", "50", "--every", "2"];
        assert_eq!(Command::parse_from(live).args.page_scale(None).interval_s, Some(0.04));
        let unknown = ["stream", "--with", "a", "--live", "9"];
        assert_eq!(Command::parse_from(unknown).args.page_scale(None).interval_s, None);
    }
}
