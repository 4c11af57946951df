//! The operators of [`super`] built from burn's own, for devices that our CPU operators do not support. Transforms are
//! products with matrices of roots of unity, computed only for the rows and columns of the object.

use super::fourier::{Fourier, Spectrum};
use burn_tensor::module::conv2d;
use burn_tensor::ops::ConvOptions;
use burn_tensor::{Device, Tensor, TensorData};

/// Computes [`super::conv3x3`] on any device.
pub fn conv3x3(x: Tensor<4>, weight: Tensor<1>, bias: Tensor<1>) -> Tensor<4> {
    let weight = weight.reshape([bias.dims()[0], x.dims()[1], 3, 3]);
    conv2d(x, weight, Some(bias), ConvOptions::new([1, 1], [1, 1], [1, 1], 1))
}

/// Computes [`super::filter_bank`] on any device.
pub fn filter_bank(plan: &Fourier, spectra: &[Spectrum], re: Tensor<1>, im: Tensor<1>) -> Tensor<4> {
    let (sizes, device) = (plan.sizes(), re.device());
    let (t, c, b) = (sizes.filter_size, sizes.channels, spectra.len());
    let bins = t / 2 + 1;
    let filter = |part: Tensor<1>| part.reshape([1, c, t, bins]);
    // Spectra lie [col frequency, row frequency].
    let frames = |part: fn(&rustfft::num_complex::Complex32) -> f32| {
        let values: Vec<f32> = spectra.iter().flatten().map(part).collect();
        tensor(values, [b, bins, t], &device).swap_dims(1, 2).reshape([b, 1, t, bins])
    };
    let ([kr, ki], [xr, xi]) = ([filter(re), filter(im)], [frames(|v| v.re), frames(|v| v.im)]);
    let product = [xr.clone() * kr.clone() - xi.clone() * ki.clone(), xr * ki + xi * kr]
        .map(|part| part.reshape([b * c, t, bins]));
    let [rows, cols] = sizes.object;
    let from = |side: usize| (t - side) / 2;
    let root = |f: fn(f64) -> f64, r: usize, k: usize| f(std::f64::consts::TAU * (r * k % t) as f64 / t as f64);
    let down = |f: fn(f64) -> f64| {
        let values = (0..rows).flat_map(|r| (0..t).map(move |k| root(f, from(rows) + r, k) as f32));
        tensor(values.collect(), [1, rows, t], &device)
    };
    // Inner columns count twice: for themselves and for their mirror images.
    let weight = |k: usize| if k == 0 || 2 * k == t { 1.0 } else { 2.0 } / (t * t) as f64;
    let across = |f: fn(f64) -> f64| {
        let values = (0..bins).flat_map(|k| (0..cols).map(move |c| (weight(k) * root(f, from(cols) + c, k)) as f32));
        tensor(values.collect(), [1, bins, cols], &device)
    };
    let [pr, pi] = product;
    let (cos, sin) = (down(f64::cos), down(f64::sin));
    let zr = cos.clone().matmul(pr.clone()) - sin.clone().matmul(pi.clone());
    let zi = cos.matmul(pi) + sin.matmul(pr);
    let y = zr.matmul(across(f64::cos)) - zi.matmul(across(f64::sin));
    y.reshape([b, c, rows, cols])
}

/// Computes [`super::kernel_spectra`] on any device.
pub fn kernel_spectra(plan: &Fourier, h: Tensor<1>) -> [Tensor<1>; 2] {
    let (t, c, device) = (plan.sizes().filter_size, plan.sizes().channels, h.device());
    let bins = t / 2 + 1;
    let roots = |f: fn(f64) -> f64, cols: usize| {
        let root = |r: usize, k: usize| f(std::f64::consts::TAU * (r * k % t) as f64 / t as f64) as f32;
        tensor((0..t).flat_map(|r| (0..cols).map(move |k| root(r, k))).collect(), [1, t, cols], &device)
    };
    let h = h.reshape([c, t, t]);
    // exp(-i a) = cos a - i sin a, along the columns and then along the rows.
    let (a, b) = (h.clone().matmul(roots(f64::cos, bins)), h.matmul(roots(f64::sin, bins)));
    let (cos, sin) = (roots(f64::cos, t), roots(f64::sin, t));
    let re = cos.clone().matmul(a.clone()) - sin.clone().matmul(b.clone());
    let im = (cos.matmul(b) + sin.matmul(a)).neg();
    [re, im].map(|part| part.reshape([c * t * bins]))
}

fn tensor<const D: usize>(values: Vec<f32>, shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values, shape), device)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::fourier::FourierSizes;
    use super::*;
    use crate::train::network::values;
    use ommatidia_session::rng;
    use rand::RngExt;
    use std::sync::Arc;

    fn draw(what: &str, n: usize) -> Vec<f32> {
        let mut rng = rng::stream(4, what, 0);
        (0..n).map(|_| rng.random_range(-1.0..1.0f32)).collect()
    }

    /// Asserts that values and gradients of both operators agree to 1e-5 of the largest value.
    fn alike<const D: usize>(
        inputs: &[(&str, usize)],
        ours: impl Fn(&[Tensor<1>]) -> Tensor<D>,
        burns: impl Fn(&[Tensor<1>]) -> Tensor<D>,
    ) {
        let device = Device::flex().autodiff();
        let run = |op: &dyn Fn(&[Tensor<1>]) -> Tensor<D>| {
            let leaf = |(what, n): &(&str, usize)| tensor(draw(what, *n), [*n], &device).require_grad();
            let leaves: Vec<Tensor<1>> = inputs.iter().map(leaf).collect();
            let y = op(&leaves);
            let weights = tensor(draw("weights", y.dims().iter().product()), y.dims(), &device);
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

    #[test]
    fn convolutions_are_ours() {
        let shape = [2, 3, 6, 5];
        alike(
            &[("x", 180), ("weight", 4 * 3 * 9), ("bias", 4)],
            |l| super::super::conv3x3(l[0].clone().reshape(shape), l[1].clone(), l[2].clone()),
            |l| conv3x3(l[0].clone().reshape(shape), l[1].clone(), l[2].clone()),
        );
    }

    #[test]
    fn filters_are_ours() {
        for (t, frame, object) in [(16, [12, 13], [6, 8]), (15, [15, 9], [7, 4])] {
            let sizes = FourierSizes { frame, object, filter_size: t, channels: 3 };
            let plan = Arc::new(Fourier::new(sizes));
            let spectra = Arc::new(plan.spectra(&draw("frames", 2 * frame[0] * frame[1])));
            let n = 3 * t * (t / 2 + 1);
            alike(
                &[("re", n), ("im", n)],
                |l| super::super::filter_bank(&plan, Arc::clone(&spectra), l[0].clone(), l[1].clone()),
                |l| filter_bank(&plan, &spectra, l[0].clone(), l[1].clone()),
            );
            alike(
                &[("h", 3 * t * t)],
                |l| Tensor::cat(super::super::kernel_spectra(&plan, l[0].clone()).to_vec(), 0),
                |l| Tensor::cat(kernel_spectra(&plan, l[0].clone()).to_vec(), 0),
            );
        }
    }
}
