//! `predict`: expected frames for given objects.

use super::common::{Outcome, Run, warn};
use super::files::{Content, Files};
use anyhow::{Context, ensure};
use ndarray::ArrayView2;
use ommatidia_model::forward::{Depth, PredictError, PredictRequest, Predicted, Predictor};
use ommatidia_model::instrument::Instrument;
use ommatidia_model::slopes::Slopes;
use ommatidia_network::evaluate::{Measured, measured};
use ommatidia_network::methods::frame_range;
use ommatidia_physics::sensor::FrameRange;
use ommatidia_session::kind::FileKind;
use ommatidia_session::{FrameReader, FrameWriter, SampleType, StackSpec};
use serde_json::json;
use std::path::PathBuf;
use std::time::Instant;

/// Level and slopes of a background, e-.
#[derive(Clone, Copy, Debug)]
struct Plane(Slopes);

fn plane(text: &str) -> Result<Plane, String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|t| t.trim().parse::<f64>()).collect();
    match numbers.unwrap_or_default()[..] {
        [level] if level.is_finite() => Ok(Plane([level, 0.0, 0.0])),
        [level, rows, cols] if [level, rows, cols].iter().all(|v| v.is_finite()) => Ok(Plane([level, rows, cols])),
        _ => Err("expected LEVEL or LEVEL,ROWS,COLS, electrons a pixel, such as 8 or 8,4,-2".into()),
    }
}

/// Options of `predict`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: ommatidia predict lab.instrument objects.npy -o frames.npy")]
pub struct Args {
    /// Instrument file
    instrument: PathBuf,
    /// Objects, .npy or .tif, [n, object rows, object cols], in the light unit of the instrument
    objects: PathBuf,
    /// Frames to write, .npy or .tif, float32 [n, sensor rows, sensor cols], DN
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Add noise: whole DN, as the sensor would deliver (default: expected frames)
    #[arg(long)]
    noise: bool,
    /// Exposure, ms (default: that of the calibration)
    #[arg(long, value_name = "MS")]
    exposure_ms: Option<f64>,
    /// Light level, relative to the calibration
    #[arg(long, visible_alias = "light", value_name = "X", default_value_t = 1.0)]
    illumination: f64,
    /// Background to add, e- a pixel at the exposure of the calibration: LEVEL, or LEVEL,ROWS,COLS with its changes
    /// from the first to the last row and column
    #[arg(long, value_name = "E", value_parser = plane, allow_hyphen_values = true, default_value = "0")]
    background: Plane,
    /// Index of a calibrated depth, from 0 (default: the depth nearest to 0 um)
    #[arg(long, value_name = "I", conflicts_with = "z_um")]
    depth: Option<usize>,
    /// Depth of the objects, um, interpolated between calibrated depths (default: see --depth)
    #[arg(long, value_name = "UM", allow_negative_numbers = true)]
    z_um: Option<f64>,
    /// Apply the exact transpose of the optics instead, for your own solvers: from frames, DN above black, [n, sensor
    /// rows, sensor cols], to the object grid, without effects and pixel response
    #[arg(long, conflicts_with_all = ["noise", "exposure_ms", "illumination", "background"])]
    adjoint: bool,
}

impl Args {
    fn predicted(&self) -> Predicted {
        match (self.adjoint, self.noise) {
            (true, _) => Predicted::Adjoint,
            (_, true) => Predicted::Noisy,
            _ => Predicted::Expected,
        }
    }

    fn depth(&self) -> Depth {
        match (self.depth, self.z_um) {
            (Some(index), _) => Depth::Index(index),
            (_, Some(z_um)) => Depth::Um(z_um),
            _ => Depth::Focus,
        }
    }
}

impl Args {
    /// What the verb reads and writes.
    pub fn files(&self) -> Files {
        Files::reading([&self.instrument, &self.objects]).writing([&self.output], Content::File(FileKind::Stack))
    }
}

