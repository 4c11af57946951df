//! Roundings of an integer network in the graph of a training, so that the network learns to bear them.
//!
//! Features and weights are rounded as a network in integers rounds them; gradients are those without rounding, and 0
//! for features that saturate (the straight-through estimator; Y. Bengio, N. Leonard, A. Courville, arXiv:1308.3432).

use super::feature_steps::{FeatureSteps, Features};
use burn_tensor::{Device, Tensor, TensorData};

/// Range of a feature of 8 bits.
const RANGE: [f32; 2] = [i8::MIN as f32, i8::MAX as f32];
/// Largest magnitude of a weight; -128 is not used.
pub const MOST_WEIGHT: f32 = 127.0;

/// The steps of a network with features of 8 bits, on a device.
pub struct Rounding {
    sums: Tensor<1>,
    inner: Vec<Tensor<1>>,
    fine: Tensor<1>,
}

impl Rounding {
    /// Roundings to multiples of these steps.
    pub fn new(steps: &FeatureSteps, device: &Device) -> Self {
        let tensor = |steps: &Vec<f32>| Tensor::from_data(TensorData::new(steps.clone(), [steps.len()]), device);
        let FeatureSteps { sums, inner, fine } = steps;
        Self { sums: tensor(sums), inner: inner.iter().map(tensor).collect(), fine: tensor(fine) }
    }

    fn of(&self, features: Features) -> Tensor<1> {
        match features {
            Features::Sums => self.sums.clone(),
            Features::Inner(block) => self.inner[block].clone(),
            Features::Fine => self.fine.clone(),
        }
    }

    /// Features, [batch, channels, rows, cols], as they are stored: to the nearest, halves up, saturated.
    pub fn features(&self, features: Features, x: Tensor<4>) -> Tensor<4> {
        let step = self.of(features);
        let step = step.clone().reshape([1, step.dims()[0], 1, 1]);
        let units = (x / step.clone()).clamp(RANGE[0], RANGE[1]);
        // The last half unit below the largest would round up beyond it.
        let nearest = (units.clone().detach() + 0.5).floor().clamp_max(RANGE[1]);
        straight_through(units, nearest) * step
    }

    /// Weights, [outputs * inputs * 9], of a convolution of these features with `outputs` outputs; None: of the
    /// network's input, whose channels have one unit.
    pub fn weights(&self, features: Option<Features>, weight: Tensor<1>, outputs: usize) -> Tensor<1> {
        let len = weight.dims()[0];
        let inputs = len / (9 * outputs);
        let weight = weight.reshape([outputs, inputs, 9]);
        let step = features.map(|features| self.of(features).reshape([1, inputs, 1]));
        let worth = match &step {
            Some(step) => weight * step.clone(),
            None => weight,
        };
        let largest = worth.clone().detach().reshape([outputs, inputs * 9]).abs().max_dim(1);
        let unit = (largest / MOST_WEIGHT).clamp_min(f32::MIN_POSITIVE.sqrt()).reshape([outputs, 1, 1]);
        let units = worth / unit.clone();
        let nearest = (units.clone().detach() + 0.5).floor();
        let rounded = straight_through(units, nearest) * unit;
        let rounded = match step {
            Some(step) => rounded / step,
            None => rounded,
        };
        rounded.reshape([len])
    }
}

/// `rounded`, with the gradient of `x`.
fn straight_through<const D: usize>(x: Tensor<D>, rounded: Tensor<D>) -> Tensor<D> {
    x.clone() + (rounded - x.detach())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::train::network::values;

    fn rounding(device: &Device) -> Rounding {
        let each = vec![0.5, 0.25];
        Rounding::new(&FeatureSteps { sums: each.clone(), inner: vec![each.clone()], fine: each }, device)
    }

    #[test]
    fn features_are_the_nearest_multiples_and_saturate() {
        let device = Device::flex().autodiff();
        let x = vec![0.2, 0.25, -0.25, 63.6, 64.0, -64.3, 0.1, 0.125, -0.125, 31.9, 500.0, -32.1];
        let x = Tensor::<4>::from_data(TensorData::new(x, [1, 2, 2, 3]), &device).require_grad();
        let y = rounding(&device).features(Features::Inner(0), x.clone());
        let expected = [0.0, 0.5, 0.0, 63.5, 63.5, -64.0, 0.0, 0.25, 0.0, 31.75, 31.75, -32.0];
        assert_eq!(values(y.clone().inner()), expected);
        // What saturates has no slope, everything else that of the identity.
        let mut gradients = y.sum().backward();
        let slopes = x.grad_remove(&mut gradients).map(values);
        let expected = [1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0];
        assert_eq!(slopes.as_deref(), Some(&expected[..]));
    }

    #[test]
    fn weights_are_multiples_of_a_unit_for_each_output_and_step() {
        let device = Device::flex().autodiff();
        // Two outputs of two inputs, whose steps are 1/2 and 1/4.
        let of = |i: usize| if i == 9 { 508.0 } else { ((i * 37) % 23) as f32 - 11.0 };
        let weight: Vec<f32> = (0..36).map(|i| of(i) / if i < 18 { 1.0 } else { 16.0 }).collect();
        let tensor = Tensor::<1>::from_data(TensorData::new(weight.clone(), [36]), &device).require_grad();
        let y = rounding(&device).weights(Some(Features::Sums), tensor.clone(), 2);
        let found = values(y.clone().inner());
        // The largest of the first output is worth 508 / 4 = 127, so its unit is 1: of the first input 2, of the second
        // one 4.
        let expected = |i: usize| {
            let unit = if i < 9 { 2.0 } else { 4.0 };
            unit * (weight[i] / unit + 0.5).floor()
        };
        assert!((0..18).all(|i| (found[i] - expected(i)).abs() < 1e-4), "{found:?}");
        let largest = (18..36).map(|i| weight[i].abs() * if i < 27 { 0.5 } else { 0.25 }).fold(0.0, f32::max);
        let near = |i: usize| (found[i] - weight[i]).abs() <= 0.501 * largest / 127.0 / if i < 27 { 0.5 } else { 0.25 };
        assert!((18..36).all(near), "{found:?}");
        let mut gradients = y.sum().backward();
        let slopes = tensor.grad_remove(&mut gradients).map(values).unwrap_or_default();
        assert!(slopes.len() == 36 && slopes.iter().all(|s| (s - 1.0).abs() < 1e-5), "{slopes:?}");
    }
}
