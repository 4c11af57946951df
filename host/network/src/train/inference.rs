//! A network with a filter bank, for inference on the cores of this machine: in single precision, without burn's graph.

use super::network::{DIFFERENCE, Network, logit, values};
use super::normalise::DARK;
use super::ops::fourier::Fourier;
use super::ops::predicted::Linear;
use super::ops::stream::StreamedBank;
use super::weights::FILTERS;
use super::{Architecture, Enhancement, Estimator, Mode, NetworkConfig, Predictor, TrainError};
use ommatidia_physics::noise::NoiseModel;
use ommatidia_session::artifact::Tensors;
use rayon::prelude::*;
use std::sync::Arc;

/// Filter bank and enhancement network with their weights. Outputs agree with those of [`Network`] to some 1e-5.
pub struct Inference {
    bank: StreamedBank,
    /// One for each pass.
    enhancement: Vec<Enhancement>,
    predict: Option<Predictor>,
}

impl Inference {
    /// From the tensors of a checkpoint (all of [`super::weights::shapes`]); of any architecture but CM2Net, which has
    /// no filter bank.
    ///
    /// # Errors
    /// The configuration is not valid, the network is a CM2Net, or a parameter is missing or has the wrong shape.
    pub fn new(config: &NetworkConfig, tensors: &Tensors) -> Result<Self, TrainError> {
        config.check()?;
        let plan = Arc::new(Fourier::new(config.fourier()));
        let enhancement = match config.architecture {
            Architecture::Cm2Net { .. } => {
                let (expected, found) =
                    ("a network with filters".into(), config.architecture.name().as_str().to_string());
                return Err(TrainError::Config { field: "network", expected, found });
            }
            _ => (0..config.passes()).map(|pass| Enhancement::new(config, pass, tensors)).collect::<Result<_, _>>()?,
        };
        let stored = FILTERS.map(|name| tensors.get(name).filter(|t| t.len() == filter_len(config)));
        let filters = match stored.map(|t| t.and_then(|t| t.as_slice())) {
            [Some(re), Some(im)] => plan.filters(re, im),
            _ => {
                let [re, im] = Network::new(config, &plan, tensors, Mode::Infer)?.filters().map(values);
                plan.filters(&re, &im)
            }
        };
        Ok(Self { bank: StreamedBank::new(plan, filters), enhancement, predict: Predictor::of(config, tensors)? })
    }

    /// What finds the estimates that the network begins with, on a sensor with this noise; None for networks without.
    pub fn estimator(&self, config: &NetworkConfig, noise: &NoiseModel) -> Option<Estimator> {
        Estimator::of(config, self.predict.as_ref()?, noise)
    }

    /// The input of the enhancement network, [channels, object rows, object cols], of a normalised frame, [frame rows,
    /// frame cols]: the filter outputs divided by their maximum.
    pub fn enhancement_input(&self, frame: &[f32]) -> Vec<f32> {
        let mut seen = self.bank.apply(frame);
        let most = seen.par_iter().copied().reduce(|| f32::NEG_INFINITY, f32::max).max(DARK);
        seen.par_iter_mut().for_each(|v| *v /= most);
        seen
    }

    /// The reconstruction, [object rows, object cols], of a normalised frame, [frame rows, frame cols]. `estimate` is
    /// what the [`Estimator`](super::Estimator) of the network finds; empty for networks without.
    ///
    /// The result does not depend on the number of threads.
    pub fn reconstruct(&self, frame: &[f32], estimate: &[f32]) -> Vec<f32> {
        let mut seen = self.bank.apply(frame);
        let most = seen.par_iter().copied().reduce(|| f32::NEG_INFINITY, f32::max).max(DARK);
        let Some(predict) = &self.predict else {
            let mut out = self.enhancement[0].logits(seen, 1.0 / most);
            sigmoid(&mut out);
            return out;
        };
        seen.par_iter_mut().for_each(|v| *v /= most);
        let (mut logits, behind): (Vec<f32>, _) = match (self.enhancement.split_first(), estimate) {
            (Some((first, later)), []) => (first.logits(seen.clone(), 1.0), later),
            _ => (estimate.iter().copied().map(logit).collect(), &self.enhancement[..]),
        };
        for enhancement in behind {
            let mut x = logits.clone();
            sigmoid(&mut x);
            let mut input = difference(&seen, self.bank.apply(&predict.apply(&x)));
            input.extend(x);
            let change = enhancement.logits(input, 1.0);
            logits.iter_mut().zip(change).for_each(|(logit, change)| *logit += change);
        }
        sigmoid(&mut logits);
        logits
    }
}

