//! Input of a network's first layer.

use super::ops::fourier::{Fourier, Spectrum};
use super::{Architecture, NetworkConfig};
use rustfft::num_complex::Complex32;

/// A normalised frame in the form that the first layer of a network takes.
#[derive(Clone, Debug, PartialEq)]
pub enum NetworkInput {
    /// For a filter bank.
    Spectrum {
        /// Spectrum of the padded frame.
        spectrum: Spectrum,
        /// What an [`Estimator`](super::Estimator) finds, [object rows * object cols]; empty for networks without.
        estimate: Vec<f32>,
    },
    /// Crops of the views of the living lenses, for a CM2Net, [lens, object rows, object cols]; 0 off the sensor.
    Crops(Vec<f32>),
}

impl NetworkInput {
    /// The input for `network` from a normalised frame `x` in C order, [frame rows * frame cols].
    pub fn of(network: &NetworkConfig, plan: &Fourier, x: &[f32]) -> Self {
        match &network.architecture {
            Architecture::Cm2Net { crops } => Self::Crops(cut(x, network, crops)),
            _ => Self::Spectrum { spectrum: plan.rfft2(x, network.frame), estimate: Vec::new() },
        }
    }

    /// The same input with what an [`Estimator`](super::Estimator) found.
    #[must_use]
    pub fn with_estimate(self, found: Vec<f32>) -> Self {
        match self {
            Self::Spectrum { spectrum, .. } => Self::Spectrum { spectrum, estimate: found },
            crops @ Self::Crops(_) => crops,
        }
    }

    /// The spectrum; empty for crops.
    pub fn spectrum(&self) -> &[Complex32] {
        match self {
            Self::Spectrum { spectrum, .. } => spectrum,
            Self::Crops(_) => &[],
        }
    }
}

/// The crops of a frame.
fn cut(x: &[f32], network: &NetworkConfig, crops: &[[i32; 2]]) -> Vec<f32> {
    let ([rows, cols], [height, width]) = (network.frame.map(|n| n as i32), network.object.map(|n| n as i32));
    let mut out = Vec::with_capacity(crops.len() * (height * width) as usize);
    for [top, left] in crops {
        for (r, c) in (*top..top + height).flat_map(|r| (*left..left + width).map(move |c| (r, c))) {
            let inside = (0..rows).contains(&r) && (0..cols).contains(&c);
            out.push(if inside { x[(r * cols + c) as usize] } else { 0.0 });
        }
    }
    out
}

/// The transpose of cropping: adds the values of the views, [lens, object rows, object cols], to a frame of zeros.
pub fn paste(views: &[f32], network: &NetworkConfig, crops: &[[i32; 2]]) -> Vec<f32> {
    let ([rows, cols], [height, width]) = (network.frame.map(|n| n as i32), network.object.map(|n| n as i32));
    let mut out = vec![0.0; (rows * cols) as usize];
    let mut views = views.iter();
    for [top, left] in crops {
        for (r, c) in (*top..top + height).flat_map(|r| (*left..left + width).map(move |c| (r, c))) {
            let value = views.next().copied().unwrap_or(0.0);
            if (0..rows).contains(&r) && (0..cols).contains(&c) {
                out[(r * cols + c) as usize] += value;
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::train::Preset;

    #[test]
    fn pasting_is_the_transpose_of_cutting() {
        let network = NetworkConfig { channels: 2, ..Preset::Nano.network([9, 11], [4, 6]) };
        let crops = [[-2, 3], [6, 7]];
        let x: Vec<f32> = (0..99).map(|i| ((i * 37) % 23) as f32 - 11.0).collect();
        let y: Vec<f32> = (0..48).map(|i| ((i * 29) % 19) as f32 - 9.0).collect();
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>();
        assert_eq!(dot(&cut(&x, &network, &crops), &y), dot(&x, &paste(&y, &network, &crops)));
        assert_eq!(cut(&x, &network, &crops)[2 * 6 + 1], x[4]);
    }
}
