//! Real 2-D transforms in single precision.

use rustfft::num_complex::Complex32;
use rustfft::{Fft, FftPlanner};
use std::sync::Arc;

/// Real 2-D transforms of one side, half spectra as T rows of T/2+1; not scaled forward, by 1/T^2 inverse.
pub struct Plane {
    /// Side T.
    pub side: usize,
    forward: Arc<dyn Fft<f32>>,
    inverse: Arc<dyn Fft<f32>>,
}

impl Plane {
    /// Plans the transforms.
    pub fn new(side: usize) -> Self {
        let mut planner = FftPlanner::new();
        Self { side, forward: planner.plan_fft_forward(side), inverse: planner.plan_fft_inverse(side) }
    }

    /// The half spectrum of an image [T, T].
    pub fn forward(&self, image: &[f32]) -> Vec<Complex32> {
        let full = self.both(&self.forward, image.iter().map(|&v| Complex32::new(v, 0.0)).collect());
        full.chunks_exact(self.side).flat_map(|row| row[..self.side / 2 + 1].to_vec()).collect()
    }

    /// The image of a half spectrum.
    pub fn inverse(&self, spectrum: &[Complex32]) -> Vec<f32> {
        let (t, bins) = (self.side, self.side / 2 + 1);
        let at = |row: usize, col: usize| {
            if col < bins { spectrum[row * bins + col] } else { spectrum[(t - row) % t * bins + t - col].conj() }
        };
        let full = (0..t * t).map(|i| at(i / t, i % t)).collect();
        let scale = 1.0 / (t * t) as f32;
        self.both(&self.inverse, full).iter().map(|v| v.re * scale).collect()
    }

    /// Transforms along the rows, then along the columns.
    fn both(&self, fft: &Arc<dyn Fft<f32>>, mut plane: Vec<Complex32>) -> Vec<Complex32> {
        let t = self.side;
        for _ in 0..2 {
            fft.process(&mut plane);
            plane = (0..t * t).map(|i| plane[i % t * t + i / t]).collect();
        }
        plane
    }
}
