//! The training loop: simulate examples, forward, backward, step; validate and write a checkpoint at intervals.

mod reuse;
mod start;

use super::adam::Group;
use super::checkpoint::{Checkpoint, CurvePoint};
use super::loader::{Draw, Example, Loader};
use super::network::{Network, NetworkOutput, values};
use super::ops::fourier::Fourier;
use super::{Backend, Estimator, Lenses, Mode, NetworkInput, Predictor, Task, TrainConfig, TrainError};
use burn_tensor::activation::sigmoid;
use burn_tensor::{Tensor, TensorData};
use ndarray::ArrayView2;
use ommatidia_model::metrics::{compare, scaled};
use ommatidia_session::artifact::{Provenance, Tensors};
use ommatidia_session::rng;
use rand::seq::SliceRandom;
use reuse::Reuse;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

/// Names the noise of the held-out pairs.
const VALIDATION: Draw<'static> = Draw { name: "validation", index: 0 };

/// Number of reconstructions of held-out frames that a checkpoint keeps for people to look at.
const SAMPLES: usize = 3;

/// Maximum number of times that a run goes back to its last checkpoint with half the learning rates.
const MOST_SLOWED: u32 = 6;

/// A held-out loss above this many times the lowest so far has diverged: the steps were too long, and runs do not
/// recover from it. Runs that went well reached up to 1.5.
const DIVERGED: f32 = 1.75;

/// Weight of the loss of a pass before the last one.
const BEFORE: f32 = 0.3;

/// Report of one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Number of steps taken.
    pub step: u64,
    /// Loss of this step.
    pub loss: f64,
    /// Duration of the step, seconds, without validation and writing.
    pub seconds: f64,
    /// The validation after the step, if there was one.
    pub point: Option<CurvePoint>,
}

/// Whether a run continues.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// Continue.
    Continue,
    /// Stop; the last checkpoint on disk stays.
    Stop,
}

/// A training run.
pub struct Trainer<'a> {
    task: Task<'a>,
    lenses: Option<&'a Lenses>,
    /// Predicts frames, where the network has feedback; planned once for the run.
    predictor: Option<Predictor>,
    estimator: Option<Estimator>,
    backend: Backend,
    plan: Arc<Fourier>,
    train: Vec<usize>,
    held_out: Vec<usize>,
    state: Checkpoint,
    /// Whether a checkpoint of this run is on disk.
    kept: bool,
    /// Examples for later steps by the number of their draw; see [`Reuse`].
    prepared: BTreeMap<u64, Vec<Example>>,
    recent: RecentLoss,
}

/// Losses of the steps since the last validation.
#[derive(Clone, Copy, Default)]
struct RecentLoss {
    sum: f64,
    steps: u64,
}

/// Loss of a batch and its gradients.
struct Descent {
    loss: f32,
    gradients: BTreeMap<String, Vec<f32>>,
}

