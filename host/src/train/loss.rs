//! The loss of training, Eq. 4-6 of Yang et al. 2024: binary cross entropy plus mean squared error, each a mean over
//! all pixels.

use burn::tensor::Tensor;
use burn::tensor::activation::{relu, sigmoid};

/// `L = L_BCE + L_MSE` of logits z against targets t in [0, 1], both [batch, channels, rows, cols]; the reconstruction
/// is sigmoid(z).
///
/// The cross entropy is computed from the logits, `max(z, 0) - z t + ln(1 + exp(-|z|))`, which cannot overflow. (Eq. 5
/// of the paper lacks a minus sign.)
///
/// ```
/// use burn::tensor::{Device, Tensor};
/// use ommatidia_host::train::bce_mse;
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

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::{Device, TensorData};

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
}
