//! `calibrate`: session -> instrument.

use super::common::{Outcome, Run, any_session, yes_or_no};
use super::files::{Content, Files};
use ommatidia_model::calibrate::{
    CalibrateConfig, Calibration, PixelReadNoise, calibrate, frames_read, provenance, response_rms,
};
use ommatidia_model::instrument::LightUnit;
use ommatidia_network::evaluate::{Measured, measured};
use ommatidia_physics::noise::{NoiseConfig, Source};
use ommatidia_report::bytes;
use ommatidia_session::{with_error, with_error_signed};
use serde_json::json;
use std::fmt::Write;
use std::path::PathBuf;

/// Options of `calibrate`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: ommatidia calibrate session/ -o lab.instrument")]
pub struct Args {
    /// Folder of the measured session, or configuration of a virtual instrument (.toml, as for `bench`), whose frames
    /// are computed when they are read instead of filling a disk
    session: PathBuf,
    /// Instrument file to write
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Number of basis PSFs per lens (default: chosen by the error on held-out positions)
    #[arg(long, value_name = "K", conflicts_with = "max_rank")]
    rank: Option<usize>,
    /// Maximum number of basis PSFs per lens that the search tries
    #[arg(long, value_name = "K", default_value_t = CalibrateConfig::default().max_rank)]
    max_rank: usize,
    /// Side of the window round each focus, pixels, odd (default: psf_window_px of the session, widened to hold the
    /// light)
    #[arg(long, value_name = "PX")]
    window: Option<usize>,
    /// Use one PSF per lens for the whole field, the mean over the bead scan, instead of the spatially varying model
    #[arg(long, conflicts_with_all = ["rank", "max_rank"])]
    one_psf: bool,
    /// Number of jackknife refits (each leaves out a group of beads) that estimate the uncertainty of the PSF model. 0
    /// disables them
    #[arg(long, value_name = "N", default_value_t = CalibrateConfig::default().replicates)]
    replicates: usize,
    /// Bring every bead frame to the same total light (yes), for frames that are already normalised, or keep its
    /// brightness (no) [default: decided from the data]
    #[arg(long, value_name = "YES|NO", num_args = 0..=1, require_equals = true, default_missing_value = "yes",
        value_parser = yes_or_no)]
    normalise_beads: Option<bool>,
    /// Calibrate even where the checks of the session find errors; they are printed as warnings
    #[arg(long)]
    accept: bool,
    /// Gain, DN per electron, that is used if no flats determine it [default: estimated from a video of a specimen that
    /// keeps nearly still, else 1]
    #[arg(long, value_name = "DN/E", allow_negative_numbers = true)]
    gain: Option<f64>,
    /// Read noise, electrons rms, that is used if neither darks nor flats determine it [default: estimated from bead
    /// frames or a video, else 2]
    #[arg(long, value_name = "E", allow_negative_numbers = true)]
    read_noise: Option<f64>,
}

impl Args {
    /// What the verb reads and writes.
    pub fn files(&self) -> Files {
        Files::reading([&self.session]).writing([&self.output], Content::artifact("instrument"))
    }
}

/// Runs the verb.
///
/// # Errors
/// The session cannot be read or calibrated, or the instrument cannot be written.
pub fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    let session = any_session(&args.session, run.seed)?;
    let config = CalibrateConfig {
        rank: args.rank,
        max_rank: args.max_rank,
        window_px: args.window,
        one_psf: args.one_psf,
        replicates: args.replicates,
        normalise_beads: args.normalise_beads,
        accept: args.accept,
        noise: NoiseConfig { nominal_gain_dn_per_e: args.gain, nominal_read_noise_e: args.read_noise },
    };
    let bar = run.progress(frames_read(&session), "calibrate");
    let Measured { result: calibration, seconds, peak_bytes } = measured(|| {
        calibrate(&session, &config, || {
            // How often beads are read is known at the end: a background and unequal beads need another pass.
            if bar.length() == Some(bar.position()) {
                bar.inc_length(1);
            }
            bar.inc(1);
        })
        // Its file holds them then, and what needs them does not fit them again.
        .inspect(|calibration| calibration.instrument.fit_pupils())
    });
    let calibration = calibration?;
    bar.finish_and_clear();
    for note in &calibration.notes {
        tracing::warn!("{note}");
    }
    let provenance = provenance(&session, &config, run.seed)?;
    calibration.instrument.write(&args.output, provenance)?;
    let mut json = calibration.figures();
    (json["seconds"], json["peak_bytes"]) = (json!(seconds), json!(peak_bytes));
    let mut text = table(args, &calibration);
    // Writing to a string cannot fail.
    let _ = writeln!(text, "{:.0} s, at most {}", seconds, peak_bytes.map_or("unknown memory".into(), bytes));
    Ok(Outcome { json, text })
}

