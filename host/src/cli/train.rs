//! `train`: data set or instrument -> checkpoint.

use super::{Outcome, Run};
use crate::artifact::{Provenance, file_hash, write_whole};
use crate::dataset::{DataSet, PLAN_FILE};
use crate::instrument::Instrument;
use crate::quantize::{self, QuantizeConfig};
use crate::report;
use crate::train::{
    Body, Checkpoint, FINE_TUNE_RATE, Family, FamilyName, Lenses, NetworkConfig, Next, Place, Preset, SensorMaps,
    Simulated, Start, Task, TrainConfig, Trainer, weights,
};
use anyhow::Context;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Steps that are timed to turn minutes into steps.
const TIMED: u64 = 8;

/// Options of `train`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Data set (folder), or instrument (file): then pairs are simulated as they are needed
    #[arg(value_name = "DATASET|INSTRUMENT")]
    input: PathBuf,
    /// Checkpoint to write; it is written anew after each validation
    #[arg(short, long, value_name = "CHECKPOINT")]
    output: PathBuf,
    /// Size of the network and its schedule
    #[arg(long, value_enum, default_value_t)]
    preset: Preset,
    /// The network, or a peer of it that is trained the same way on the same pairs; peers need the instrument
    #[arg(long, value_enum, default_value_t)]
    network: FamilyName,
    /// Fourier filters, or PSFs [default: the preset's]
    #[arg(long, value_name = "N")]
    filters: Option<usize>,
    /// Steps of the optimiser [default: the preset's]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    steps: Option<u64>,
    /// Time to train; the steps that fit into it are found by timing the first few, so the result depends on the machine
    #[arg(long, value_name = "M", conflicts_with_all = ["steps", "resume"])]
    minutes: Option<f64>,
    /// Pairs in a step [default: the preset's]
    #[arg(long, value_name = "N")]
    batch: Option<usize>,
    /// Highest learning rate of the convolutions [default: the preset's]
    #[arg(long, value_name = "RATE")]
    learning_rate: Option<f64>,
    /// Highest learning rate of the filters [default: the preset's]
    #[arg(long, value_name = "RATE")]
    filter_learning_rate: Option<f64>,
    /// What the filters are before the first step [default: the preset's; psf for peers]
    #[arg(long, value_enum)]
    start: Option<Start>,
    /// Validations without a higher SSIM after which the run ends early [default: never]
    #[arg(long, value_name = "N")]
    patience: Option<u64>,
    /// Instrument whose fixed pattern the network shall correct, and whose lenses a peer starts from, with a data set
    #[arg(long, value_name = "FILE")]
    instrument: Option<PathBuf>,
    /// Start from the best weights of a checkpoint, with a third of the preset's learning rates
    #[arg(long, value_name = "CHECKPOINT", conflicts_with_all = ["start", "minutes"])]
    from: Option<PathBuf>,
    /// Prune the filters and hold them to it: they keep the strongest blocks of their kernels, as many as fit into this part of the dense filters'
    /// bytes, so that `quantize` loses next to nothing. Strength is that in the filters that the run starts from with --from, or else in the
    /// pseudo-inverses of the instrument's PSFs
    #[arg(long, value_name = "PART", conflicts_with = "tile", value_parser = super::common::part)]
    prune: Option<f64>,
    /// Hold the filters to the taps of a device's transforms of this side, pixels, chosen as with --prune
    #[arg(long, value_name = "T")]
    tile: Option<usize>,
    /// Part of that energy that the taps must keep
    #[arg(long, value_name = "PART", requires = "tile", default_value_t = 0.9)]
    energy: f64,
    /// Where to compute. Adam and the drawing of noise stay on the cores
    #[arg(long, value_enum, default_value_t)]
    device: Place,
    /// Page with the curves and sample pictures, written anew with each checkpoint: for the browser, while it trains
    #[arg(long, value_name = "HTML")]
    page: Option<PathBuf>,
    /// Take up the run that wrote the checkpoint; it ends in the same bits as if it had never stopped
    #[arg(long)]
    resume: bool,
}

