//! `train`: data set or instrument -> checkpoint.

use super::common::in_json;
use super::files::{Content, Files};
use super::{Outcome, Run};
use anyhow::Context;
use ommatidia_model::dataset::{DataSet, PLAN_FILE};
use ommatidia_model::instrument::Instrument;
use ommatidia_network::quantize::{ChosenMask, MaskSource, QuantizeConfig, training_mask, training_steps};
use ommatidia_network::train::{
    ArchitectureName, Backend, Body, Checkpoint, Lenses, Loss, Next, PairSource, Preset, Simulated, Start, Task,
    TrainConfig, TrainRequest, Trainer, weights,
};
use ommatidia_physics::effects::EffectSetting;
use ommatidia_physics::noise::NoiseModel;
use ommatidia_physics::sensor::SensorMaps;
use ommatidia_session::artifact::{Provenance, file_hash, write_whole};
use ommatidia_session::kind::FileKind;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Options of `train`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Data set (folder), or instrument (file) for which pairs are simulated as they are needed
    #[arg(value_name = "DATASET|INSTRUMENT")]
    input: PathBuf,
    /// Checkpoint to write; replaced after each validation
    #[arg(short, long, value_name = "CHECKPOINT")]
    output: PathBuf,
    /// Size of the network and its schedule
    #[arg(long, value_enum, default_value_t)]
    preset: Preset,
    /// Network to train: SV-FourierNet, or another one to compare it with; the others need the instrument
    #[arg(long, value_enum, default_value_t)]
    network: ArchitectureName,
    /// Number of filters (of PSFs for multiwienernet) [default: the preset's]
    #[arg(long, value_name = "N")]
    filters: Option<usize>,
    /// Number of passes: each after the first predicts the frame of the reconstruction so far with the calibrated PSFs,
    /// and corrects what differs from the frame. More than one pass needs the instrument [default: the preset's]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=8))]
    passes: Option<u8>,
    /// Number of accelerated Richardson-Lucy iterations with the calibrated PSFs ahead of the first pass, which then
    /// corrects what they find. More than 0 needs the instrument [default: the preset's]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(0..=100))]
    richardson_lucy: Option<u8>,
    /// Number of steps of the optimiser [default: the preset's]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    steps: Option<u64>,
    /// Time to train, minutes. The number of steps follows from the time of the first few, so the result depends on the
    /// machine
    #[arg(long, value_name = "M", conflicts_with_all = ["steps", "resume"])]
    minutes: Option<f64>,
    /// Number of pairs in a step [default: the preset's]
    #[arg(long, value_name = "N")]
    batch: Option<usize>,
    /// Highest learning rate of the convolutions [default: the preset's]
    #[arg(long, value_name = "RATE")]
    learning_rate: Option<f64>,
    /// Highest learning rate of the filters [default: the preset's]
    #[arg(long, value_name = "RATE")]
    filter_learning_rate: Option<f64>,
    /// Filters before the first step [default: the preset's; psf for multiwienernet and multiflatnet]
    #[arg(long, value_enum)]
    start: Option<Start>,
    /// What training makes small [default: the preset's]
    #[arg(long, value_enum)]
    loss: Option<Loss>,
    /// Number of validations without better weights after which the run ends early [default: never].
    /// Weights are better with a lower held-out loss, or with a higher SSIM for --loss bce-mse
    #[arg(long, value_name = "N")]
    patience: Option<u64>,
    /// With a data set: instrument whose sensor maps correct the frames, and whose PSFs networks can start from
    #[arg(long, value_name = "FILE")]
    instrument: Option<PathBuf>,
    /// Start from the best weights of a checkpoint, with a third of the preset's learning rates
    #[arg(long, value_name = "CHECKPOINT", conflicts_with_all = ["start", "minutes"])]
    from: Option<PathBuf>,
    /// Prune the filters and train them pruned, so that `quantize` loses almost nothing: keep the strongest blocks of
    /// their kernels, as many as fit into this fraction of the dense filters' bytes. Blocks are chosen in the filters
    /// of --from, or else in the pseudo-inverses of the instrument's PSFs
    #[arg(long, value_name = "PART", conflicts_with = "tile", value_parser = super::common::part)]
    prune: Option<f64>,
    /// Train the filters as taps of small transforms of this side, pixels, for a device; taps are chosen as with
    /// --prune
    #[arg(long, value_name = "T")]
    tile: Option<usize>,
    /// Fraction of the filters' energy that the taps must keep
    #[arg(long, value_name = "PART", requires = "tile", default_value_t = 0.9)]
    energy: f64,
    /// Fine-tune the network of --from with weights and features rounded as `quantize --weights int8 --activations
    /// int8` rounds them. The steps of the features are measured before the first step of the training, and kept
    #[arg(long, value_enum, requires = "from")]
    quantize: Option<Rounded>,
    /// Where to compute the network. The optimiser and the simulation of noise always run on the CPU
    #[arg(long, value_enum, default_value_t)]
    device: Backend,
    /// Effect that half of the pairs have, with a strength drawn up to this one, so that the network loses less when
    /// the instrument has changed since its calibration; only with an instrument (may be given again)
    #[arg(long, value_name = "ID=STRENGTH[,NAME=VALUE..]")]
    vary: Vec<EffectSetting>,
    /// HTML page with curves and sample pictures, replaced with each checkpoint, to watch the training in a browser
    #[arg(long, value_name = "HTML")]
    page: Option<PathBuf>,
    /// Resume the run that wrote the checkpoint; the result has the same bits as that of an uninterrupted run
    #[arg(long)]
    resume: bool,
}

