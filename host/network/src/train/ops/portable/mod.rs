//! The operators of [`super`] built from burn's own, for devices that our CPU operators do not support. Transforms are
//! products with matrices of roots of unity, computed only for the rows and columns of the object.

mod predicted;
mod transform;

pub use predicted::{Terms, filter_predicted};

use super::fourier::{Fourier, Spectrum};
use burn_tensor::Tensor;
use burn_tensor::module::conv2d;
use burn_tensor::ops::ConvOptions;
use transform::{Parts, images, spectra, tensor};

/// Computes [`super::conv3x3`] on any device.
pub fn conv3x3(x: Tensor<4>, weight: Tensor<1>, bias: Tensor<1>) -> Tensor<4> {
    let weight = weight.reshape([bias.dims()[0], x.dims()[1], 3, 3]);
    conv2d(x, weight, Some(bias), ConvOptions::new([1, 1], [1, 1], [1, 1], 1))
}

/// Computes [`super::filter_bank`] on any device.
pub fn filter_bank(plan: &Fourier, frames: &[Spectrum], re: Tensor<1>, im: Tensor<1>) -> Tensor<4> {
    let (t, b, device) = (plan.sizes().filter_size, frames.len(), re.device());
    // Spectra lie [col frequency, row frequency].
    let part = |part: fn(&rustfft::num_complex::Complex32) -> f32| {
        tensor(frames.iter().flatten().map(part).collect(), [b, t / 2 + 1, t], &device).swap_dims(1, 2)
    };
    filter(plan, [part(|v| v.re), part(|v| v.im)], [re, im])
}

/// The filters on frames with the given spectra [batch, T, T/2+1]: [batch, channels, object rows, object cols].
fn filter(plan: &Fourier, frames: Parts, filters: [Tensor<1>; 2]) -> Tensor<4> {
    let sizes = plan.sizes();
    let (t, c, b) = (sizes.filter_size, sizes.channels, frames[0].dims()[0]);
    let bins = t / 2 + 1;
    let [kr, ki] = filters.map(|part| part.reshape([1, c, t, bins]));
    let [xr, xi] = frames.map(|part| part.reshape([b, 1, t, bins]));
    let product = [xr.clone() * kr.clone() - xi.clone() * ki.clone(), xr * ki + xi * kr];
    let [rows, cols] = sizes.object;
    let y = images(product.map(|part| part.reshape([b * c, t, bins])), centred(t, sizes.object), sizes.object);
    y.reshape([b, c, rows, cols])
}

/// Where an image in the middle of a transform of `t` begins.
fn centred(t: usize, size: [usize; 2]) -> [usize; 2] {
    size.map(|side| (t - side) / 2)
}

/// Computes [`super::kernel_spectra`] on any device.
pub fn kernel_spectra(plan: &Fourier, h: Tensor<1>) -> [Tensor<1>; 2] {
    let (t, c) = (plan.sizes().filter_size, plan.sizes().channels);
    spectra(h.reshape([c, t, t]), t, [0, 0]).map(|part| part.reshape([c * t * (t / 2 + 1)]))
}

#[cfg(test)]
pub mod testing;
#[cfg(test)]
mod tests;