/// Runs the verb.
///
/// # Errors
/// An input cannot be read or does not fit, a setting makes no sense, the loss is no number any more, or the checkpoint cannot be written; the
/// last one stands then.
pub fn run(args: &Args, run: &Run) -> anyhow::Result<Outcome> {
    if args.input.is_dir() {
        let set = DataSet::open(&args.input)?;
        let plan = set.plan();
        let (maps, lenses) = match &args.instrument {
            Some(path) => of_instrument(path, plan.frame)?,
            None => (SensorMaps::default(), None),
        };
        let network = network(args, plan.frame, plan.object, lenses.as_ref())?;
        let task = Task { source: &set, network, noise: plan.noise, maps };
        return train(args, run, task, (plan.peak_e, lenses.as_ref()), ("dataset", &args.input.join(PLAN_FILE)));
    }
    let instrument = Instrument::read(&args.input)?;
    let source = Simulated::of(&instrument, &args.input, run.seed)?;
    let plan = source.plan();
    let lenses = Some(Lenses::of(&instrument)?);
    let network = network(args, plan.frame, plan.object, lenses.as_ref())?;
    let task = Task { source: &source, network, noise: plan.noise, maps: SensorMaps::of(&instrument)? };
    train(args, run, task, (plan.peak_e, lenses.as_ref()), ("instrument", &args.input))
}

/// The network that is asked for.
fn network(
    args: &Args,
    frame: [usize; 2],
    object: [usize; 2],
    lenses: Option<&Lenses>,
) -> anyhow::Result<NetworkConfig> {
    let plain = args.preset.network(frame, object);
    let plain = NetworkConfig { channels: args.filters.unwrap_or(plain.channels), ..plain };
    Ok(match args.network {
        FamilyName::SvFourierNet => plain,
        FamilyName::MultiWienerNet => NetworkConfig { family: Family::MultiWienerNet, ..plain },
        FamilyName::MultiFlatNet => NetworkConfig { family: Family::MultiFlatNet, ..plain },
        FamilyName::Cm2Net => {
            let lenses =
                lenses.context("--network cm2net: expected --instrument FILE, whose lenses it cuts out, found none")?;
            args.preset.cm2net(lenses.cm2net(plain))
        }
    })
}

/// Maps and lenses of an instrument for frames of a data set, which must have its size.
fn of_instrument(path: &Path, frame: [usize; 2]) -> anyhow::Result<(SensorMaps, Option<Lenses>)> {
    let instrument = Instrument::read(path)?;
    let sensor = [instrument.manifest.sensor.rows, instrument.manifest.sensor.cols];
    let (path, [rows, cols]) = (path.display(), frame);
    anyhow::ensure!(
        sensor == frame,
        "{path}: sensor: expected {rows} x {cols} (frames of the data set), found {} x {}",
        sensor[0],
        sensor[1]
    );
    Ok((SensorMaps::of(&instrument)?, Some(Lenses::of(&instrument)?)))
}

fn train(
    args: &Args,
    run: &Run,
    task: Task<'_>,
    (peak_e, lenses): ([f64; 2], Option<&Lenses>),
    (role, input): (&str, &Path),
) -> anyhow::Result<Outcome> {
    let mut training = settings(args, run, &task, peak_e)?;
    if let Some(minutes) = args.minutes {
        training = fit(training, &task, lenses, minutes)?;
    }
    let mut provenance = Provenance::new("train", run.seed, &training);
    provenance.inputs.insert(role.into(), file_hash(input)?);
    let steps = training.steps;
    let pairs = task.source.len();
    args.device.check()?;
    let trainer = if args.resume {
        Trainer::resume_with_lenses(task, training, lenses, &args.output)?
    } else {
        let fresh = match &args.from {
            Some(from) => {
                provenance = provenance.with_input(from)?;
                Trainer::fine_tune(task.clone(), training.clone(), lenses, from)?
            }
            None => Trainer::with_lenses(task.clone(), training.clone(), lenses)?,
        };
        if args.tile.is_some() || args.prune.is_some() {
            let energy = args.tile.map(|_| args.energy);
            let config = QuantizeConfig { tile: args.tile, energy, prune: args.prune, ..QuantizeConfig::default() };
            let chosen = match &args.from {
                Some(_) => quantize::support(fresh.checkpoint(), &config)?,
                None => {
                    let told = TrainConfig { start: Start::Psf, ..training };
                    quantize::support(Trainer::with_lenses(task, told, lenses)?.checkpoint(), &config)?
                }
            };
            match chosen {
                Some((support, kept)) => {
                    tracing::info!("{support} keep {kept:.4} of the filters' energy");
                    fresh.within(support)
                }
                None => fresh,
            }
        } else {
            fresh
        }
    };
    let mut trainer = trainer.at(args.device);
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
            // A page that cannot be written costs no training.
            if let Some(Err(error)) = args.page.as_deref().map(|page| write_page(page, &args.output)) {
                tracing::warn!("{error:#}");
            }
        }
        Next::Continue
    })?;
    bar.finish_and_clear();
    let seconds = start.elapsed().as_secs_f64();
    outcome(&args.output, &trainer.checkpoint().body, pairs, begin, (seconds, median(taken)))
}

