//! A first estimate of the object, for networks that begin with one.

use super::{NetworkConfig, Predictor};
use ndarray::ArrayView2;
use ommatidia_model::richardson_lucy::RichardsonLucy;
use ommatidia_physics::noise::NoiseModel;
use std::sync::Arc;

/// Accelerated Richardson-Lucy iterations with the short low-rank model of the calibrated PSFs.
#[derive(Clone, Debug)]
pub struct Estimator {
    solver: RichardsonLucy,
    iterations: usize,
}

impl Estimator {
    /// The estimator of a network with this predictor and the noise of its sensor; None for a network that begins
    /// without an estimate.
    pub fn of(config: &NetworkConfig, predictor: &Predictor, noise: &NoiseModel) -> Option<Self> {
        let iterations = Some(config.iterations()).filter(|n| *n > 0)?;
        let solver = RichardsonLucy::new(Arc::clone(predictor.operator()), noise);
        let solver = solver.unwrap_or_else(|_| unreachable!("a frame of the operator's own shape fits it"));
        Some(Self { solver, iterations })
    }

    /// What the iterations find in the corrected light of a frame, DN above black, [frame rows, frame cols]: divided by
    /// its maximum, [object rows * object cols].
    pub fn estimate(&self, light_dn: ArrayView2<'_, f32>) -> Vec<f32> {
        let found = self.solver.accelerated(light_dn, self.iterations);
        let found = found.unwrap_or_else(|_| unreachable!("frames have the shape of the network"));
        let most = found.iter().copied().fold(f32::MIN_POSITIVE, f32::max);
        found.into_iter().map(|v| v / most).collect()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::{Lenses, Preset};
    use super::*;
    use ndarray::Array2;
    use ommatidia_model::forward::Forward;

    #[test]
    fn estimates_are_near_the_object_and_between_0_and_1() {
        let instrument = ommatidia_model::testing::square_array(3, [60, 60], [20, 20]);
        let lenses = Lenses::of(&instrument).unwrap();
        let plain = Preset::Nano.network([60, 60], [20, 20]);
        let network = lenses.with_feedback(plain.clone(), [1, 10], 1);
        let tensors = lenses.feedback(network.feedback.as_ref().unwrap());
        let predictor = Predictor::of(&network, &tensors).unwrap().unwrap();
        let estimator = Estimator::of(&network, &predictor, &instrument.noise).unwrap();
        let object = Array2::from_shape_fn((20, 20), |(r, c)| if (r * 7 + c * 3) % 11 == 0 { 1.0 } else { 0.1 });
        let light = Forward::new(&instrument).unwrap().operator().apply(object.view()).unwrap() * 2000.0;
        let found = estimator.estimate(light.view());
        let worst = found.iter().zip(&object).fold(0.0f32, |m, (a, b)| m.max((a - b).abs()));
        assert!(worst < 0.02, "{worst}");
        for frame in [0.0, -3.0] {
            let dark = estimator.estimate(Array2::from_elem((60, 60), frame).view());
            assert!(dark.iter().all(|v| (0.0..=1.0).contains(v)));
        }
        let without = [plain.clone(), lenses.with_feedback(plain, [2, 0], 1)];
        assert!(without.iter().all(|network| Estimator::of(network, &predictor, &instrument.noise).is_none()));
    }
}