/// Numbers that a network is trained to bear.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Rounded {
    /// Weights and features of 8 bits
    Int8,
}

/// Pairs and instrument of a training run.
struct Inputs<'a> {
    source: &'a dyn PairSource,
    noise: NoiseModel,
    frame: [usize; 2],
    object: [usize; 2],
    /// Range of the brightest pixel of a frame, electrons.
    peak_e: [f64; 2],
    maps: SensorMaps,
    lenses: Option<&'a Lenses>,
    /// Name of the input in the provenance, and the file that stands for it.
    role: &'static str,
    file: &'a Path,
}

impl Args {
    /// What the verb reads and writes.
    pub fn files(&self) -> Files {
        let reads = Files::reading([&self.input]).and_reading(&self.instrument).and_reading(&self.from);
        let reads =
            reads.after_stop("the same command with --resume goes on from the last checkpoint, if there is one");
        let (checkpoint, page) = (Content::artifact("checkpoint"), Content::File(FileKind::Page));
        if self.resume {
            return reads.continuing([&self.output], checkpoint).continuing(&self.page, page);
        }
        let reads = reads.hint(", or continue the training with --resume");
        reads.writing([&self.output], checkpoint).writing(&self.page, page)
    }
}

/// Runs the verb.
///
/// # Errors
/// An input cannot be read or does not fit, an option is out of its range, the loss diverges, or the checkpoint cannot
/// be written. The last checkpoint stays on disk then.
pub fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    if args.input.is_dir() {
        anyhow::ensure!(args.vary.is_empty(), "--vary: a data set has its own effects; give it to `simulate`");
        let set = DataSet::open(&args.input)?;
        let plan = set.plan();
        let instrument = args.instrument.as_deref().map(|path| instrument_of(path, plan.frame)).transpose()?;
        let maps = instrument.as_ref().map(Instrument::sensor_maps).transpose()?.unwrap_or_default();
        let lenses = instrument.as_ref().map(Lenses::of).transpose()?;
        let (frame, object, noise, peak_e) = (plan.frame, plan.object, plan.noise, plan.peak_e);
        let (source, lenses, file) = (&set, lenses.as_ref(), args.input.join(PLAN_FILE));
        let inputs = Inputs { source, noise, frame, object, peak_e, maps, lenses, role: "dataset", file: &file };
        return train(args, run, inputs);
    }
    let instrument = Instrument::read(&args.input)?;
    let source = Simulated::of(&instrument, &args.input, run.seed, &args.vary)?;
    let plan = source.plan();
    let (frame, object, noise, peak_e) = (plan.frame, plan.object, plan.noise, plan.peak_e);
    let (maps, lenses) = (instrument.sensor_maps()?, Lenses::of(&instrument)?);
    let (lenses, file) = (Some(&lenses), args.input.as_path());
    let inputs = Inputs { source: &source, noise, frame, object, peak_e, maps, lenses, role: "instrument", file };
    train(args, run, inputs)
}

