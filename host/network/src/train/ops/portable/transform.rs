//! Real transforms of T x T points, T of any length, as products with matrices of roots of unity.

use burn_tensor::{Device, Tensor, TensorData};
use std::ops::Range;

/// Real and imaginary parts of half spectra, each [n, T row frequencies, T/2+1 column frequencies].
pub type Parts = [Tensor<3>; 2];

/// Half spectra of images [n, rows, cols] whose first pixel lies at `from` in the transform, with zeros around them.
pub fn spectra(x: Tensor<3>, t: usize, from: [usize; 2]) -> Parts {
    let ([_, rows, cols], device) = (x.dims(), x.device());
    let down = |f| roots(f, t, 0..t, from[0]..from[0] + rows, &device);
    let across = |f| roots(f, t, from[1]..from[1] + cols, 0..t / 2 + 1, &device);
    // exp(-i a) = cos a - i sin a, along the columns and then along the rows.
    let (a, b) = (x.clone().matmul(across(f64::cos)), x.matmul(across(f64::sin)));
    let (cos, sin) = (down(f64::cos), down(f64::sin));
    let re = cos.clone().matmul(a.clone()) - sin.clone().matmul(b.clone());
    let im = (cos.matmul(b) + sin.matmul(a)).neg();
    [re, im]
}

/// The pixels of the inverse transforms of half spectra from `from` on: [n, rows, cols].
pub fn images([re, im]: Parts, from: [usize; 2], [rows, cols]: [usize; 2]) -> Tensor<3> {
    let ([_, t, bins], device) = (re.dims(), re.device());
    let down = |f| roots(f, t, from[0]..from[0] + rows, 0..t, &device);
    // Inner columns count twice: for themselves and for their mirror images.
    let weight = |k: usize| if k == 0 || 2 * k == t { 1.0 } else { 2.0 } / (t * t) as f32;
    let weights = tensor((0..bins).map(weight).collect(), [1, bins, 1], &device);
    let across = |f| roots(f, t, 0..bins, from[1]..from[1] + cols, &device) * weights.clone();
    let (cos, sin) = (down(f64::cos), down(f64::sin));
    let zr = cos.clone().matmul(re.clone()) - sin.clone().matmul(im.clone());
    let zi = cos.matmul(im) + sin.matmul(re);
    zr.matmul(across(f64::cos)) - zi.matmul(across(f64::sin))
}

/// `f(2 pi r c / t)` for the given rows r and columns c: [1, rows, cols].
fn roots(f: fn(f64) -> f64, t: usize, rows: Range<usize>, cols: Range<usize>, device: &Device) -> Tensor<3> {
    let table: Vec<f32> = (0..t).map(|i| f(std::f64::consts::TAU * i as f64 / t as f64) as f32).collect();
    let shape = [1, rows.len(), cols.len()];
    let values = rows.flat_map(|r| cols.clone().map(move |c| r * c % t)).map(|i| table[i]).collect();
    tensor(values, shape, device)
}

/// A constant.
pub fn tensor<const D: usize>(values: Vec<f32>, shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values, shape), &device.clone().inner())
}
