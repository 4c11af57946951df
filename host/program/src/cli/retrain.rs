//! Trains and fine-tunes networks for `close` and `study`, which know networks by these interfaces only.

use anyhow::{Context, ensure};
use ommatidia_closing::study::networks::{FirstTraining, TrainRequest};
use ommatidia_closing::{Control, Filed, Retrain, RetrainRequest, Retrained};
use ommatidia_model::metrics::Case;
use ommatidia_network::evaluate::{Source, judge};
use ommatidia_network::methods::FloatNetwork;
use ommatidia_network::train::{Checkpoint, Lenses, Next, Preset, Simulated, Task, Trainer};
use ommatidia_session::Role;
use ommatidia_session::artifact::{Provenance, temporary_folder_beside};
use std::path::Path;

/// The trainer of this program.
#[derive(Clone, Copy, Debug, Default)]
pub struct Networks;

impl Retrain for Networks {
    fn retrain(&self, request: &RetrainRequest<'_>, progress: &mut dyn FnMut(u64)) -> anyhow::Result<Retrained> {
        let RetrainRequest { session, closed, before, checkpoint, output, held_out_frames, steps, .. } = *request;
        let stack = session.stacks_of(Role::Scene).find(|s| s.entry().truth.is_some());
        let stack = stack.context("--retrain: expected scenes with truth to judge by, found none")?;
        ensure!(!held_out_frames.is_empty(), "--retrain: expected held-out scenes to judge by, found none");
        fine_tune(request, closed, output, progress)?;
        let grid = session.manifest().object;
        let figures = |path: &Path| -> anyhow::Result<(f64, f64)> {
            let network = FloatNetwork::open(path)?;
            let (mut frames, truth) = (stack.frames()?, stack.truth()?);
            let mut truth = truth.context("the truths of the scenes")?;
            let case = |i: usize| -> anyhow::Result<Case> {
                let frame = held_out_frames[i];
                Ok(Case { frame_dn: frames.read(frame)?, truth: truth.read(frame)? })
            };
            let (m, _) = judge(&Source::Method(&network), &grid, held_out_frames.len(), &[], case, || ())?;
            Ok((m.psnr_db, m.ssim))
        };
        let ((psnr_db_before, ssim_before), (psnr_db_after, ssim_after)) = (figures(checkpoint)?, figures(output)?);
        let control = match before {
            None => None,
            Some(before) => {
                let folder = temporary_folder_beside(output)?;
                let file = folder.path().join("control.network");
                fine_tune(request, before, &file, &mut |step| progress(steps + step))?;
                let (psnr_db, ssim) = figures(&file)?;
                Some(Control { psnr_db, ssim })
            }
        };
        let frames = held_out_frames.to_vec();
        Ok(Retrained { frames, steps, psnr_db_before, psnr_db_after, ssim_before, ssim_after, control })
    }
}

/// Fine-tunes the network of a request on an instrument, and writes it to `output`.
fn fine_tune(
    request: &RetrainRequest<'_>,
    on: Filed<'_>,
    output: &Path,
    progress: &mut dyn FnMut(u64),
) -> anyhow::Result<()> {
    let RetrainRequest { checkpoint, steps, seed, .. } = *request;
    let before = Checkpoint::read(checkpoint)?;
    let source = Simulated::of(on.instrument, on.file, seed, &before.body.training.vary)?;
    let plan = source.plan();
    let maps = on.instrument.sensor_maps()?;
    let mut training = before.body.training.clone().with_steps(steps).for_fine_tuning();
    training.peak_e = plan.peak_e;
    training.seed = seed;
    let task = Task { source: &source, network: before.body.network.clone(), noise: plan.noise, maps };
    let provenance = Provenance::new("close --retrain", seed, &training).with_input(checkpoint)?.with_input(on.file)?;
    // Only passes that predict frames need the lenses.
    let lenses = before.body.network.feedback.as_ref().map(|_| Lenses::of(on.instrument)).transpose()?;
    let mut trainer = Trainer::fine_tune(task, training, lenses.as_ref(), checkpoint)?;
    trainer.run(output, &provenance, |p| {
        progress(p.step);
        Next::Continue
    })?;
    Ok(())
}

impl FirstTraining for Networks {
    fn train(&self, request: &TrainRequest<'_>) -> anyhow::Result<()> {
        let TrainRequest { instrument, instrument_file, output, steps, seed } = *request;
        let source = Simulated::of(instrument, instrument_file, seed, &[])?;
        let plan = source.plan();
        let maps = instrument.sensor_maps()?;
        let network = Preset::Nano.network(plan.frame, plan.object);
        let mut training = Preset::Nano.training(plan.noise.full_scale_e(), seed).with_steps(steps);
        training.peak_e = plan.peak_e;
        let provenance = Provenance::new("study", seed, &training).with_input(instrument_file)?;
        let task = Task { source: &source, network, noise: plan.noise, maps };
        Trainer::new(task, training)?.run(output, &provenance, |_| Next::Continue)?;
        Ok(())
    }
}
