//! The losses of training: what is published, and what is judged.

use super::normalise::DARK;
use burn_tensor::Tensor;
use burn_tensor::activation::{relu, sigmoid};
use serde::{Deserialize, Serialize};

/// Least part of a target that is left.
const LEAST: f32 = 1e-6;

/// Loss of a training.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Loss {
    /// Binary cross entropy plus mean squared error, as in Yang et al. 2024. Scenes with much light count most.
    #[default]
    BceMse,
    /// The same plus the NRMSE of each scene with its best scale, by which scenes of few lit pixels count as much.
    BceMseNrmse,
}

impl Loss {
    /// The loss of logits against targets, both [batch, 1, rows, cols].
    pub fn of(self, logits: Tensor<4>, target: Tensor<4>) -> Tensor<1> {
        match self {
            Self::BceMse => bce_mse(logits, target),
            Self::BceMseNrmse => bce_mse(logits.clone(), target.clone()) + nrmse(logits, target),
        }
    }
}

/// Eq. 4-6 of Yang et al. 2024, `L = L_BCE + L_MSE`, each a mean over all pixels, of logits z against targets t in
/// [0, 1], both [batch, channels, rows, cols]; the reconstruction is sigmoid(z).
///
/// The cross entropy is computed from the logits, `max(z, 0) - z t + ln(1 + exp(-|z|))`, which cannot overflow. (Eq. 5
/// of the paper lacks a minus sign.)
///
/// ```
/// use burn_tensor::{Device, Tensor};
/// use ommatidia_network::train::bce_mse;
///
/// let device = Device::flex();
/// let (logits, target) = (Tensor::zeros([1, 1, 2, 2], &device), Tensor::ones([1, 1, 2, 2], &device));
/// // A logit of 0 is a reconstruction of 1/2: cross entropy ln 2, squared error 1/4.
/// let loss: f32 = bce_mse(logits, target).into_scalar();
/// assert!((loss - (2f32.ln() + 0.25)).abs() < 1e-6);
/// ```
pub fn bce_mse(logits: Tensor<4>, target: Tensor<4>) -> Tensor<1> {
    let softplus = relu(logits.clone()) + logits.clone().abs().neg().exp().log1p();
    let bce = (softplus - logits.clone() * target.clone()).mean();
    let error = sigmoid(logits) - target;
    bce + error.square().mean()
}

/// What is left of targets beside reconstructions with the scale that fits best, relative to the target, a mean over
/// the batch: `sqrt(1 - <x, t>^2 / (<x, x> <t, t>))`, the NRMSE of the figures of merit. Logits and targets as in
/// [`bce_mse`].
///
/// ```
/// use burn_tensor::{Device, Tensor};
/// use ommatidia_network::train::nrmse;
///
/// let device = Device::flex();
/// let target = Tensor::<4>::from_floats([[[[1.0, 0.0], [0.0, 0.0]]]], &device);
/// // Even reconstructions leave three quarters of the energy of one pixel of four, whatever their light.
/// for logit in [-2.0, 0.0, 2.0] {
///     let even = Tensor::full([1, 1, 2, 2], logit, &device);
///     let found: f32 = nrmse(even, target.clone()).into_scalar();
///     assert!((found - 0.75f32.sqrt()).abs() < 1e-6);
/// }
/// ```
pub fn nrmse(logits: Tensor<4>, target: Tensor<4>) -> Tensor<1> {
    let x = sigmoid(logits);
    let sum = |x: Tensor<4>| x.sum_dim(1).sum_dim(2).sum_dim(3);
    let energies = sum(x.clone().square()) * sum(target.clone().square());
    let explained = sum(x * target).square() / energies.clamp_min(DARK);
    // The root has no slope at 0.
    (explained.neg() + 1.0).clamp_min(LEAST).sqrt().mean()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use burn_tensor::{Device, TensorData};
    use ndarray::Array2;
    use ommatidia_model::metrics::compare;

    #[test]
    fn the_loss_is_its_definition() {
        let (z, t) = ([-30.0f32, -1.5, 0.0, 2.5], [0.0f32, 0.25, 1.0, 0.5]);
        let device = Device::flex();
        let tensor = |v: [f32; 4]| Tensor::<4>::from_data(TensorData::new(v.to_vec(), [1, 1, 2, 2]), &device);
        let found: f32 = bce_mse(tensor(z), tensor(t)).into_scalar();
        let mut expected = 0.0;
        for (z, t) in z.iter().zip(t).map(|(&z, t)| (f64::from(z), f64::from(t))) {
            let y = 1.0 / (1.0 + (-z).exp());
            expected -= t * y.ln() + (1.0 - t) * (1.0 - y).ln();
            expected += (t - y).powi(2);
        }
        assert!((f64::from(found) - expected / 4.0).abs() < 1e-6, "{found} {}", expected / 4.0);
    }

    /// The NRMSE of the loss is that of the figures of merit.
    #[test]
    fn the_nrmse_is_that_of_the_figures_of_merit() {
        let z = Array2::from_shape_fn((16, 16), |(r, c)| ((r * 7 + c * 5) % 13) as f32 / 2.0 - 3.0);
        let t = Array2::from_shape_fn((16, 16), |(r, c)| ((r * 3 + c * 11) % 17) as f32 / 16.0);
        let wanted = compare(z.mapv(|z| 1.0 / (1.0 + (-z).exp())).view(), t.view()).unwrap().nrmse;
        let device = Device::flex();
        let tensor = |v: &Array2<f32>| {
            let values: Vec<f32> = v.iter().copied().collect();
            Tensor::<4>::from_data(TensorData::new(values, [1, 1, 16, 16]), &device)
        };
        let found: f32 = nrmse(tensor(&z), tensor(&t)).into_scalar();
        assert!((f64::from(found) - wanted).abs() < 1e-6, "{found} {wanted}");
        let of = |loss: Loss| -> f32 { loss.of(tensor(&z), tensor(&t)).into_scalar() };
        assert!((of(Loss::BceMseNrmse) - of(Loss::BceMse) - found).abs() < 1e-6);
    }
}
