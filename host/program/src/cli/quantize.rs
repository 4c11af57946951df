//! `quantize`: checkpoint -> network file of a device.

use super::files::{Content, Files};
use super::{Outcome, Run};
use anyhow::Context;
use ommatidia_model::instrument::Instrument;
use ommatidia_network::quantize::{Numbers, QuantizeConfig, QuantizeReport, quantize};
use ommatidia_network::train::Checkpoint;
use ommatidia_network::watch::{WatchFigures, WatchMaps};
use ommatidia_session::artifact::{file_hash, write_whole};
use ommatidia_session::kind::FileKind;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Options of `quantize`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Checkpoint
    checkpoint: PathBuf,
    /// Network file to write
    #[arg(short, long, value_name = "BLOB")]
    output: PathBuf,
    /// Name to store in the network file [default: the checkpoint's file name]
    #[arg(long)]
    name: Option<String>,
    /// Maximum length of the network file, bytes
    #[arg(long, value_name = "BYTES")]
    flash: Option<u64>,
    /// Maximum memory of the device while it runs the network, bytes, its program included
    #[arg(long, value_name = "BYTES")]
    ram: Option<u64>,
    /// Keep the strongest blocks of the filters' kernels, as many as fit into this fraction of the dense filters'
    /// bytes; the device transforms them [default: the blocks or taps of the training, or else all; pruned to fit into
    /// --flash]
    #[arg(long, value_name = "PART", conflicts_with = "tile", value_parser = super::common::part)]
    prune: Option<f64>,
    /// Side of small transforms, pixels: the filters are cut into taps [default: the taps of the training, or else one
    /// transform of the whole frame]
    #[arg(long, value_name = "T")]
    tile: Option<usize>,
    /// Fraction of the filters' energy that the taps must keep [default: 0.95]
    #[arg(long, value_name = "PART", requires = "tile")]
    energy: Option<f64>,
    /// Weights of the enhancement network's convolutions
    #[arg(long, value_enum, default_value_t = Weights::F16)]
    weights: Weights,
    /// Features of the enhancement network [default: f16 for weights f16, int16 for weights int8]
    #[arg(long, value_enum)]
    activations: Option<Activations>,
    /// Let the device watch its optics: add maps, made for this instrument, with which it notices in raw frames of any
    /// specimen that a lens has moved or dimmed
    #[arg(long, value_name = "INSTRUMENT")]
    watch: Option<PathBuf>,
}

/// Number formats of weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Weights {
    /// IEEE half precision
    F16,
    /// 8 bits, with a scale for each output channel
    Int8,
}

/// Number formats of features.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Activations {
    /// IEEE half precision
    F16,
    /// 16 bits
    Int16,
    /// 8 bits, with a scale for each channel: half the memory, at some loss of quality
    Int8,
}

impl Args {
    fn numbers(&self) -> anyhow::Result<Numbers> {
        match (self.weights, self.activations) {
            (Weights::F16, None | Some(Activations::F16)) => Ok(Numbers::Halves),
            (Weights::Int8, None | Some(Activations::Int16)) => Ok(Numbers::Integers),
            (Weights::Int8, Some(Activations::Int8)) => Ok(Numbers::Bytes),
            (Weights::F16, Some(Activations::Int16 | Activations::Int8)) => {
                anyhow::bail!("--activations int16 and int8 need --weights int8; add it, or leave --activations out")
            }
            (Weights::Int8, Some(Activations::F16)) => {
                anyhow::bail!("--weights int8 needs --activations int16 or int8; change it, or leave --activations out")
            }
        }
    }
}

impl Args {
    /// What the verb reads and writes.
    pub fn files(&self) -> Files {
        Files::reading([&self.checkpoint])
            .and_reading(&self.watch)
            .writing([&self.output], Content::File(FileKind::Blob))
    }
}

/// Runs the verb.
///
/// # Errors
/// The checkpoint cannot be read, a weight is not finite, the network does not fit into the budget, or the file cannot
/// be written. Nothing is written then.
pub fn run(args: &Args, _run: &Run) -> anyhow::Result<Outcome> {
    let numbers = args.numbers()?;
    let checkpoint = Checkpoint::read(&args.checkpoint)?;
    let stem = args.checkpoint.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    let config = QuantizeConfig {
        name: args.name.clone().unwrap_or(stem),
        flash_bytes: args.flash,
        ram_bytes: args.ram,
        tile: args.tile,
        energy: args.energy,
        prune: args.prune,
        numbers,
        watch: args.watch.as_deref().map(watch).transpose()?,
    };
    let made = quantize(&checkpoint, &file_hash(&args.checkpoint)?, &config)?;
    write_whole(&args.output, &made.bytes)?;
    let mut json = serde_json::to_value(&made.report)?;
    json["blob"] = serde_json::to_value(&args.output)?;
    Ok(Outcome { json, text: text(&args.output, &made.report) })
}

/// Seed of the specimens that maps are judged on.
const WATCH_SEED: u64 = 1;

fn watch(path: &Path) -> anyhow::Result<WatchMaps> {
    let instrument = Instrument::read(path)?;
    WatchMaps::of(&instrument, WATCH_SEED).with_context(|| path.display().to_string())
}

fn text(path: &Path, r: &QuantizeReport) -> String {
    let filters = match r.blocks {
        0 => format!("{} taps of {} x {}", r.taps, r.tile, r.tile),
        blocks => format!("{blocks} blocks of {} x {} lags", r.block_side, r.block_side),
    };
    let model = match r.passes {
        1 => String::new(),
        passes => format!(" of {passes} passes, prediction of frames {}", r.predictor_bytes),
    };
    let mut text = format!(
        "{}\n  {} bytes: filters {} ({filters}, {:.1} % of dense ones), enhancement {}{model}\n  memory: {} bytes: {} \
         fast, {} bulk, {} frame, {} reconstruction, at most {} variables and stack\n  energy of the filters kept: \
         {:.4}\n",
        path.display(),
        r.file_bytes,
        r.filter_bytes,
        100.0 * r.filter_bytes as f64 / r.dense_filter_bytes as f64,
        r.rcan_bytes,
        r.ram_bytes,
        r.fast_bytes,
        r.bulk_bytes,
        r.frame_bytes,
        r.object_bytes,
        r.program_bytes,
        r.energy_kept,
    );
    for step in &r.steps {
        let _ = writeln!(text, "  {:>6}: {:.2} dB, SSIM {:.4}", step.step, step.quality.psnr_db, step.quality.ssim);
    }
    let _ = writeln!(text, "  loss by quantization: {:.3} dB over {} held-out frames", r.loss_db, r.frames);
    if let Some(loss) = r.loss_to_halves_db {
        let _ = writeln!(text, "  loss of integers against half precision: {loss:.3} dB");
    }
    if let Some(WatchFigures { bytes, shifts_px, gains, .. }) = &r.watch {
        let _ = writeln!(
            text,
            "  watch on the optics: {bytes} bytes; noise of a frame {:.3} px and {:.2} %, another specimen {:.3} px \
             and {:.2} %",
            shifts_px.noise,
            100.0 * gains.noise,
            shifts_px.specimens,
            100.0 * gains.specimens,
        );
    }
    text
}
