//! `predict`: the frames that an instrument is expected to show for given objects.

use super::common::{Outcome, Run};
use crate::evaluate::measured;
use crate::forward::Forward;
use crate::instrument::Instrument;
use crate::psf::OperatorConfig;
use crate::rng;
use crate::session::{FrameReader, FrameWriter, SampleType, StackSpec};
use anyhow::{Context, ensure};
use serde_json::json;
use std::path::PathBuf;

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
    /// The other way, for solvers of your own: frames, DN above black, [n, sensor rows, sensor cols], back to the object grid by the exact
    /// transpose of the optics (no effects, no response of pixels)
    #[arg(long, conflicts_with_all = ["noise", "exposure_ms", "illumination"])]
    adjoint: bool,
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
    let mut inputs = FrameReader::open(&args.objects)?;
    let (object, sensor) = (forward.operator().object_shape(), forward.operator().sensor_shape());
    let (what, [rows, cols], to) = if args.adjoint { ("frames", sensor, object) } else { ("objects", object, sensor) };
    ensure!(
        [inputs.rows(), inputs.cols()] == [rows, cols],
        "{}: {what}: expected [n, {rows}, {cols}] (the grid of {}), found [{}, {}, {}]; resample them",
        args.objects.display(),
        args.instrument.display(),
        inputs.len(),
        inputs.rows(),
        inputs.cols()
    );
    let mut cx = forward.context();
    cx.exposure_ms = args.exposure_ms.unwrap_or(cx.exposure_ms);
    cx.illumination = args.illumination;
    for (field, value) in [("--exposure-ms", cx.exposure_ms), ("--illumination", cx.illumination)] {
        ensure!(value.is_finite() && value >= 0.0, "{field}: expected a finite value, zero or more, found {value}");
    }
    let [rows, cols] = to;
    let spec = StackSpec { frames: inputs.len(), rows, cols, samples: SampleType::F32, pixel_um: None };
    let mut outputs = FrameWriter::create(&args.output, spec)?;
    let bar = run.progress(inputs.len() as u64, "predict");
    let mut all = || -> anyhow::Result<()> {
        for i in 0..inputs.len() {
            let input = inputs.read(i)?;
            cx.frame = i;
            let at = || format!("{}: {what} {i}", args.objects.display());
            let output = if args.adjoint {
                forward.operator().adjoint(input.view()).with_context(at)?
            } else if args.noise {
                let light = forward.expected_e(input.view(), &cx).with_context(at)?;
                forward.draw_dn(light, &cx, &mut rng::stream(run.seed, "predict", i as u64))
            } else {
                forward.expected_dn(input.view(), &cx).with_context(at)?
            };
            outputs.push(output.view())?;
            bar.inc(1);
        }
        Ok(())
    };
    let (done, seconds, peak_bytes) = measured(&mut all);
    done?;
    let seconds = seconds / inputs.len().max(1) as f64;
    outputs.finish()?;
    bar.finish_and_clear();
    let made = match (args.adjoint, args.noise) {
        (true, _) => "transposed",
        (_, true) => "noise drawn",
        _ => "expected values",
    };
    let text = format!(
        "{} {} of {rows} x {cols}, {made}, {:.1} ms each\n-> {}\n",
        inputs.len(),
        if args.adjoint { "objects" } else { "frames" },
        1e3 * seconds,
        args.output.display()
    );
    let json = json!({
        "frames": inputs.len(), "rows": rows, "cols": cols, "noise": args.noise, "adjoint": args.adjoint,
        "seconds_per_frame": seconds, "peak_bytes": peak_bytes,
    });
    Ok(Outcome { json, text })
}