/// The instrument at `path`, which must have frames of the data set's size.
fn instrument_of(path: &Path, frame: [usize; 2]) -> anyhow::Result<Instrument> {
    let instrument = Instrument::read(path)?;
    let sensor = [instrument.manifest.sensor.rows, instrument.manifest.sensor.cols];
    let (path, [rows, cols]) = (path.display(), frame);
    anyhow::ensure!(
        sensor == frame,
        "{path}: sensor: expected {rows} x {cols} (frames of the data set), found {} x {}",
        sensor[0],
        sensor[1]
    );
    Ok(instrument)
}

fn train(args: &Args, run: &Run, inputs: Inputs<'_>) -> anyhow::Result<Outcome> {
    let Inputs { source, noise, frame, object, peak_e, maps, lenses, role, file } = inputs;
    let request = request(args, run)?;
    let network = request.network(frame, object, lenses)?;
    let training = request.training(&network, noise.full_scale_e(), peak_e);
    let mut training = TrainConfig { vary: args.vary.clone(), ..training };
    let task = Task { source, network, noise, maps };
    args.device.check()?;
    if let Some(minutes) = args.minutes {
        training = Trainer::fit_to_time(&task, training, lenses, (minutes, args.device))?;
    }
    let steps = training.steps;
    let mut trainer = if args.resume {
        let trainer = Trainer::resume_with_lenses(task, training, lenses, &args.output)?;
        let (path, rounded) = (args.output.display(), trainer.checkpoint().body.feature_steps.is_some());
        anyhow::ensure!(
            rounded == args.quantize.is_some(),
            "{path}: --quantize: expected {}, as the run began, found the other; resume it with the same options",
            if rounded { "int8" } else { "none" }
        );
        trainer
    } else {
        new_run(args, task, training, lenses)?
    }
    .on(args.device);
    let mut provenance = Provenance::new("train", run.seed, &trainer.checkpoint().body.training);
    provenance.inputs.insert(role.into(), file_hash(file)?);
    if let (Some(from), false) = (&args.from, args.resume) {
        provenance = provenance.with_input(from)?;
    }
    let begin = trainer.checkpoint().body.step;
    let bar = run.progress(steps, "train");
    bar.set_position(begin);
    let start = Instant::now();
    let mut taken = Vec::new();
    trainer.run(&args.output, &provenance, |progress| {
        bar.set_position(progress.step);
        taken.push(progress.seconds);
        if let Some(p) = progress.point {
            tracing::info!(
                "step {}: loss {:.4}, held out {:.4}, {:.2} dB, SSIM {:.3}",
                p.step,
                p.train_loss,
                p.validation_loss,
                p.psnr_db,
                p.ssim
            );
            // A page that cannot be written does not stop the training.
            if let Some(Err(error)) = args.page.as_deref().map(|page| write_page(page, &args.output)) {
                tracing::warn!("{error:#}");
            }
        }
        Next::Continue
    })?;
    bar.finish_and_clear();
    let figures = RunFigures {
        pairs: source.len(),
        first_step: begin,
        seconds: start.elapsed().as_secs_f64(),
        step_seconds: median(taken),
    };
    outcome(&args.output, &trainer.checkpoint().body, &figures)
}

