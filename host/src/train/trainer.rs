//! The loop: draw, forward, backward, step; validate and save now and then.

mod start;

use super::adam::Group;
use super::checkpoint::{Checkpoint, CurvePoint, SensorMaps};
use super::loss::bce_mse;
use super::network::{Mode, Network, Said, values};
use super::ops::fourier::Fourier;
use super::source::{Example, Loader, PairSource};
use super::{Lenses, NetworkConfig, Place, Seen, TrainConfig, TrainError};
use crate::artifact::{Provenance, Tensors};
use crate::evaluate::{compare, scaled};
use crate::noise::NoiseModel;
use crate::rng;
use burn::tensor::activation::sigmoid;
use burn::tensor::{Tensor, TensorData};
use ndarray::ArrayView2;
use rand::seq::SliceRandom;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

/// Reconstructions of held-out frames that a checkpoint keeps for people to look at.
const SAMPLES: usize = 3;

/// Times that a run goes back to its last checkpoint with half the learning rates before it gives up.
const MOST_SLOWED: u32 = 6;

/// A held-out loss this many times the lowest so far is one that a run does not come back from: its steps were too long. Sound runs were seen to reach 1.5.
const BURST: f32 = 1.75;

/// What training needs besides its settings.
#[derive(Clone, Debug)]
pub struct Task<'a> {
    /// The pairs.
    pub source: &'a dyn PairSource,
    /// Shape of the network.
    pub network: NetworkConfig,
    /// Noise of the sensor.
    pub noise: NoiseModel,
    /// Corrections of the sensor; stored for those who use the network.
    pub maps: SensorMaps,
}

/// What happened at a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Steps taken.
    pub step: u64,
    /// Loss of this step.
    pub loss: f64,
    /// What the step took, seconds; looking at the held-out pairs and writing not counted.
    pub seconds: f64,
    /// The validation after it, if there was one.
    pub point: Option<CurvePoint>,
}

/// Whether to go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// Go on.
    Continue,
    /// Stop; the last checkpoint stands.
    Stop,
}

/// A training run.
pub struct Trainer<'a> {
    task: Task<'a>,
    lenses: Option<&'a Lenses>,
    place: Place,
    plan: Arc<Fourier>,
    train: Vec<usize>,
    held_out: Vec<usize>,
    state: Checkpoint,
    /// Whether its checkpoint lies on disk.
    kept: bool,
    /// The examples of a step, drawn while the one before it was taken.
    next: Option<(u64, Vec<Example>)>,
    /// Loss since the last validation: sum and count.
    recent: (f64, u64),
}

