//! The optimiser: Adam (D. P. Kingma, J. Ba, arXiv:1412.6980, algorithm 1) on named arrays, with clipped gradients.

use super::weights::is_filter;
use ndarray::ArrayD;
use ommatidia_session::artifact::Tensors;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

const BETA_1: f64 = 0.9;
const BETA_2: f64 = 0.999;
const EPSILON: f64 = 1e-8;

/// Weight of one step in the running mean of a gradient's length.
const MEMORY: f64 = 0.02;

/// Groups of parameters, each with its own learning rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Group {
    /// The filters of the first layer.
    Filters,
    /// All other layers.
    Layers,
}

/// The group of the parameter with this name.
pub fn group(name: &str) -> Group {
    if is_filter(name) { Group::Filters } else { Group::Layers }
}

/// Running mean lengths of the gradients of the two groups; 0 before the first step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MeanNorms {
    /// Mean length of the gradient of the filters.
    pub filters: f32,
    /// Mean length of the gradient of the layers.
    pub layers: f32,
}

/// State of the optimiser.
#[derive(Clone, Debug, Default)]
pub struct Adam {
    /// Number of steps taken.
    pub steps: u64,
    /// First moments, by name.
    pub first: Tensors,
    /// Second moments, by name.
    pub second: Tensors,
    /// Mean lengths of past gradients.
    pub norms: MeanNorms,
}

impl Adam {
    /// The state before the first step on these parameters.
    pub fn new(parameters: &Tensors) -> Self {
        // Zeroed pages that were never written take no memory; at the paper's size each of the two would take 0.6 GB.
        let zeros = || parameters.iter().map(|(n, t)| (n.clone(), ArrayD::zeros(t.raw_dim()))).collect();
        Self { steps: 0, first: zeros(), second: zeros(), norms: MeanNorms::default() }
    }

    /// Shortens the gradient of each group to at most `clip` times the running mean of its length. The bound follows
    /// the gradients, because Adam's steps do not depend on their scale.
    pub fn clip(&mut self, gradients: &mut BTreeMap<String, Vec<f32>>, clip: f64) {
        for of in [Group::Filters, Group::Layers] {
            let members = || gradients.iter().filter(|(name, _)| group(name) == of);
            let norm = members().flat_map(|(_, g)| g).map(|&g| f64::from(g).powi(2)).sum::<f64>().sqrt();
            let mean = match of {
                Group::Filters => &mut self.norms.filters,
                Group::Layers => &mut self.norms.layers,
            };
            let past = f64::from(*mean);
            let limit = if past > 0.0 { clip * past } else { norm };
            if norm > limit {
                let scale = (limit / norm) as f32;
                gradients
                    .iter_mut()
                    .filter(|(n, _)| group(n) == of)
                    .for_each(|(_, g)| g.iter_mut().for_each(|g| *g *= scale));
            }
            let clipped = norm.min(limit);
            *mean = if past > 0.0 { (1.0 - MEMORY) * past + MEMORY * clipped } else { clipped } as f32;
        }
    }

    /// Takes one step on `parameters`, in place; `rate` returns the learning rate of each group.
    pub fn step(
        &mut self,
        parameters: &mut Tensors,
        gradients: &BTreeMap<String, Vec<f32>>,
        rate: impl Fn(Group) -> f64 + Sync,
    ) {
        self.steps += 1;
        let t = self.steps as f64;
        let (c1, c2) = (1.0 - BETA_1.powf(t), 1.0 - BETA_2.powf(t));
        let (b1, b2) = (BETA_1 as f32, BETA_2 as f32);
        // All three maps have the same names in the same order.
        let all = parameters.iter_mut().zip(self.first.values_mut()).zip(self.second.values_mut());
        all.collect::<Vec<_>>().into_par_iter().for_each(|(((name, p), m), v)| {
            let (Some(gradient), Some(p), Some(m), Some(v)) =
                (gradients.get(name), p.as_slice_mut(), m.as_slice_mut(), v.as_slice_mut())
            else {
                return;
            };
            let (scale, root, epsilon) = ((rate(group(name)) / c1) as f32, (1.0 / c2.sqrt()) as f32, EPSILON as f32);
            for (((p, m), v), &g) in p.iter_mut().zip(m).zip(v).zip(gradient) {
                *m = b1 * *m + (1.0 - b1) * g;
                *v = b2 * *v + (1.0 - b2) * g * g;
                *p -= scale * *m / (v.sqrt() * root + epsilon);
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::super::weights::FILTERS;
    use super::*;
    use burn_optim::{AdamConfig, Optimizer};
    use burn_tensor::{Device, Tensor, TensorData};
    use ndarray::arr1;

    /// The independent implementation of burn takes the same steps.
    #[test]
    fn steps_are_those_of_burn() {
        let device = Device::flex();
        let start = vec![0.5f32, -1.0, 2.0];
        let mut ours = Tensors::from([("a".to_string(), arr1(&start).into_dyn())]);
        let mut adam = Adam::new(&ours);
        let theirs = AdamConfig::new().with_epsilon(1e-8).build();
        let mut tensor = Tensor::<1>::from_data(TensorData::new(start, [3]), &device);
        let mut state = None;
        for step in 0..20 {
            let g: Vec<f32> = (0..3).map(|i| ((step * 7 + i * 3) as f32).sin() * 10f32.powi(i - 1)).collect();
            adam.step(&mut ours, &BTreeMap::from([("a".to_string(), g.clone())]), |_| 0.01);
            let gradient = Tensor::<1>::from_data(TensorData::new(g, [3]), &device);
            (tensor, state) = theirs.step(0.01, tensor, gradient, state);
        }
        let theirs = super::super::network::values(tensor);
        for (a, b) in ours["a"].iter().zip(theirs) {
            assert!((a - b).abs() < 1e-6, "{a} {b}");
        }
    }

    #[test]
    fn a_spike_is_shortened_and_the_rest_left_alone() {
        let mut adam = Adam::default();
        let gradient = |v: f32| BTreeMap::from([("a".to_string(), vec![v, 0.0]), (FILTERS[0].to_string(), vec![1.0])]);
        let mut usual = gradient(2.0);
        adam.clip(&mut usual, 5.0);
        assert_eq!(usual, gradient(2.0));
        let mut spike = gradient(1000.0);
        adam.clip(&mut spike, 5.0);
        assert!((spike["a"][0] - 10.0).abs() < 1e-4);
        assert_eq!(spike[FILTERS[0]], vec![1.0]);
    }
}
