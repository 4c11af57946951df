//! The filter bank on frames that a low-rank operator predicts.

use super::super::fourier::Fourier;
use super::transform::{Parts, images, spectra, tensor};
use super::{centred, filter};
use burn_tensor::{Device, Tensor};
use std::sync::OnceLock;

/// The terms of a low-rank operator from objects to frames: each multiplies the object by a map, convolves it with a
/// kernel and adds it to the frame.
#[derive(Clone, Debug)]
pub struct Terms {
    /// Rows and columns of objects.
    pub object: [usize; 2],
    /// Rows and columns of frames.
    pub frame: [usize; 2],
    /// Side of the kernels, pixels; odd.
    pub window: usize,
    /// Frame pixel of object pixel (0, 0), of each term.
    pub corners: Vec<[isize; 2]>,
    /// Kernels, [term, window, window] in C order.
    pub kernels: Vec<f32>,
    /// Maps, [term, object row, object col] in C order.
    pub maps: Vec<f32>,
    /// The same on the device where they were used first.
    pub on_device: OnceLock<OnDevice>,
}

/// Constants on a device.
#[derive(Clone, Debug)]
pub struct OnDevice {
    /// Maps, [1, term, object row, object col].
    maps: Tensor<4>,
    /// Parts of the spectra of the kernels, each [1, term, T, T/2+1], where object pixel (0, 0) and the first pixel
    /// that any term reaches lie at (0, 0).
    kernels: [Tensor<4>; 2],
}

impl Terms {
    /// First frame pixel that light reaches, or 0, along an axis: 0 or less.
    fn first(&self, axis: usize) -> isize {
        let half = (self.window / 2) as isize;
        self.corners.iter().map(|c| c[axis] - half).min().unwrap_or(0).min(0)
    }

    /// Side of a transform that holds the frame and all light, so that nothing wraps around.
    fn side(&self) -> usize {
        let half = (self.window / 2) as isize;
        let one = |axis: usize| {
            let last = self.corners.iter().map(|c| c[axis] + half).max().unwrap_or(0) + self.object[axis] as isize;
            last.max(self.frame[axis] as isize).abs_diff(self.first(axis))
        };
        one(0).max(one(1))
    }

    fn on(&self, device: &Device) -> &OnDevice {
        self.on_device.get_or_init(|| {
            let ([rows, cols], n, t) = (self.object, self.corners.len(), self.side());
            let half = (self.window / 2) as isize;
            let spectrum = |(corner, kernel): (&[isize; 2], &[f32])| {
                let from = [0, 1].map(|a| (corner[a] - half).abs_diff(self.first(a)));
                spectra(tensor(kernel.to_vec(), [1, self.window, self.window], device), t, from)
            };
            let all = self.corners.iter().zip(self.kernels.chunks_exact(self.window * self.window)).map(spectrum);
            let (re, im): (Vec<_>, Vec<_>) = all.map(|[re, im]| (re, im)).unzip();
            OnDevice {
                maps: tensor(self.maps.clone(), [1, n, rows, cols], device),
                kernels: [re, im].map(|part| Tensor::cat(part, 0).reshape([1, n, t, t / 2 + 1])),
            }
        })
    }

    /// The frames of objects [batch, 1, object rows, object cols]: [batch, frame rows, frame cols].
    fn frames(&self, x: Tensor<4>) -> Tensor<3> {
        let OnDevice { maps, kernels: [kr, ki] } = self.on(&x.device()).clone();
        let ([rows, cols], n, t, b) = (self.object, self.corners.len(), self.side(), x.dims()[0]);
        let parts = spectra((x * maps).reshape([b * n, rows, cols]), t, [0, 0]);
        let [xr, xi] = parts.map(|part| part.reshape([b, n, t, t / 2 + 1]));
        let products = [xr.clone() * kr.clone() - xi.clone() * ki.clone(), xr * ki + xi * kr];
        let sums: Parts = products.map(|part| part.sum_dim(1).reshape([b, t, t / 2 + 1]));
        images(sums, [0, 1].map(|a| self.first(a).unsigned_abs()), self.frame)
    }
}

/// Computes [`super::super::predicted::filter_predicted`] on any device.
pub fn filter_predicted(plan: &Fourier, predict: &Terms, x: Tensor<4>, filters: [Tensor<1>; 2]) -> Tensor<4> {
    let sizes = plan.sizes();
    filter(plan, spectra(predict.frames(x), sizes.filter_size, centred(sizes.filter_size, sizes.frame)), filters)
}