fn table(args: &Args, calibration: &Calibration) -> String {
    let i = &calibration.instrument;
    let (n, q) = (&i.noise, &i.quality);
    let source = |s: Source, given: Option<f64>| match s {
        Source::Measured => "measured",
        Source::Inferred => "inferred",
        Source::Nominal if given.is_some() => "given",
        Source::Nominal => "nominal",
    };
    let mut out = String::new();
    let mut line = |name: &str, value: String, note: &str| {
        // Writing to a string cannot fail.
        let _ = writeln!(out, "{name:<22} {value:>22}   {note}");
    };
    line("black level", format!("{:.2} DN", n.black_level_dn), source(n.sources.black_level, None));
    // The error of a nominal value is unknown, not 0.
    let figure = |(value, sigma): (f64, f64), least: usize, of: Source| match of {
        Source::Nominal => format!("{value:.least$}"),
        Source::Measured | Source::Inferred => with_error(value, sigma, least),
    };
    let gain = figure((n.gain_dn_per_e, n.gain_sigma), 4, n.sources.gain);
    line("gain", format!("{gain} DN/e-"), source(n.sources.gain, args.gain));
    let read_noise = figure((n.read_noise_e, n.read_noise_sigma), 3, n.sources.read_noise);
    line("read noise", format!("{read_noise} e-"), source(n.sources.read_noise, args.read_noise));
    if let Some(PixelReadNoise { median_e, p99_e, max_e }) = PixelReadNoise::of(i) {
        let spread = format!("median {median_e:.2}, p99 {p99_e:.2}, largest {max_e:.1} e-");
        line("read noise by pixel", spread, "from the darks");
    }
    if let Some(bend) = calibration.bend {
        line(
            "response at full scale",
            format!("{} %", with_error_signed(-100.0 * bend.beta, 100.0 * bend.sigma, 2)),
            "off a straight line, by means and noise of the flats; part of the instrument",
        );
    }
    if let Some(rms) = response_rms(i) {
        line("pixel response", format!("{:.3} % rms", 100.0 * rms), "standard deviation over the pixels");
    }
    if i.sensor_only() {
        line("optics", "identity".into(), "no bead scan: only the sensor is modelled");
        let _ = writeln!(out, "-> {}", args.output.display());
        return out;
    }
    line("magnification", format!("{:.5}", i.geometry.magnification), "");
    line("foci off chief rays", format!("{:.3} px rms", q.chief_ray_rms_px), "distortion and noise, part of the PSFs");
    match q.background {
        Some(b) => {
            let note = if b.is_seen() { "of the bead frames, removed" } else { "none that is significant" };
            line("background", format!("{} e-", with_error(b.mean_e[0], b.sigma_e[0], 3)), note);
            let slope = |a: usize| format!("{} e-", with_error_signed(b.mean_e[a], b.sigma_e[a], 3));
            if b.is_seen() {
                line("  along the rows", slope(1), "from the first to the last row");
                line("  along the columns", slope(2), "from the first to the last column");
            }
        }
        None => line("background", "not measured".into(), "too few pixels lie far from all foci"),
    }
    let decided = if args.normalise_beads.is_some() { "as asked" } else { "decided from the data" };
    let kept = if calibration.beads_normalised { "normalised frame by frame" } else { "as measured" };
    line("brightness of beads", kept.into(), decided);
    let why = match (args.one_psf, args.rank) {
        (true, _) => "one PSF per lens",
        (_, Some(_)) => "as asked",
        _ => "smallest held-out error",
    };
    line("rank", i.rank().to_string(), why);
    if i.psf.node_depths_um.len() > 1 {
        let depths: Vec<String> = i.psf.node_depths_um.iter().map(ToString::to_string).collect();
        line("depths", depths.join(", "), "um");
    }
    line("window", format!("{} px", i.manifest.optics.psf_window_px), "side of the window round a focus");
    line("approximation error", format!("{:.4}", q.approximation_error), "NRMSE on the bead scan");
    if let Some(whole) = i.whole_array_rank() {
        line("  rank, whole array", whole.to_string(), "of one decomposition of all lenses with the same error");
    }
    line("off-grid error", format!("{:.4}", q.off_grid_error), "NRMSE on held-out positions (checkerboard)");
    line("  of one PSF per lens", format!("{:.4}", q.one_psf_error), "the same positions");
    line("  of noise alone", format!("{:.4}", q.noise_floor), "in the bead frames");
    if !i.replicates.is_empty() {
        line("error of bead frames", format!("{:.4}", q.frame_error), "NRMSE on held-out frames, noise deducted");
    }
    if let Some(pupils) = i.pupil_model().map(|p| p.summary()) {
        let error = format!("{:.1} % off", 100.0 * pupils.misfit);
        line("pupils", error, "round ones with Zernike terms; they predict other depths from this one plane");
        line("  cut-off", format!("{:.3} cycles/px", pupils.cutoff_cycles_per_px), "of the amplitude");
        let terms = [
            ("defocus", pupils.defocus_waves),
            ("astigmatism", pupils.astigmatism_waves),
            ("coma", pupils.coma_waves),
            ("spherical", pupils.spherical_waves),
        ];
        for (name, waves) in terms {
            line(&format!("  {name}"), format!("{waves:.3} waves rms"), "mean square over the field and the lenses");
        }
    } else if !i.sensor_only() && i.psf.node_depths_um.len() == 1 {
        line(
            "pupils",
            "none".into(),
            "no round pupil explains the PSFs; other depths need beads at two depths or more",
        );
    }
    line("replicates", i.replicates.len().to_string(), "jackknife refits for the uncertainty of the PSFs");
    match i.light_unit {
        LightUnit::Dn => line("light unit", "DN".into(), "above black"),
        LightUnit::Bead => line("light unit", "bead".into(), "one bead in one object pixel"),
        LightUnit::Truth { per_bead } => {
            line("light unit", "truth".into(), &format!("one bead is {per_bead:.4} units"))
        }
    }
    for (l, [row, col]) in i.geometry.anchors_px.iter().enumerate() {
        let note = if i.geometry.dead[l] { "dead" } else { "" };
        line(&format!("anchor of lens {l}"), format!("({row:.3}, {col:.3}) px"), note);
    }
    let _ = writeln!(out, "-> {}", args.output.display());
    out
}