/// Runs the verb.
///
/// # Errors
/// A file cannot be read or written, or the objects do not have the shape of the instrument.
pub fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    let start = Instant::now();
    let instrument = Instrument::read(&args.instrument)?;
    let request = PredictRequest {
        output: args.predicted(),
        depth: args.depth(),
        exposure_ms: args.exposure_ms,
        illumination: args.illumination,
        background_e: args.background.0,
        seed: run.seed,
    };
    let pixel_um =
        if args.adjoint { instrument.manifest.object.pixel_um } else { instrument.manifest.sensor.pixel_pitch_um };
    let left_out =
        instrument.quality.background.filter(|b| b.is_seen() && !args.adjoint && request.background_e == [0.0; 3]);
    let predictor = Predictor::new(instrument, request).map_err(|e| match e {
        PredictError::Forward(e) => anyhow::Error::new(e).context(args.instrument.display().to_string()),
        e => e.into(),
    })?;
    let plan_seconds = start.elapsed().as_secs_f64();
    let mut inputs = FrameReader::open(&args.objects)?;
    let what = if args.adjoint { "frames" } else { "objects" };
    let [rows, cols] = predictor.input_shape();
    ensure!(
        [inputs.rows(), inputs.cols()] == [rows, cols],
        "{}: {what}: expected [n, {rows}, {cols}] (the grid of {}), found [{}, {}, {}]; resample them",
        args.objects.display(),
        args.instrument.display(),
        inputs.len(),
        inputs.rows(),
        inputs.cols()
    );
    let [rows, cols] = predictor.output_shape();
    let spec = StackSpec { frames: inputs.len(), rows, cols, samples: SampleType::F32, pixel_um: Some(pixel_um) };
    let mut outputs = FrameWriter::create(&args.output, spec)?.with_interval(inputs.scale().interval_s);
    let bar = run.progress(inputs.len() as u64, "predict");
    let (mut clipped_frames, mut clipped_px) = (0usize, 0usize);
    let range = frame_range(&args.instrument)?;
    let (mut odd, mut first) = (0, None);
    let mut all = || -> anyhow::Result<()> {
        for i in 0..inputs.len() {
            let input = inputs.read(i)?;
            if let Some(text) = oddity(args.adjoint, range, input.view()) {
                odd += 1;
                first.get_or_insert((i, text));
            }
            let at = || format!("{}: {what} {i}", args.objects.display());
            let output = predictor.apply(i, input.view()).with_context(at)?;
            let clipped = predictor.clipped_px(output.view());
            (clipped_frames, clipped_px) = (clipped_frames + usize::from(clipped > 0), clipped_px + clipped);
            outputs.push(output.view())?;
            bar.inc(1);
        }
        Ok(())
    };
    let Measured { result: done, seconds, peak_bytes } = measured(&mut all);
    done?;
    let seconds = seconds / inputs.len().max(1) as f64;
    outputs.finish()?;
    bar.finish_and_clear();
    let clipping = (clipped_px > 0).then(|| {
        let share = 100.0 * clipped_px as f64 / (clipped_frames * rows * cols) as f64;
        format!(
            "{clipped_frames} of {} frames clip at full scale, in {share:.2} % of their pixels: the objects are \
             brighter than this sensor can measure at this light; for a tenth of the light add --light {}",
            inputs.len(),
            0.1 * args.illumination
        )
    });
    let warning = first.map(|(i, text)| {
        let one = what.trim_end_matches('s');
        let others =
            if odd > 1 { format!(" ({} more of {} are odd, too)", odd - 1, inputs.len()) } else { String::new() };
        format!("{}: {one} {i}{others}: {text}", args.objects.display())
    });
    let background = left_out.map(|b| {
        let [level, row, col] = b.mean_e;
        format!(
            "the bead frames of this calibration had a background of {level:.2} e- a pixel, which is no part of the \
             instrument: the prediction leaves it out. Where your frames have it too, add \
             --background {level:.2},{row:.2},{col:.2}"
        )
    });
    let warnings = warn(clipping.into_iter().chain(warning).chain(background));
    let made = match args.predicted() {
        Predicted::Adjoint => "transposed",
        Predicted::Noisy => "with noise",
        Predicted::Expected => "expected values",
    };
    let text = format!(
        "{} {} of {rows} x {cols}, {made}, {:.1} ms each, after {} of planning\n-> {}\n",
        inputs.len(),
        if args.adjoint { "objects" } else { "frames" },
        1e3 * seconds,
        ommatidia_report::seconds(plan_seconds),
        args.output.display()
    );
    let json = json!({
        "frames": inputs.len(), "rows": rows, "cols": cols, "noise": args.noise, "adjoint": args.adjoint,
        "clipped_frames": clipped_frames, "clipped_px": clipped_px,
        "background_e": args.background.0,
        "seconds_per_frame": seconds, "plan_seconds": plan_seconds, "peak_bytes": peak_bytes, "warnings": warnings,
    });
    Ok(Outcome { json, text })
}

/// What is odd about an input: a frame that should be without black level, or an object.
fn oddity(adjoint: bool, range: Option<FrameRange>, input: ArrayView2<'_, f32>) -> Option<String> {
    if adjoint {
        let range = range.filter(|range| range.holds_black(input))?;
        return Some(format!(
            "its darkest pixels still hold the black level; subtract it ({:.1} DN): --adjoint takes light above black",
            range.black_level_dn
        ));
    }
    input.iter().all(|v| *v == 0.0).then(|| "it is dark everywhere".into())
}