impl<'a> Trainer<'a> {
    fn loader(&self) -> Loader<'_> {
        let TrainConfig { peak_e, seed, .. } = self.state.body.training;
        Loader {
            source: self.task.source,
            network: &self.task.network,
            plan: &self.plan,
            noise: &self.task.noise,
            maps: &self.task.maps,
            peak_e,
            seed,
            lenses: self.lenses,
        }
    }

    /// The same, computed elsewhere from now on.
    #[must_use]
    pub fn at(self, place: Place) -> Self {
        Self { place, ..self }
    }

    fn network(&self, mode: Mode) -> Result<Network, TrainError> {
        Network::on(self.place, &self.task.network, &self.plan, &self.state.current, mode)
    }

    /// How it stands.
    pub fn checkpoint(&self) -> &Checkpoint {
        &self.state
    }

    /// Whether the held-out pairs have not looked better for `patience` validations. It follows from the curve, so a run that is taken up stops where
    /// it would have stopped.
    pub fn is_done(&self) -> bool {
        let body = &self.state.body;
        let since = body.curve.iter().filter(|p| p.step > body.best_step).count() as u64;
        body.step >= body.training.steps || (body.training.patience > 0 && since >= body.training.patience)
    }

    /// Runs to the end, until it has stopped getting better, or until `watch` says stop; writes a checkpoint at `path` at each validation, and goes
    /// back to it, with half the learning rates, where the loss is no number any more or has burst.
    ///
    /// # Errors
    /// A pair cannot be had, the loss is no number whatever the learning rates, or the checkpoint cannot be written.
    pub fn run(
        &mut self,
        path: &Path,
        provenance: &Provenance,
        mut watch: impl FnMut(Progress) -> Next,
    ) -> Result<(), TrainError> {
        while !self.is_done() {
            let begin = Instant::now();
            let loss = match self.step() {
                Err(TrainError::Diverged { step, .. }) if self.kept && self.state.body.slowed < MOST_SLOWED => {
                    self.go_back(path, step, "is no number")?;
                    continue;
                }
                loss => loss?,
            };
            let seconds = begin.elapsed().as_secs_f64();
            let (step, TrainConfig { steps, validate_every, .. }) = (self.state.body.step, &self.state.body.training);
            let point = if step % validate_every == 0 || step == *steps { Some(self.validate()?) } else { None };
            if self.kept && self.state.body.slowed < MOST_SLOWED && point.is_some() && self.has_burst() {
                self.go_back(path, step, "has burst")?;
                continue;
            }
            if point.is_some() {
                self.state.write(path, provenance.clone())?;
                self.kept = true;
            }
            if watch(Progress { step, loss, seconds, point }) == Next::Stop {
                break;
            }
        }
        Ok(())
    }

    /// To the last checkpoint, with half the learning rates that led away from it. A run that was killed meanwhile finds the same way.
    fn go_back(&mut self, path: &Path, step: u64, loss: &str) -> Result<(), TrainError> {
        let body = &self.state.body;
        let (slowed, training) = (body.slowed + 1, body.training.clone());
        self.state = Checkpoint::read(path)?;
        (self.state.body.slowed, self.state.body.training) = (slowed, training);
        self.recent = (0.0, 0);
        let to = self.state.body.step;
        tracing::warn!("step {step}: the loss {loss}; on from step {to} with half the learning rates");
        Ok(())
    }

    /// Whether the last validation found that the steps since the one before had led far away.
    fn has_burst(&self) -> bool {
        let Some((last, before)) = self.state.body.curve.split_last() else { return false };
        let lowest = before.iter().map(|p| p.validation_loss).fold(f32::INFINITY, f32::min);
        last.validation_loss > BURST * lowest
    }

    /// One step of the optimiser; its loss.
    ///
    /// # Errors
    /// As [`Trainer::run`].
    pub fn step(&mut self) -> Result<f64, TrainError> {
        let step = self.state.body.step;
        let training = self.state.body.training.clone();
        let examples = match self.next.take() {
            Some((at, examples)) if at == step => examples,
            _ => self.draw(step)?,
        };
        // Drawing noise is work for one core, a step of a small network not for all.
        let (descent, next) = rayon::join(
            || self.descent(examples),
            || if step + 1 < training.steps { self.draw(step + 1).ok() } else { None },
        );
        let (value, mut gradients) = descent?;
        // What failed is drawn again, and fails, when its turn has come.
        self.next = next.map(|examples| (step + 1, examples));
        if !value.is_finite() || gradients.values().flatten().any(|g| !g.is_finite()) {
            return Err(TrainError::Diverged { step, loss: value });
        }
        let rate = training.rate(step) * 0.5f64.powi(self.state.body.slowed as i32);
        let state = &mut self.state;
        state.adam.clip(&mut gradients, training.clip);
        state.adam.step(&mut state.current, &gradients, |group| match group {
            Group::Filters => rate * training.filter_learning_rate,
            Group::Layers => rate * training.learning_rate,
        });
        state.body.norms = state.adam.norms;
        state.body.step += 1;
        self.hold();
        self.recent = (self.recent.0 + f64::from(value), self.recent.1 + 1);
        Ok(f64::from(value))
    }

    /// The examples of a step.
    fn draw(&self, step: u64) -> Result<Vec<Example>, TrainError> {
        self.loader().examples(&self.batch(step), "train", step)
    }

    /// The loss of examples, and its gradients.
    fn descent(&self, examples: Vec<Example>) -> Result<(f32, BTreeMap<String, Vec<f32>>), TrainError> {
        let network = self.network(Mode::Train)?;
        let (frames, targets) = split(examples);
        let loss = self.loss(network.say(frames), targets, Mode::Train);
        let value: f32 = loss.clone().inner().into_scalar();
        Ok((value, network.gradients(loss.backward())))
    }

    /// Holds the filters to the taps that they may have.
    fn hold(&mut self) {
        if let Some(support) = self.state.body.support.take() {
            support.project(&self.plan, &mut self.state.current);
            self.state.body.support = Some(support);
        }
    }

    /// Pairs of a step: epochs in an order of their own, one after the other, so that any step can be found again.
    fn batch(&self, step: u64) -> Vec<usize> {
        let TrainConfig { batch, seed, .. } = self.state.body.training;
        let n = self.train.len() as u64;
        let first = step * batch as u64;
        let mut order = (u64::MAX, Vec::new());
        (first..first + batch as u64)
            .map(|i| {
                if order.0 != i / n {
                    let mut pairs = self.train.clone();
                    pairs.shuffle(&mut rng::stream(seed, "epoch", i / n));
                    order = (i / n, pairs);
                }
                order.1[(i % n) as usize]
            })
            .collect()
    }

    /// The same loss for what is reconstructed and, where a network says it, for what each lens alone would show.
    fn loss(&self, said: Said, targets: Targets, mode: Mode) -> Tensor<1> {
        let device = self.place.device(mode);
        let held_against = |logits: Tensor<4>, targets: Vec<f32>| {
            let shape = logits.dims();
            bce_mse(logits, Tensor::from_data(TensorData::new(targets, shape), &device))
        };
        let loss = held_against(said.logits, targets.objects);
        match said.views {
            Some(views) => loss + held_against(views, targets.views),
            None => loss,
        }
    }

    /// Looks at the held-out pairs, always with the same draws of noise, and keeps the weights if they are the best so far by SSIM, as the paper does.
    ///
    /// # Errors
    /// A pair cannot be had or judged.
    pub fn validate(&mut self) -> Result<CurvePoint, TrainError> {
        let network = self.network(Mode::Infer)?;
        let [rows, cols] = self.task.network.object;
        let examples = self.loader().examples(&self.held_out, "validation", 0)?;
        let (mut loss, mut psnr_db, mut ssim) = (0.0, 0.0, 0.0);
        let mut samples = Vec::new();
        for (example, &index) in examples.into_iter().zip(&self.held_out) {
            let target = example.target.clone();
            let (frames, targets) = split(vec![example]);
            let said = network.say(frames);
            let found = values(sigmoid(said.logits.clone()));
            loss += f64::from(self.loss(said, targets, Mode::Infer).into_scalar::<f32>());
            let view = |v| ArrayView2::from_shape((rows, cols), v);
            let (Ok(x), Ok(t)) = (view(&found), view(&target)) else {
                unreachable!("the network and the loader give object pixels")
            };
            let figures = compare(x, t).map_err(|source| TrainError::Source { index, source: source.into() })?;
            (psnr_db, ssim) = (psnr_db + figures.psnr_db, ssim + figures.ssim);
            // Cases are the first of the held-out pairs, in units of their own.
            if let Some(case) = self.state.cases.get(samples.len()).filter(|_| samples.len() < SAMPLES) {
                let own = compare(x, case.truth.view());
                samples.push(scaled(&x.to_owned(), own.map_or(0.0, |figures| figures.scale)));
            }
        }
        let n = self.held_out.len() as f64;
        let (sum, count) = std::mem::take(&mut self.recent);
        let body = &mut self.state.body;
        let train_loss = if count > 0 { sum / count as f64 } else { 0.0 };
        let [train_loss, validation_loss, psnr_db, ssim] =
            [train_loss, loss / n, psnr_db / n, ssim / n].map(|v| v as f32);
        let point = CurvePoint { step: body.step, train_loss, validation_loss, psnr_db, ssim };
        if body.curve.iter().all(|p| point.ssim > p.ssim) {
            body.best_step = body.step;
            self.state.weights = Tensors::clone(&self.state.current);
            self.state.samples = samples;
        }
        self.state.body.curve.push(point);
        Ok(point)
    }
}

/// Whether two numbers agree but for what writing and reading them as JSON may cost.
pub(super) fn same(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-12 * a.abs().max(b.abs())
}

/// What a batch is held against, each in one piece.
#[derive(Clone)]
struct Targets {
    objects: Vec<f32>,
    /// Empty for networks that are not told.
    views: Vec<f32>,
}

/// Frames and targets of a batch.
fn split(examples: Vec<Example>) -> (Vec<Seen>, Targets) {
    let mut targets = Targets { objects: Vec::new(), views: Vec::new() };
    let mut frames = Vec::new();
    for example in examples {
        targets.objects.extend(example.target);
        targets.views.extend(example.views.unwrap_or_default());
        frames.push(example.seen);
    }
    (frames, targets)
}

#[cfg(test)]
mod tests;
