//! What the loop is worth to the picture: a network that was fine-tuned on the closed instrument beside one on the true instrument.
//!
//! Both start from one network, trained on the calibrated instrument, and take the same steps on the same scenes; both reconstruct frames of
//! another session of the changed instrument. The true instrument is the calibrated one with what was put in, at its true values.

use super::subject::Subject;
use crate::artifact::Provenance;
use crate::bench::VirtualInstrument;
use crate::closing::retrain::{Retrained, retrain};
use crate::effects::EffectSetting;
use crate::instrument::Instrument;
use crate::train::{Next, Preset, Simulated, Task, Trainer};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Steps of the first training.
const STEPS: u64 = 3000;
/// Steps of fine-tuning.
const FINE_STEPS: u64 = 1000;

/// Mean PSNR of reconstructions of scenes that no training has seen, dB.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Reconstruction {
    /// Of the network that was trained on the calibrated instrument.
    pub before_db: f64,
    /// Fine-tuned on the closed instrument.
    pub closed_db: f64,
    /// Fine-tuned on the true instrument.
    pub truth_db: f64,
}

/// Trains a network on an instrument, of the smallest preset.
///
/// # Errors
/// The instrument's parts disagree, or the file cannot be written.
pub fn train(instrument: &Instrument, file: &Path, seed: u64, output: &Path) -> anyhow::Result<()> {
    let source = Simulated::of(instrument, file, seed)?;
    let plan = source.plan();
    let maps = instrument.sensor_maps()?;
    let network = Preset::Nano.network(plan.frame, plan.object);
    let mut training = Preset::Nano.training(plan.noise.full_scale_e(), seed).with_steps(STEPS);
    training.peak_e = plan.peak_e;
    let provenance = Provenance::new("study", seed, &training).with_input(file)?;
    let task = Task { source: &source, network, noise: plan.noise, maps };
    Trainer::new(task, training)?.run(output, &provenance, |_| Next::Continue)?;
    Ok(())
}

/// Compares the two on another session of the changed bench.
///
/// # Errors
/// A file cannot be written, or a training fails.
pub fn compare(
    subject: &Subject,
    bench: &VirtualInstrument,
    closed: &Instrument,
    settings: &[EffectSetting],
    seed: u64,
) -> anyhow::Result<Reconstruction> {
    let folder = tempfile::tempdir()?;
    let session = subject.session(bench, &folder.path().join("session"), seed ^ 0xd015)?;
    let frames: Vec<usize> = (0..subject.config.stacks.scene_frames).collect();
    let tuned = |name: &str, instrument: &Instrument| -> anyhow::Result<Retrained> {
        let [file, network] = ["instrument", "network"].map(|suffix| folder.path().join(format!("{name}.{suffix}")));
        instrument.write(&file, Provenance::new("study", seed, &settings))?;
        retrain(&session, (instrument, &file), (&subject.network, &network), &frames, (FINE_STEPS, seed), |_| {})
    };
    let truth = Instrument { effects: settings.to_vec(), ..subject.instrument.clone() };
    let (closed, truth) = (tuned("closed", closed)?, tuned("true", &truth)?);
    Ok(Reconstruction {
        before_db: closed.psnr_db_before,
        closed_db: closed.psnr_db_after,
        truth_db: truth.psnr_db_after,
    })
}
