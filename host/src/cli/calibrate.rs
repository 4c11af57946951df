//! `calibrate`: session -> instrument.

use super::common::{Outcome, Run};
use crate::artifact::Provenance;
use crate::bench::BenchConfig;
use crate::calibrate::{CalibrateConfig, Calibration, calibrate};
use crate::evaluate::measured;
use crate::instrument::{Instrument, LightUnit};
use crate::noise::{NoiseConfig, ROUNDING_DN2, Source};
use crate::report::bytes;
use crate::session::{Role, Session, Stack};
use serde_json::json;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Options of `calibrate`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: ommatidia calibrate session/ -o lab.instrument")]
pub struct Args {
    /// Folder of the measured session; or the configuration of a virtual instrument (.toml, as for `bench`), whose frames are made as
    /// they are asked for instead of filling a disk
    session: PathBuf,
    /// Instrument file to write
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Basis PSFs a lens (default: chosen by the error on positions that are left out)
    #[arg(long, value_name = "K")]
    rank: Option<usize>,
    /// Most basis PSFs that are tried
    #[arg(long, value_name = "K", default_value_t = CalibrateConfig::default().max_rank)]
    max_rank: usize,
    /// Side of the windows that hold one focus, pixels, odd (default: psf_window_px of the session, widened to hold the light)
    #[arg(long, value_name = "PX")]
    window: Option<usize>,
    /// One PSF a lens for the whole field, the mean of the bead scan, instead of the spatially varying model
    #[arg(long, conflicts_with_all = ["rank", "max_rank"])]
    one_psf: bool,
    /// Refits with a part of the beads left out, which tell how uncertain the PSFs are (0: none)
    #[arg(long, value_name = "N", default_value_t = CalibrateConfig::default().replicates)]
    replicates: usize,
    /// The bead frames were normalised by who measured them: one free scale a frame
    #[arg(long)]
    normalise_beads: bool,
    /// Nominal gain, DN per electron, where there are no flats
    #[arg(long, value_name = "DN/E", default_value_t = NoiseConfig::default().nominal_gain_dn_per_e)]
    gain: f64,
    /// Nominal read noise, electrons rms, where nothing shows it
    #[arg(long, value_name = "E", default_value_t = NoiseConfig::default().nominal_read_noise_e)]
    read_noise: f64,
}

/// Runs the verb.
///
/// # Errors
/// The session cannot be read or calibrated, or the instrument not be written.
pub fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    let session = open(&args.session, run.seed)?;
    let config = CalibrateConfig {
        rank: args.rank,
        max_rank: args.max_rank,
        window_px: args.window,
        one_psf: args.one_psf,
        replicates: args.replicates,
        normalise_beads: args.normalise_beads,
        noise: NoiseConfig { nominal_gain_dn_per_e: args.gain, nominal_read_noise_e: args.read_noise },
    };
    let bar = run.progress(steps(&session), "calibrate");
    let (calibration, seconds, peak_bytes) = measured(|| calibrate(&session, &config, || bar.inc(1)));
    let calibration = calibration?;
    bar.finish_and_clear();
    for note in &calibration.notes {
        tracing::warn!("{note}");
    }
    let inputs = if session.is_made() {
        vec![args.session.clone()]
    } else {
        std::iter::once(session.manifest_path()).chain(session.stacks().iter().map(Stack::path)).collect()
    };
    let provenance = Provenance::new("calibrate", run.seed, &config);
    let provenance = inputs.iter().try_fold(provenance, |p, input| p.with_input(input))?;
    calibration.instrument.write(&args.output, provenance)?;
    let mut json = figures(&calibration);
    (json["seconds"], json["peak_bytes"]) = (json!(seconds), json!(peak_bytes));
    let mut text = table(args, &calibration);
    // Writing to a string cannot fail.
    let _ = writeln!(text, "{:.0} s, {} at most", seconds, peak_bytes.map_or("memory unknown".into(), bytes));
    Ok(Outcome { json, text })
}

/// The session in a folder, or that of a virtual instrument.
fn open(path: &Path, seed: u64) -> anyhow::Result<Session> {
    if path.is_file() && path.extension().is_some_and(|e| e == "toml") {
        return Ok(Arc::new(BenchConfig::read(path)?.build(&[])?).live(path, seed));
    }
    Ok(Session::open(path)?)
}

/// Frames that are read, each pass counted.
fn steps(session: &Session) -> u64 {
    let frames = |role| session.stacks_of(role).map(|s| s.len() as u64).sum::<u64>();
    frames(Role::Dark) + frames(Role::Flat) + crate::bead::PASSES * frames(Role::Bead)
}

fn figures(calibration: &Calibration) -> serde_json::Value {
    let i = &calibration.instrument;
    let cols = i.manifest.array.cols.max(1);
    let anchors: Vec<Vec<[f64; 2]>> = i.geometry.anchors_px.chunks(cols).map(<[_]>::to_vec).collect();
    json!({
        "gain_dn_per_e": i.noise.gain_dn_per_e,
        "gain_sigma_dn_per_e": i.noise.gain_sigma,
        "read_noise_e": i.noise.read_noise_e,
        "read_noise_sigma_e": i.noise.read_noise_sigma,
        "black_level_dn": i.noise.black_level_dn,
        "noise_sources": i.noise.sources,
        "rank": rank(i),
        "window_px": i.manifest.optics.psf_window_px,
        "replicates": i.replicates.len(),
        "response_rms": response_rms(i),
        "pixel_read_noise_e": reading_e(i).map(|[median, p99, max]| json!({ "median": median, "p99": p99, "max": max })),
        "depths_um": i.psf.node_depths_um,
        "sensor_only": i.sensor_only(),
        "approximation_error": i.quality.approximation_error,
        "whole_array_rank": i.whole_array_rank(),
        "error_by_rank": by_rank(i),
        "off_grid_error": i.quality.off_grid_error,
        "one_psf_error": i.quality.one_psf_error,
        "noise_floor": i.quality.noise_floor,
        "anchors_px": anchors,
        "magnification": i.geometry.magnification,
        "chief_ray_rms_px": i.quality.chief_ray_rms_px,
        "dead_lenses": dead(i),
        "light_unit": i.light_unit,
        "notes": calibration.notes,
    })
}