/// A run from new weights or from another checkpoint, with the filter mask that the options ask for.
fn new_run<'a>(
    args: &Args,
    task: Task<'a>,
    training: TrainConfig,
    lenses: Option<&'a Lenses>,
) -> anyhow::Result<Trainer<'a>> {
    let (trainer, source) = match &args.from {
        Some(from) => (Trainer::fine_tune(task, training, lenses, from)?, MaskSource::Weights),
        None => (Trainer::with_lenses(task, training, lenses)?, MaskSource::Psfs),
    };
    let trainer = match args.tile.is_some() || args.prune.is_some() {
        true => masked(args, trainer, source)?,
        false => trainer,
    };
    match args.quantize {
        Some(Rounded::Int8) => {
            let steps = training_steps(&trainer)?;
            Ok(trainer.with_feature_steps(steps)?)
        }
        None => Ok(trainer),
    }
}

/// The run with the filter mask that the options ask for.
fn masked<'a>(args: &Args, trainer: Trainer<'a>, source: MaskSource) -> anyhow::Result<Trainer<'a>> {
    let energy = args.tile.map(|_| args.energy);
    let config = QuantizeConfig { tile: args.tile, energy, prune: args.prune, ..QuantizeConfig::default() };
    Ok(match training_mask(&trainer, source, &config)? {
        Some(ChosenMask { mask, energy_kept }) => {
            tracing::info!("{mask} keep {energy_kept:.4} of the filters' energy");
            trainer.with_mask(mask)
        }
        None => trainer,
    })
}

fn write_page(page: &Path, checkpoint: &Path) -> anyhow::Result<()> {
    Ok(write_whole(page, ommatidia_report::render(&[checkpoint.into()])?.as_bytes())?)
}

/// What the options ask for. A resumed run takes the steps of its checkpoint unless --steps says otherwise.
fn request(args: &Args, run: &Run) -> anyhow::Result<TrainRequest> {
    let steps = match (args.steps, args.resume) {
        (None, true) => Some(Checkpoint::read(&args.output)?.body.training.steps),
        (steps, _) => steps,
    };
    Ok(TrainRequest {
        preset: args.preset,
        architecture: args.network,
        filters: args.filters,
        passes: args.passes.map(usize::from),
        iterations: args.richardson_lucy.map(usize::from),
        steps,
        batch: args.batch,
        learning_rate: args.learning_rate,
        filter_learning_rate: args.filter_learning_rate,
        start: args.start,
        loss: args.loss,
        patience: args.patience,
        fine_tuning: args.from.is_some(),
        seed: run.seed,
    })
}

/// The median; 0 of no values.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

/// Size and time of a finished run.
struct RunFigures {
    pairs: usize,
    /// Steps that were taken before the run began.
    first_step: u64,
    /// Wall time of the run, s.
    seconds: f64,
    /// Median time of one step, s.
    step_seconds: f64,
}

fn outcome(path: &Path, body: &Body, figures: &RunFigures) -> anyhow::Result<Outcome> {
    let RunFigures { pairs, first_step, seconds, step_seconds } = *figures;
    let best =
        body.curve.iter().find(|p| p.step == body.best_step).context("the run ended before its first validation")?;
    let parameters = weights::count(&body.network);
    let rate = if seconds > 0.0 { (body.step - first_step) as f64 / seconds } else { 0.0 };
    let json = serde_json::json!({
        "checkpoint": in_json(path), "network": body.network, "parameters": parameters, "pairs": pairs,
        "steps": body.step, "seconds": seconds, "steps_per_second": rate, "step_seconds": step_seconds,
        "best_step": body.best_step, "psnr_db": best.psnr_db, "ssim": best.ssim,
        "validation_loss": best.validation_loss, "curve": body.curve,
    });
    let text = format!(
        "{}\n  {} parameters, {} steps in {seconds:.1} s ({rate:.1} a second; {:.1} ms a step alone)\n  best \
         on held-out pairs at step {}: {:.2} dB, SSIM {:.3}\n",
        path.display(),
        parameters,
        body.step,
        1e3 * step_seconds,
        body.best_step,
        best.psnr_db,
        best.ssim,
    );
    Ok(Outcome { json, text })
}
