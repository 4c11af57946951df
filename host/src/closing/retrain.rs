//! Closing it all the way: the network is fine-tuned on the corrected model, and both networks reconstruct scenes that no fit
//! has seen.

use crate::artifact::Provenance;
use crate::evaluate::{Source, judge};
use crate::instrument::Instrument;
use crate::methods::FloatNetwork;
use crate::metrics::Case;
use crate::session::{Role, Session};
use crate::train::{Checkpoint, Next, Simulated, Task, Trainer};
use anyhow::{Context, ensure};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Reconstruction before and after, on held-out scenes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Retrained {
    /// Scenes that were reconstructed.
    pub frames: Vec<usize>,
    /// Steps of fine-tuning.
    pub steps: u64,
    /// Mean PSNR of the network as it was, dB.
    pub psnr_db_before: f64,
    /// Mean PSNR of the network that was fine-tuned on the closed instrument, dB.
    pub psnr_db_after: f64,
    /// Mean SSIM before.
    pub ssim_before: f64,
    /// Mean SSIM after.
    pub ssim_after: f64,
}

/// Fine-tunes the network at `checkpoint` on `closed` (the instrument at `file`), writes it to `output`, and compares the two on the scenes `held_out`
/// of the session.
///
/// # Errors
/// The checkpoint is of another instrument's size, a file cannot be read or written, or the session has no known scenes.
pub fn retrain(
    session: &Session,
    (closed, file): (&Instrument, &Path),
    (checkpoint, output): (&Path, &Path),
    held_out: &[usize],
    (steps, seed): (u64, u64),
    mut step: impl FnMut(u64),
) -> anyhow::Result<Retrained> {
    let stack = session.stacks_of(Role::Scene).find(|s| s.entry().truth.is_some());
    let stack = stack.context("--retrain: expected scenes with truth to judge by, found none")?;
    ensure!(!held_out.is_empty(), "--retrain: expected held-out scenes to judge by, found none");
    let before = Checkpoint::read(checkpoint)?;
    let source = Simulated::of(closed, file, seed)?;
    let plan = source.plan();
    let maps = closed.sensor_maps()?;
    let mut training = before.body.training.clone().with_steps(steps).for_fine_tuning();
    training.peak_e = plan.peak_e;
    training.seed = seed;
    let task = Task { source: &source, network: before.body.network.clone(), noise: plan.noise, maps };
    let provenance = Provenance::new("close --retrain", seed, &training).with_input(checkpoint)?.with_input(file)?;
    let mut trainer = Trainer::fine_tune(task, training, None, checkpoint)?;
    trainer.run(output, &provenance, |progress| {
        step(progress.step);
        Next::Continue
    })?;
    let grid = session.manifest().object;
    let figures = |path: &Path| -> anyhow::Result<(f64, f64)> {
        let network = FloatNetwork::open(path)?;
        let (mut frames, truth) = (stack.frames()?, stack.truth()?);
        let mut truth = truth.context("the truths of the scenes")?;
        let case = |i: usize| -> anyhow::Result<Case> {
            Ok(Case { frame_dn: frames.read(held_out[i])?, truth: truth.read(held_out[i])? })
        };
        let (m, _) = judge(&Source::Method(&network), &grid, held_out.len(), &[], case, || ())?;
        Ok((m.psnr_db, m.ssim))
    };
    let ((psnr_db_before, ssim_before), (psnr_db_after, ssim_after)) = (figures(checkpoint)?, figures(output)?);
    Ok(Retrained { frames: held_out.to_vec(), steps, psnr_db_before, psnr_db_after, ssim_before, ssim_after })
}