/// Errors against the rank: on the scan, all lenses decomposed together, on positions left out.
fn by_rank(i: &Instrument) -> Vec<serde_json::Value> {
    let d = &i.diagnostics;
    let row = |(k, row): (usize, ndarray::ArrayView1<'_, f32>)| json!({ "rank": row[0], "scan": row[1], "whole_array": d.whole_array_error.get(k), "held_out": row[2] });
    d.error_by_rank.outer_iter().enumerate().map(row).collect()
}

fn rank(i: &Instrument) -> usize {
    i.psf.basis.dim().1
}

/// Spread of the responses of the pixels, rms; none: no map.
fn response_rms(i: &Instrument) -> Option<f64> {
    let map = i.response.as_ref()?;
    let square: f64 = map.iter().map(|r| (f64::from(*r) - 1.0).powi(2)).sum();
    Some((square / map.len().max(1) as f64).sqrt())
}

/// Read noise of single pixels, electrons rms: median, 99th percentile, largest; none: they are alike.
fn reading_e(i: &Instrument) -> Option<[f64; 3]> {
    let mut sorted: Vec<f32> = i.reading_dn2.as_ref()?.iter().copied().collect();
    sorted.sort_by(f32::total_cmp);
    let at = |q: f64| (f64::from(sorted[((sorted.len() - 1) as f64 * q) as usize]) - ROUNDING_DN2).max(0.0).sqrt();
    Some([0.5, 0.99, 1.0].map(|q| at(q) / i.noise.gain_dn_per_e))
}

fn dead(i: &Instrument) -> Vec<usize> {
    (0..i.geometry.dead.len()).filter(|l| i.geometry.dead[*l]).collect()
}

fn table(args: &Args, calibration: &Calibration) -> String {
    let i = &calibration.instrument;
    let (n, q) = (&i.noise, &i.quality);
    let source = |s: Source| match s {
        Source::Measured => "measured",
        Source::Inferred => "inferred",
        Source::Nominal => "nominal",
    };
    let mut out = String::new();
    let mut line = |name: &str, value: String, note: &str| {
        // Writing to a string cannot fail.
        let _ = writeln!(out, "{name:<22} {value:>22}   {note}");
    };
    line("black level", format!("{:.2} DN", n.black_level_dn), source(n.sources.black_level));
    line("gain", format!("{:.4} +- {:.4} DN/e-", n.gain_dn_per_e, n.gain_sigma), source(n.sources.gain));
    line("read noise", format!("{:.3} +- {:.3} e-", n.read_noise_e, n.read_noise_sigma), source(n.sources.read_noise));
    if let Some([median, p99, max]) = reading_e(i) {
        let spread = format!("median {median:.2}, p99 {p99:.2}, largest {max:.1} e-");
        line("read noise by pixel", spread, "from the darks");
    }
    if let Some(rms) = response_rms(i) {
        line("pixel response", format!("{:.3} % rms", 100.0 * rms), "divided out, noise taken back");
    }
    if i.sensor_only() {
        line("optics", "identity".into(), "no bead scan: only the sensor is modelled");
        let _ = writeln!(out, "-> {}", args.output.display());
        return out;
    }
    line("magnification", format!("{:.5}", i.geometry.magnification), "");
    line(
        "foci off chief rays",
        format!("{:.3} px rms", q.chief_ray_rms_px),
        "distortion and noise, kept in the windows",
    );
    let why = match (args.one_psf, args.rank) {
        (true, _) => "one PSF a lens",
        (_, Some(_)) => "as asked",
        _ => "least held-out error",
    };
    line("rank", rank(i).to_string(), why);
    if i.psf.node_depths_um.len() > 1 {
        let depths: Vec<String> = i.psf.node_depths_um.iter().map(ToString::to_string).collect();
        line("depths", depths.join(", "), "um");
    }
    line("window", format!("{} px", i.manifest.optics.psf_window_px), "holds a focus");
    line("approximation error", format!("{:.4}", q.approximation_error), "NRMSE on the bead scan");
    if let Some(whole) = i.whole_array_rank() {
        line("  rank, whole array", whole.to_string(), "of one decomposition of all lenses, for the same error");
    }
    line("off-grid error", format!("{:.4}", q.off_grid_error), "NRMSE on positions left out (checkerboard)");
    line("  of one PSF a lens", format!("{:.4}", q.one_psf_error), "the same positions");
    line("  of noise alone", format!("{:.4}", q.noise_floor), "in these bead frames");
    line("replicates", i.replicates.len().to_string(), "refits without a part of the beads: uncertainty of the PSFs");
    match i.light_unit {
        LightUnit::Dn => line("light unit", "DN".into(), "above black"),
        LightUnit::Bead => line("light unit", "bead".into(), "one bead in one object pixel"),
        LightUnit::Truth { per_bead } => {
            line("light unit", "truth".into(), &format!("{per_bead:.4} of it make a bead"))
        }
    }
    for (l, [row, col]) in i.geometry.anchors_px.iter().enumerate() {
        let note = if i.geometry.dead[l] { "dead" } else { "" };
        line(&format!("anchor of lens {l}"), format!("({row:.3}, {col:.3}) px"), note);
    }
    let _ = writeln!(out, "-> {}", args.output.display());
    out
}