impl<'a> Trainer<'a> {
    fn loader(&self) -> Loader<'_> {
        let TrainConfig { peak_e, seed, .. } = self.state.body.training;
        Loader::new(&self.task, &self.plan, peak_e, seed)
            .with_lenses(self.lenses)
            .with_estimator(self.estimator.as_ref())
    }

    /// The same run, computed on `backend`.
    #[must_use]
    pub fn on(self, backend: Backend) -> Self {
        Self { backend, ..self }
    }

    fn network(&self, mode: Mode) -> Result<Network, TrainError> {
        let predictor = self.predictor.clone();
        let network =
            Network::planned(self.backend, &self.task.network, &self.plan, predictor, &self.state.current, mode)?;
        match &self.state.body.feature_steps {
            Some(steps) => network.rounded(steps),
            None => Ok(network),
        }
    }

    /// State of the run.
    pub fn checkpoint(&self) -> &Checkpoint {
        &self.state
    }

    /// Whether all steps are taken, or no validation of the last `patience` ones was better than the best before. This
    /// follows from the curve in the checkpoint, so a resumed run ends at the same step.
    pub fn is_done(&self) -> bool {
        let body = &self.state.body;
        let since = body.curve.iter().filter(|p| p.step > body.best_step).count() as u64;
        body.step >= body.training.steps || (body.training.patience > 0 && since >= body.training.patience)
    }

    /// Trains until [`Trainer::is_done`] or until `watch` returns [`Next::Stop`]. Writes a checkpoint at `path` at each
    /// validation. Where the loss diverges, goes back to the last checkpoint and halves the learning rates.
    ///
    /// # Errors
    /// A pair cannot be loaded, the loss still diverges after several halvings, or the checkpoint cannot be written.
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
                    self.go_back(path, step, "is not finite")?;
                    continue;
                }
                loss => loss?,
            };
            let seconds = begin.elapsed().as_secs_f64();
            let (step, TrainConfig { steps, validate_every, .. }) = (self.state.body.step, &self.state.body.training);
            let point = if step % validate_every == 0 || step == *steps { Some(self.validate()?) } else { None };
            if self.kept && self.state.body.slowed < MOST_SLOWED && point.is_some() && self.has_diverged() {
                self.go_back(path, step, "has diverged")?;
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

    /// Goes back to the last checkpoint and halves the learning rates. An interrupted run that is resumed does the
    /// same.
    fn go_back(&mut self, path: &Path, step: u64, loss: &str) -> Result<(), TrainError> {
        let body = &self.state.body;
        let (slowed, training) = (body.slowed + 1, body.training.clone());
        self.state = Checkpoint::read(path)?;
        (self.state.body.slowed, self.state.body.training) = (slowed, training);
        self.recent = RecentLoss::default();
        let to = self.state.body.step;
        tracing::warn!("step {step}: the loss {loss}; continuing from step {to} with half the learning rates");
        Ok(())
    }

    /// Whether the held-out loss of the last validation is far above the lowest before it.
    fn has_diverged(&self) -> bool {
        let Some((last, before)) = self.state.body.curve.split_last() else { return false };
        let lowest = before.iter().map(|p| p.validation_loss).fold(f32::INFINITY, f32::min);
        last.validation_loss > DIVERGED * lowest
    }

    /// Takes one step of the optimiser and returns its loss.
    ///
    /// # Errors
    /// A pair cannot be loaded, or [`TrainError::Diverged`].
    pub fn step(&mut self) -> Result<f64, TrainError> {
        let step = self.state.body.step;
        let training = self.state.body.training.clone();
        let reuse = Reuse::of(&self.task.network);
        let draw = reuse.draw(step);
        let examples = match self.prepared.remove(&draw) {
            Some(examples) => examples,
            None => self.simulate(draw)?,
        };
        // A step of a small network does not use all cores; examples of later steps are simulated on the rest.
        let later = reuse.ahead(step).filter(|later| *later <= reuse.draw(training.steps - 1));
        let again = reuse.again(step).then(|| examples.clone());
        let (descent, next) =
            rayon::join(|| self.descent(examples), || later.and_then(|draw| Some((draw, self.simulate(draw).ok()?))));
        let Descent { loss, mut gradients } = descent?;
        // Examples that failed are simulated again, and reported, in the step that needs them.
        self.prepared.extend(again.map(|examples| (draw, examples)));
        self.prepared.extend(next);
        let kept = reuse.kept(step + 1);
        self.prepared.retain(|draw, _| kept.contains(draw));
        if !loss.is_finite() || gradients.values().flatten().any(|g| !g.is_finite()) {
            return Err(TrainError::Diverged { step, loss });
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
        self.apply_mask();
        self.recent = RecentLoss { sum: self.recent.sum + f64::from(loss), steps: self.recent.steps + 1 };
        Ok(f64::from(loss))
    }

    /// Simulates the examples of draw `index`.
    fn simulate(&self, index: u64) -> Result<Vec<Example>, TrainError> {
        self.loader().examples(&self.batch(index), Draw { name: "train", index })
    }

    /// The loss of a batch and its gradients.
    fn descent(&self, examples: Vec<Example>) -> Result<Descent, TrainError> {
        let network = self.network(Mode::Train)?;
        let Batch { inputs, targets } = Batch::of(examples);
        let loss = self.loss(network.forward(inputs), targets, Mode::Train);
        let gradients = network.gradients(loss.backward());
        Ok(Descent { loss: loss.inner().into_scalar(), gradients })
    }

    /// Sets the lags outside the filter mask to 0.
    fn apply_mask(&mut self) {
        if let Some(mask) = self.state.body.filter_mask.take() {
            mask.project(&self.plan, &mut self.state.current);
            self.state.body.filter_mask = Some(mask);
        }
    }

    /// Indices of the pairs of a draw of examples. Each epoch has its own order, which follows from the seed and the
    /// number of the epoch, so that a resumed run takes the same pairs.
    fn batch(&self, draw: u64) -> Vec<usize> {
        let TrainConfig { batch, seed, .. } = self.state.body.training;
        let n = self.train.len() as u64;
        let first = draw * batch as u64;
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

    /// The loss of the reconstructions, plus that of the views of each lens where the network outputs them.
    fn loss(&self, output: NetworkOutput, targets: Targets, mode: Mode) -> Tensor<1> {
        let device = self.backend.device(mode);
        let loss_against = |logits: Tensor<4>, targets: Vec<f32>| {
            let shape = logits.dims();
            self.state.body.training.loss.of(logits, Tensor::from_data(TensorData::new(targets, shape), &device))
        };
        let mut loss = loss_against(output.logits, targets.objects.clone());
        for logits in output.before {
            loss = loss + loss_against(logits, targets.objects.clone()) * BEFORE;
        }
        match output.views {
            Some(views) => loss + loss_against(views, targets.views),
            None => loss,
        }
    }

    /// Judges the network on the held-out pairs, always with the same noise, and keeps the weights if they are the best
    /// so far ([`CurvePoint::is_better_than`]).
    ///
    /// # Errors
    /// A pair cannot be loaded, or its figures cannot be computed.
    pub fn validate(&mut self) -> Result<CurvePoint, TrainError> {
        let network = self.network(Mode::Infer)?;
        let [rows, cols] = self.task.network.object;
        let examples = self.loader().examples(&self.held_out, VALIDATION)?;
        let (mut loss, mut psnr_db, mut ssim) = (0.0, 0.0, 0.0);
        let mut samples = Vec::new();
        for (example, &index) in examples.into_iter().zip(&self.held_out) {
            let target = example.target.clone();
            let Batch { inputs, targets } = Batch::of(vec![example]);
            let output = network.forward(inputs);
            let found = values(sigmoid(output.logits.clone()));
            loss += f64::from(self.loss(output, targets, Mode::Infer).into_scalar::<f32>());
            let view = |v| ArrayView2::from_shape((rows, cols), v);
            let (Ok(x), Ok(t)) = (view(&found), view(&target)) else {
                unreachable!("network and loader both give the pixels of the object")
            };
            let figures = compare(x, t).map_err(|source| TrainError::Source { index, source: source.into() })?;
            (psnr_db, ssim) = (psnr_db + figures.psnr_db, ssim + figures.ssim);
            // The cases of the checkpoint are the first of the held-out pairs.
            if let Some(case) = self.state.cases.get(samples.len()).filter(|_| samples.len() < SAMPLES) {
                let own = compare(x, case.truth.view());
                samples.push(scaled(&x.to_owned(), own.map_or(0.0, |figures| figures.scale)));
            }
        }
        let n = self.held_out.len() as f64;
        let RecentLoss { sum, steps } = std::mem::take(&mut self.recent);
        let body = &mut self.state.body;
        let train_loss = if steps > 0 { sum / steps as f64 } else { 0.0 };
        let [train_loss, validation_loss, psnr_db, ssim] =
            [train_loss, loss / n, psnr_db / n, ssim / n].map(|v| v as f32);
        let point = CurvePoint { step: body.step, train_loss, validation_loss, psnr_db, ssim };
        if body.curve.iter().all(|p| point.is_better_than(p, body.training.loss)) {
            body.best_step = body.step;
            self.state.weights = Tensors::clone(&self.state.current);
            self.state.samples = samples;
        }
        self.state.body.curve.push(point);
        Ok(point)
    }
}

/// The targets of a batch, each concatenated in C order.
#[derive(Clone)]
struct Targets {
    objects: Vec<f32>,
    /// Empty for networks that are not trained on views.
    views: Vec<f32>,
}

/// Inputs and targets of a batch.
struct Batch {
    inputs: Vec<NetworkInput>,
    targets: Targets,
}

impl Batch {
    fn of(examples: Vec<Example>) -> Self {
        let mut targets = Targets { objects: Vec::new(), views: Vec::new() };
        let mut inputs = Vec::new();
        for example in examples {
            targets.objects.extend(example.target);
            targets.views.extend(example.views.unwrap_or_default());
            inputs.push(example.input);
        }
        Self { inputs, targets }
    }
}

#[cfg(test)]
mod tests;
