//! Power spectra by field radius: how well a method shows detail in the corner and in the centre.

use crate::fft2::RealFft2;
use crate::session::ObjectGrid;
use ndarray::{ArrayView2, s};
use rustfft::num_complex::Complex32;
use serde::{Deserialize, Serialize};

/// Side of the patches, object pixels, and number of rings of the field that they are averaged in.
const PATCH: usize = 24;
const RINGS: usize = 3;
/// Number of frequency bands between 0 and the Nyquist frequency.
const BANDS: usize = 8;

/// The spectra of one ring of the field.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RingSpectrum {
    /// Smallest distance of a patch's centre from the centre of the object, um.
    pub inner_um: f64,
    /// Largest distance, um.
    pub outer_um: f64,
    /// Centre of each band, periods per um.
    pub frequency_per_um: Vec<f64>,
    /// Power of the reconstructions relative to that of the truths.
    pub power_ratio: Vec<f64>,
    /// Correlation of reconstructions and truths in the band (Fourier ring correlation): 1 for correct detail, 0 for
    /// detail that is missing or not real.
    pub correlation: Vec<f64>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    x: f64,
    t: f64,
    xt: f64,
}

/// Sums of spectra, added frame by frame.
#[derive(Debug)]
pub struct Spectra {
    fft: RealFft2,
    window: Vec<f32>,
    patches: Vec<([usize; 2], usize)>,
    radius_um: f64,
    pixel_um: f64,
    sums: Vec<[Sums; BANDS]>,
}

impl Spectra {
    /// No frames yet, for objects of a grid.
    pub fn new(grid: &ObjectGrid) -> Self {
        let side = PATCH.min(grid.rows).min(grid.cols);
        let fft = RealFft2::new(side, side);
        let hann = |i: usize| 0.5 - 0.5 * (std::f32::consts::TAU * (i as f32 + 0.5) / side as f32).cos();
        let window = (0..side * side).map(|i| hann(i / side) * hann(i % side)).collect();
        let starts = |n: usize| (0..=n - side).step_by((side / 2).max(1)).collect::<Vec<_>>();
        let offset = |start: usize, n: usize| start as f64 + side as f64 / 2.0 - n as f64 / 2.0;
        let radius = |[r, c]: [usize; 2]| offset(r, grid.rows).hypot(offset(c, grid.cols)) * grid.pixel_um;
        let corners: Vec<[usize; 2]> =
            starts(grid.rows).into_iter().flat_map(|r| starts(grid.cols).into_iter().map(move |c| [r, c])).collect();
        let most = corners.iter().map(|c| radius(*c)).fold(f64::MIN_POSITIVE, f64::max);
        let ring = |c: [usize; 2]| ((radius(c) / most * RINGS as f64) as usize).min(RINGS - 1);
        Self {
            fft,
            window,
            patches: corners.into_iter().map(|c| (c, ring(c))).collect(),
            radius_um: most,
            pixel_um: grid.pixel_um,
            sums: vec![Default::default(); RINGS],
        }
    }

    /// Adds one frame: the reconstruction `x` times `scale`, and the truth, both [object rows, object cols] (the caller
    /// checks the shapes). Patches without light are left out.
    pub fn add(&mut self, x: ArrayView2<'_, f32>, truth: ArrayView2<'_, f32>, scale: f64) {
        let side = self.fft.shape()[0];
        for ([r, c], ring) in &self.patches {
            let part = s![*r..r + side, *c..c + side];
            if truth.slice(part).iter().all(|v| *v == 0.0) {
                continue;
            }
            let (x, t) = (self.spectrum(x.slice(part)), self.spectrum(truth.slice(part)));
            // The layout of spectra is [col frequency, row frequency].
            for (i, (x, t)) in x.iter().zip(&t).enumerate() {
                let (col, row) = (i / side, i % side);
                let frequency = (row.min(side - row) as f64).hypot(col as f64) / side as f64;
                let band = (frequency * 2.0 * BANDS as f64) as usize;
                if i > 0 && band < BANDS {
                    let (x, twice) = (x * scale as f32, if col == 0 || 2 * col == side { 1.0 } else { 2.0 });
                    let sums = &mut self.sums[*ring][band];
                    sums.x += twice * f64::from(x.norm_sqr());
                    sums.t += twice * f64::from(t.norm_sqr());
                    sums.xt += twice * f64::from((x * t.conj()).re);
                }
            }
        }
    }