fn write_page(page: &Path, checkpoint: &Path) -> anyhow::Result<()> {
    Ok(write_whole(page, report::render(&[checkpoint.into()])?.as_bytes())?)
}

/// The preset's settings and what the command line changes in them.
fn settings(args: &Args, run: &Run, task: &Task<'_>, peak_e: [f64; 2]) -> anyhow::Result<TrainConfig> {
    let steps = match (args.steps, args.resume) {
        (None, true) => Some(Checkpoint::read(&args.output)?.body.training.steps),
        (steps, _) => steps,
    };
    let training = args.preset.training(task.noise.full_scale_e(), run.seed);
    let mut training = Preset::for_family(training, args.network, task.network.filter_size);
    training.peak_e = peak_e;
    if let Some(steps) = steps {
        training = training.with_steps(steps);
    }
    training.batch = args.batch.unwrap_or(training.batch);
    if args.from.is_some() {
        training.learning_rate *= FINE_TUNE_RATE;
        training.filter_learning_rate *= FINE_TUNE_RATE;
        training.start = Start::Random;
    }
    training.learning_rate = args.learning_rate.unwrap_or(training.learning_rate);
    training.filter_learning_rate = args.filter_learning_rate.unwrap_or(training.filter_learning_rate);
    training.start = args.start.unwrap_or(training.start);
    training.patience = args.patience.unwrap_or(training.patience);
    Ok(training)
}

/// As many steps as fit into the time.
fn fit(training: TrainConfig, task: &Task<'_>, lenses: Option<&Lenses>, minutes: f64) -> anyhow::Result<TrainConfig> {
    anyhow::ensure!(minutes.is_finite() && minutes > 0.0, "--minutes: expected a positive number, found {minutes}");
    let mut trial = Trainer::with_lenses(task.clone(), training.clone(), lenses)?;
    trial.step()?;
    let start = Instant::now();
    for _ in 0..TIMED {
        trial.step()?;
    }
    let steps = (60.0 * minutes * TIMED as f64 / start.elapsed().as_secs_f64()) as u64;
    Ok(training.with_steps(steps.max(1)))
}

/// The median; 0 of nothing.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

fn outcome(path: &Path, body: &Body, pairs: usize, begin: u64, (seconds, step): (f64, f64)) -> anyhow::Result<Outcome> {
    let best =
        body.curve.iter().find(|p| p.step == body.best_step).context("the run ended before its first validation")?;
    let parameters: usize =
        weights::shapes(&body.network).iter().map(|(_, shape)| shape.iter().product::<usize>()).sum();
    let rate = if seconds > 0.0 { (body.step - begin) as f64 / seconds } else { 0.0 };
    let json = serde_json::json!({
        "checkpoint": path, "network": body.network, "parameters": parameters, "pairs": pairs, "steps": body.step, "seconds": seconds,
        "steps_per_second": rate, "step_seconds": step, "best_step": body.best_step, "psnr_db": best.psnr_db, "ssim": best.ssim,
        "validation_loss": best.validation_loss, "curve": body.curve,
    });
    let text = format!(
        "{}\n  {} parameters, {} steps in {seconds:.1} s ({rate:.1} a second; {:.1} ms a step alone)\n  best on held-out pairs at step {}: {:.2} dB, SSIM {:.3}\n",
        path.display(),
        parameters,
        body.step,
        1e3 * step,
        body.best_step,
        best.psnr_db,
        best.ssim,
    );
    Ok(Outcome { json, text })
}
