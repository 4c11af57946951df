//! `predict`: the frames that an instrument is expected to show for given objects.

use super::{Outcome, Run};
use crate::forward::Forward;
use crate::instrument::Instrument;
use crate::psf::OperatorConfig;
use crate::rng;
use crate::session::{FrameReader, FrameWriter, SampleType, StackSpec};
use anyhow::{Context, ensure};
use serde_json::json;
use std::path::PathBuf;
use std::time::Instant;

/// Options of `predict`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: ommatidia predict lab.instrument objects.npy -o frames.npy")]
pub struct Args {
    /// Instrument file
    instrument: PathBuf,
    /// Objects, .npy or .tif, [n, object rows, object cols], in the session's light unit
    objects: PathBuf,
    /// Frames to write, .npy or .tif, float32 [n, sensor rows, sensor cols], DN
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Draw the noise: whole DN, as the sensor would read
    #[arg(long)]
    noise: bool,
    /// Exposure, ms (default: that of the calibration)
    #[arg(long, value_name = "MS")]
    exposure_ms: Option<f64>,
    /// Light level relative to the calibration
    #[arg(long, value_name = "X", default_value_t = 1.0)]
    illumination: f64,
    /// Index of the calibrated depth (default: the one nearest to 0 um)
    #[arg(long, value_name = "I", conflicts_with = "z_um")]
    depth: Option<usize>,
    /// Depth of the objects, um, interpolated between the calibrated ones
    #[arg(long, value_name = "UM", allow_negative_numbers = true)]
    z_um: Option<f64>,
}

/// Runs the verb.
///
/// # Errors
/// A file cannot be read or written, or the objects do not fit the instrument.
pub fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    let mut instrument = Instrument::read(&args.instrument)?;
    if let Some(z_um) = args.z_um {
        let depths = &instrument.psf.node_depths_um;
        let ends = depths.first().zip(depths.last());
        ensure!(
            ends.is_some_and(|(low, high)| (*low..=*high).contains(&z_um)),
            "--z-um: expected a depth within those calibrated, {depths:?} um, found {z_um}"
        );
        instrument.psf = instrument.psf.at_depth(z_um);
    }
    let depth = args.depth.unwrap_or_else(|| instrument.psf.depth_nearest(0.0));
    let config = OperatorConfig { depth, ..OperatorConfig::default() };
    let forward = Forward::with_config(&instrument, config).with_context(|| args.instrument.display().to_string())?;
    let mut objects = FrameReader::open(&args.objects)?;
    let [rows, cols] = forward.operator().object_shape();
    ensure!(
        [objects.rows(), objects.cols()] == [rows, cols],
        "{}: objects: expected [n, {rows}, {cols}] (the object grid of {}), found [{}, {}, {}]; resample them",
        args.objects.display(),
        args.instrument.display(),
        objects.len(),
        objects.rows(),
        objects.cols()
    );
    let mut cx = forward.context();
    cx.exposure_ms = args.exposure_ms.unwrap_or(cx.exposure_ms);
    cx.illumination = args.illumination;
    for (field, value) in [("--exposure-ms", cx.exposure_ms), ("--illumination", cx.illumination)] {
        ensure!(value.is_finite() && value >= 0.0, "{field}: expected a finite value, zero or more, found {value}");
    }
    let [rows, cols] = forward.operator().sensor_shape();
    let spec = StackSpec { frames: objects.len(), rows, cols, samples: SampleType::F32, pixel_um: None };
    let mut frames = FrameWriter::create(&args.output, spec)?;
    let bar = run.progress(objects.len() as u64, "predict");
    let begin = Instant::now();
    for i in 0..objects.len() {
        let object = objects.read(i)?;
        cx.frame = i;
        let at = || format!("{}: object {i}", args.objects.display());
        let frame = if args.noise {
            let light = forward.expected_e(object.view(), &cx).with_context(at)?;
            forward.draw_dn(light, &cx, &mut rng::stream(run.seed, "predict", i as u64))
        } else {
            forward.expected_dn(object.view(), &cx).with_context(at)?
        };
        frames.push(frame.view())?;
        bar.inc(1);
    }
    let seconds = begin.elapsed().as_secs_f64() / objects.len().max(1) as f64;
    frames.finish()?;
    bar.finish_and_clear();
    let text = format!(
        "{} frames of {rows} x {cols}, {}, {:.1} ms each\n-> {}\n",
        objects.len(),
        if args.noise { "noise drawn" } else { "expected values" },
        1e3 * seconds,
        args.output.display()
    );
    let json = json!({ "frames": objects.len(), "rows": rows, "cols": cols, "noise": args.noise, "seconds_per_frame": seconds });
    Ok(Outcome { json, text })
}