fn sigmoid(values: &mut [f32]) {
    values.par_iter_mut().for_each(|v| *v = 1.0 / (1.0 + (-*v).exp()));
}

/// What the filter outputs of a frame hold beyond those that were predicted, as in the trained network. Sums run in one
/// order.
fn difference(seen: &[f32], mut predicted: Vec<f32>) -> Vec<f32> {
    let sum = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
    let scale = sum(seen, &predicted) / sum(&predicted, &predicted).max(f64::from(DARK));
    predicted.par_iter_mut().zip(seen).for_each(|(p, s)| *p = (*s - scale as f32 * *p) * DIFFERENCE);
    predicted
}

/// Number of values of the real or the imaginary parts of all filters.
fn filter_len(config: &NetworkConfig) -> usize {
    config.channels * config.filter_size * (config.filter_size / 2 + 1)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::{Lenses, NetworkInput, Preset, weights};
    use super::*;

    #[test]
    fn passes_give_what_the_graph_gives() {
        agrees([3, 0]);
    }

    #[test]
    fn passes_behind_an_estimate_give_what_the_graph_gives() {
        agrees([1, 4]);
        agrees([2, 4]);
    }

    fn agrees([passes, iterations]: [usize; 2]) {
        let lenses = Lenses::of(&ommatidia_model::testing::square_array(3, [40, 40], [16, 16])).unwrap();
        let config = lenses.with_feedback(Preset::Nano.network([40, 40], [16, 16]), [passes, iterations], 1);
        let mut tensors = weights::random(&config, 3);
        tensors.extend(lenses.feedback(config.feedback.as_ref().unwrap()));
        let tails = tensors.iter_mut().filter(|(name, _)| name.starts_with("pass") || iterations > 0);
        tails.for_each(|(_, t)| t.iter_mut().enumerate().for_each(|(i, v)| *v += ((i * 7) % 5) as f32 / 50.0 - 0.04));
        tensors.extend(lenses.feedback(config.feedback.as_ref().unwrap()));
        let frame: Vec<f32> = (0..1600).map(|i| ((i * 7919) % 1013) as f32 / 1013.0).collect();
        let estimate: Vec<f32> = (0..256).map(|i| ((i * 31) % 64) as f32 / 63.0).collect();
        let estimate = if iterations > 0 { estimate } else { Vec::new() };
        let plan = Arc::new(Fourier::new(config.fourier()));
        let graph = Network::new(&config, &plan, &tensors, Mode::Infer).unwrap();
        let input = NetworkInput::of(&config, &plan, &frame).with_estimate(estimate.clone());
        let output = graph.forward(vec![input]);
        assert_eq!(output.before.len(), passes - 1);
        let mut want = values(output.logits);
        let before = match output.before.into_iter().next() {
            Some(first) => values(first),
            None => estimate.iter().copied().map(logit).collect(),
        };
        assert!(before.iter().zip(&want).any(|(a, b)| (a - b).abs() > 0.1), "the last pass changes something");
        sigmoid(&mut want);
        let network = Inference::new(&config, &tensors).unwrap();
        let got = network.reconstruct(&frame, &estimate);
        let worst = got.iter().zip(&want).fold(0.0f32, |m, (a, b)| m.max((a - b).abs()));
        assert!(worst < 1e-5, "{worst}");
    }
}