    fn spectrum(&self, patch: ArrayView2<'_, f32>) -> Vec<Complex32> {
        let values: Vec<f32> = patch.iter().zip(&self.window).map(|(v, w)| v * w).collect();
        let mut out = vec![Complex32::default(); self.fft.spectrum_len()];
        self.fft.forward(&values, &mut out, &mut self.fft.scratch());
        out
    }

    /// The spectra of each ring that received light.
    pub fn figures(&self) -> Vec<RingSpectrum> {
        let width = self.radius_um / RINGS as f64;
        let safe = |a: f64, b: f64| if b > 0.0 { a / b } else { 0.0 };
        let ring = |(i, sums): (usize, &[Sums; BANDS])| RingSpectrum {
            inner_um: i as f64 * width,
            outer_um: (i + 1) as f64 * width,
            frequency_per_um: (0..BANDS).map(|b| (b as f64 + 0.5) / (2.0 * BANDS as f64) / self.pixel_um).collect(),
            power_ratio: sums.iter().map(|s| safe(s.x, s.t)).collect(),
            correlation: sums.iter().map(|s| safe(s.xt, (s.x * s.t).sqrt())).collect(),
        };
        let lit = |(_, sums): &(usize, &[Sums; BANDS])| sums.iter().any(|s| s.t > 0.0);
        self.sums.iter().enumerate().filter(lit).map(ring).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng;
    use ndarray::Array2;
    use rand::RngExt;

    const GRID: ObjectGrid = ObjectGrid { rows: 96, cols: 96, pixel_um: 2.0 };

    fn noise(index: u64) -> Array2<f32> {
        let mut draw = rng::stream(1, "spectrum", index);
        Array2::from_shape_fn((96, 96), |_| draw.random_range(0.0..1.0f32))
    }

    #[test]
    fn a_scaled_truth_is_perfect_and_noise_of_its_own_is_not() {
        let mut same = Spectra::new(&GRID);
        same.add((noise(1) * 3.0).view(), noise(1).view(), 1.0 / 3.0);
        let mut other = Spectra::new(&GRID);
        other.add(noise(2).view(), noise(1).view(), 1.0);
        assert_eq!(same.figures().len(), 3);
        for ring in same.figures() {
            assert!(ring.power_ratio.iter().chain(&ring.correlation).all(|v| (v - 1.0).abs() < 1e-4), "{ring:?}");
        }
        // The lowest band holds leakage of the mean.
        assert!(other.figures().iter().all(|r| r.correlation[2..].iter().all(|c| c.abs() < 0.2)));
    }

    /// White noise blurred by the mean of two neighbours along rows: power falls as `cos(pi f)^2`.
    #[test]
    fn power_is_that_of_the_transfer_function() {
        let mut spectra = Spectra::new(&GRID);
        for i in 0..20 {
            let t = noise(10 + i) - 0.5;
            let x = Array2::from_shape_fn((96, 96), |(r, c)| 0.5 * (t[[r, c]] + t[[r, (c + 1) % 96]]));
            spectra.add(x.view(), t.view(), 1.0);
        }
        for ring in spectra.figures() {
            for (f, p) in ring.frequency_per_um.iter().zip(&ring.power_ratio) {
                // Mean of cos(pi f cos a)^2 over directions a; f in periods a pixel.
                let mean: f64 = (0..360)
                    .map(|a| (std::f64::consts::PI * f * 2.0 * f64::from(a).to_radians().cos()).cos().powi(2) / 360.0)
                    .sum();
                assert!((p - mean).abs() < 0.07, "{f} {p} {mean}");
            }
        }
    }
}
