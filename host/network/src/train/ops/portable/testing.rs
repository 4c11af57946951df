//! Compares two implementations of an operator.

#![allow(clippy::unwrap_used)]
use crate::train::network::values;
use burn_tensor::{Device, Tensor, TensorData};
use ommatidia_session::rng;
use rand::RngExt;

/// `n` numbers between -1 and 1.
pub fn draw(what: &str, n: usize) -> Vec<f32> {
    let mut rng = rng::stream(4, what, 0);
    (0..n).map(|_| rng.random_range(-1.0..1.0f32)).collect()
}

/// Asserts that values and gradients of both operators agree to 1e-5 of the largest value.
pub fn alike<const D: usize>(
    inputs: &[(&str, usize)],
    ours: impl Fn(&[Tensor<1>]) -> Tensor<D>,
    burns: impl Fn(&[Tensor<1>]) -> Tensor<D>,
) {
    let device = Device::flex().autodiff();
    let run = |op: &dyn Fn(&[Tensor<1>]) -> Tensor<D>| {
        let leaf = |(what, n): &(&str, usize)| {
            Tensor::<1>::from_data(TensorData::new(draw(what, *n), [*n]), &device).require_grad()
        };
        let leaves: Vec<Tensor<1>> = inputs.iter().map(leaf).collect();
        let y = op(&leaves);
        let weights = draw("weights", y.dims().iter().product());
        let weights = Tensor::<D>::from_data(TensorData::new(weights, y.dims()), &device);
        let mut gradients = (y.clone() * weights).sum().backward();
        let gradients = leaves.iter().map(|leaf| values(leaf.grad_remove(&mut gradients).unwrap()));
        std::iter::once(values(y.inner())).chain(gradients).collect::<Vec<_>>()
    };
    for (i, (a, b)) in run(&ours).iter().zip(run(&burns)).enumerate() {
        let most = a.iter().fold(0.0f32, |m, v| m.max(v.abs()));
        let apart = a.iter().zip(&b).fold(0.0f32, |m, (a, b)| m.max((a - b).abs()));
        assert!(most > 0.0 && apart < 1e-5 * most, "{i}: {apart} of {most}");
    }
}
