//! The point-spread function of an aberrated pupil, by Fourier transform, integrated over pixels.

use super::error::OpticsError;
use super::zernike::{NOLL_COUNT, Wavefront, zernike};
use rustfft::num_complex::Complex32;
use rustfft::{Fft, FftPlanner};
use serde::{Deserialize, Serialize};
use std::f64::consts::{FRAC_PI_2, TAU};
use std::sync::Arc;

/// A circular pupil before a sensor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PupilConfig {
    /// Wavelength, um.
    pub wavelength_um: f64,
    /// Diameter of the pupil, um.
    pub aperture_um: f64,
    /// Distance from the pupil to the sensor, um.
    pub distance_um: f64,
    /// Share of the pupil radius over which the transmitted amplitude falls to zero, 0 (hard edge) to 1.
    pub soft_edge: f64,
    /// Pixel pitch, um.
    pub pixel_um: f64,
    /// Samples per pixel along each axis; odd, so that one sample lies on the centre of the pixel.
    pub oversampling: usize,
    /// Side of the computed field, pixels; odd. Light beyond it is folded back, so the field must hold the whole PSF.
    pub field_px: usize,
}

/// A planned pupil, which computes the PSF of any wavefront.
pub struct Pupil {
    config: PupilConfig,
    /// Samples per side of the field.
    n: usize,
    samples: Vec<Sample>,
    /// `zernikes[i * NOLL_COUNT + j]`: Z_(j+1) at sample i.
    zernikes: Vec<f32>,
    /// Mean slope of each Z_j over the light in the pupil, (row, col), waves per sample.
    slopes: [[f64; 2]; NOLL_COUNT],
    /// Rows of the pupil's grid that hold samples: (row, first sample, one past the last).
    rows: Vec<(usize, usize, usize)>,
    energy: f32,
    fft: Arc<dyn Fft<f32>>,
}

/// One sample of the pupil.
#[derive(Clone, Copy, Debug)]
struct Sample {
    /// Index along the rows and columns, zero at the centre of the pupil.
    at: [i32; 2],
    amplitude: f32,
}

/// Working memory of [`Pupil::psf`]; each thread needs its own.
#[derive(Clone, Debug)]
pub struct PsfScratch {
    field: Vec<Complex32>,
    column: Vec<Complex32>,
    fft: Vec<Complex32>,
    intensity: Vec<f32>,
}

/// A PSF on pixels, [side, side] in C order. The sum over the pixels is 1.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Psf {
    /// Side, pixels; odd.
    pub side: usize,
    /// Share of the light in each pixel.
    pub share: Vec<f32>,
}

impl std::fmt::Debug for Pupil {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Pupil").field("config", &self.config).field("samples", &self.samples.len()).finish()
    }
}

impl PupilConfig {
    /// Distance between neighbouring samples in the image, um.
    pub fn sample_um(&self) -> f64 {
        self.pixel_um / self.oversampling as f64
    }

    /// Plans the pupil.
    ///
    /// # Errors
    /// A length is not above zero, a count is not odd, `soft_edge` is not in 0 to 1, or the samples in the image are
    /// farther apart than `wavelength * distance / (2 aperture)`, the Nyquist limit of the field.
    pub fn build(&self) -> Result<Pupil, OpticsError> {
        for (field, value) in [
            ("wavelength_um", self.wavelength_um),
            ("aperture_um", self.aperture_um),
            ("distance_um", self.distance_um),
            ("pixel_um", self.pixel_um),
        ] {
            OpticsError::unless_positive(field, value)?;
        }
        for (field, value) in [("oversampling", self.oversampling), ("field_px", self.field_px)] {
            if value % 2 == 0 {
                return Err(OpticsError { field, expected: "an odd number".into(), found: value as f64 });
            }
        }
        if !(0.0..=1.0).contains(&self.soft_edge) {
            return Err(OpticsError { field: "soft_edge", expected: "0 to 1".into(), found: self.soft_edge });
        }
        let nyquist = self.wavelength_um * self.distance_um / (2.0 * self.aperture_um);
        if self.sample_um() > nyquist {
            let expected = format!("enough for samples of at most {nyquist:.3} um in the image");
            return Err(OpticsError { field: "oversampling", expected, found: self.oversampling as f64 });
        }
        Ok(Pupil::plan(*self))
    }
}

impl Pupil {
    fn plan(config: PupilConfig) -> Self {
        let n = config.field_px * config.oversampling;
        // Pupil and image samples are a Fourier pair: step_pupil * step_image = wavelength * distance / n.
        let step = config.wavelength_um * config.distance_um / (n as f64 * config.sample_um());
        let radius = config.aperture_um / 2.0;
        let reach = (radius / step).ceil() as i32 + 1;
        let (mut samples, mut zernikes, mut rows) = (Vec::new(), Vec::new(), Vec::new());
        for r in -reach..=reach {
            let first = samples.len();
            for c in -reach..=reach {
                let (y, x) = (f64::from(r) * step / radius, f64::from(c) * step / radius);
                let rho = y.hypot(x);
                let amplitude = amplitude(rho, config.soft_edge, step / radius) as f32;
                if amplitude > 0.0 {
                    samples.push(Sample { at: [r, c], amplitude });
                    let theta = y.atan2(x);
                    zernikes.extend((1..=NOLL_COUNT).map(|j| zernike(j, rho.min(1.0), theta) as f32));
                }
            }
            if samples.len() > first {
                rows.push((wrap(r, n), first, samples.len()));
            }
        }
        let slopes = std::array::from_fn(|j| mean_slope(j + 1, &samples, step / radius));
        let energy = samples.iter().map(|s| f64::from(s.amplitude).powi(2)).sum::<f64>();
        let energy = (energy * (n as f64).powi(2)) as f32;
        // Positive exponent: from the pupil to the image.
        let fft = FftPlanner::new().plan_fft_inverse(n);
        Self { config, n, samples, zernikes, slopes, rows, energy, fft }
    }

    /// Configuration of the pupil.
    pub fn config(&self) -> &PupilConfig {
        &self.config
    }

    /// Allocates working memory.
    pub fn scratch(&self) -> PsfScratch {
        let zero = Complex32::default();
        PsfScratch {
            field: vec![zero; self.n * self.rows.len()],
            column: vec![zero; self.n],
            fft: vec![zero; self.fft.get_inplace_scratch_len()],
            intensity: vec![0.0; self.n * self.n],
        }
    }

    /// Computes the PSF of a wavefront into `psf`, with its centroid at `centroid_px` (row, col) from the centre of the
    /// middle pixel.
    ///
    /// The shift is a tilt of the wavefront, so it is exact for any fraction of a pixel. Coma moves the centroid of a
    /// focus; this displacement is removed, so that the light of a source is centred on its chief ray. Piston and tilts
    /// of the wavefront have no effect. The sum over the pixels is 1 (Parseval's theorem).
    pub fn psf(&self, wavefront: &Wavefront, centroid_px: [f64; 2], scratch: &mut PsfScratch, psf: &mut Psf) {
        self.intensity(wavefront, centroid_px, scratch);
        let (side, over, n) = (self.config.field_px, self.config.oversampling, self.n);
        psf.side = side;
        psf.share.clear();
        psf.share.resize(side * side, 0.0);
        // The middle of the field is stored at index 0: pixel p covers `over` samples from -(n - 1) / 2 + p * over on.
        for k in 0..n {
            let row = &scratch.intensity[((k + n.div_ceil(2)) % n) * n..][..n];
            let pixels = &mut psf.share[(k / over) * side..][..side];
            for (j, pixel) in pixels.iter_mut().enumerate() {
                let first = (j * over + n.div_ceil(2)) % n;
                let sum: f32 = (0..over).map(|i| row[(first + i) % n]).sum();
                *pixel += sum;
            }
        }
    }

    /// Intensity on the fine grid, [n, n], with the middle of the field at index (0, 0), wrapped around; its sum is 1.
    ///
    /// With the pupil `A exp(2 pi i W)` the centroid of the image is `-n <A^2 dW/dm> / <A^2>` samples (the mean slope).
    fn intensity(&self, wavefront: &Wavefront, centroid_px: [f64; 2], scratch: &mut PsfScratch) {
        let n = self.n;
        let PsfScratch { field, column, fft, intensity } = scratch;
        let coefficients = wavefront.coefficient.map(|c| c as f32);
        let slope = |axis: usize| -> f64 {
            wavefront.coefficient.iter().zip(&self.slopes).map(|(c, slope)| c * slope[axis]).sum()
        };
        let tilt = [0, 1].map(|axis| centroid_px[axis] * self.config.oversampling as f64 / n as f64 + slope(axis));
        field.fill(Complex32::default());
        for (slot, &(_, first, last)) in self.rows.iter().enumerate() {
            for i in first..last {
                let s = self.samples[i];
                let z = &self.zernikes[i * NOLL_COUNT..][..NOLL_COUNT];
                let waves: f32 = z.iter().zip(&coefficients).map(|(z, c)| z * c).sum();
                let waves = f64::from(waves) - tilt[0] * f64::from(s.at[0]) - tilt[1] * f64::from(s.at[1]);
                let (sin, cos) = ((TAU * waves) as f32).sin_cos();
                field[slot * n + wrap(s.at[1], n)] = Complex32::new(s.amplitude * cos, s.amplitude * sin);
            }
            self.fft.process_with_scratch(&mut field[slot * n..][..n], fft);
        }
        for c in 0..n {
            column.fill(Complex32::default());
            for (slot, &(row, _, _)) in self.rows.iter().enumerate() {
                column[row] = field[slot * n + c];
            }
            self.fft.process_with_scratch(column, fft);
            for (r, v) in column.iter().enumerate() {
                intensity[r * n + c] = v.norm_sqr() / self.energy;
            }
        }
    }
}

/// Transmitted amplitude at radius `rho` (1 at the edge). At a hard edge, a sample of width `step` counts by its share
/// inside.
fn amplitude(rho: f64, soft_edge: f64, step: f64) -> f64 {
    let start = 1.0 - soft_edge;
    if soft_edge < step {
        return ((1.0 - rho) / step + 0.5).clamp(0.0, 1.0);
    }
    let t = ((rho - start) / soft_edge).clamp(0.0, 1.0);
    (FRAC_PI_2 * t).cos().powi(2).max(0.0) * if rho < 1.0 { 1.0 } else { 0.0 }
}

/// Mean slope of Z_j over the samples, weighted with their light, waves per sample; `step` is the distance between
/// samples, pupil radii.
fn mean_slope(j: usize, samples: &[Sample], step: f64) -> [f64; 2] {
    const H: f64 = 1e-4;
    let z = |y: f64, x: f64| zernike(j, y.hypot(x), y.atan2(x));
    let (mut sum, mut light) = ([0.0; 2], 0.0);
    for s in samples {
        let weight = f64::from(s.amplitude).powi(2);
        let [y, x] = s.at.map(|k| f64::from(k) * step);
        sum[0] += weight * (z(y + H, x) - z(y - H, x)) / (2.0 * H);
        sum[1] += weight * (z(y, x + H) - z(y, x - H)) / (2.0 * H);
        light += weight;
    }
    sum.map(|v| v * step / light)
}

fn wrap(index: i32, n: usize) -> usize {
    index.rem_euclid(n as i32) as usize
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    const CLEAR: PupilConfig = PupilConfig {
        wavelength_um: 0.5,
        aperture_um: 100.0,
        distance_um: 1000.0,
        soft_edge: 0.0,
        pixel_um: 0.5,
        oversampling: 1,
        field_px: 243,
    };

    /// Bessel function J_1 by its integral, (1/pi) int_0^pi cos(t - x sin t) dt.
    fn j1(x: f64) -> f64 {
        let n = 2000;
        let step = std::f64::consts::PI / f64::from(n);
        (0..n).map(|k| (f64::from(k) + 0.5) * step).map(|t| (t - x * t.sin()).cos()).sum::<f64>() / f64::from(n)
    }

    fn psf_of(config: &PupilConfig, wavefront: &Wavefront, shift: [f64; 2]) -> Psf {
        let pupil = config.build().unwrap();
        let mut psf = Psf::default();
        pupil.psf(wavefront, shift, &mut pupil.scratch(), &mut psf);
        psf
    }

    fn centroid(psf: &Psf) -> [f64; 2] {
        let total: f64 = psf.share.iter().map(|v| f64::from(*v)).sum();
        let mean = |f: &dyn Fn(usize) -> usize| {
            psf.share.iter().enumerate().map(|(i, v)| f(i) as f64 * f64::from(*v)).sum::<f64>() / total
        };
        [mean(&|i| i / psf.side), mean(&|i| i % psf.side)].map(|m| m - (psf.side / 2) as f64)
    }

    #[test]
    fn a_clear_circular_pupil_gives_the_airy_pattern() {
        // I(r) / I(0) = (2 J_1(v) / v)^2, v = pi D r / (wavelength distance); one sample a pixel, so no integration.
        let psf = psf_of(&CLEAR, &Wavefront::default(), [0.0, 0.0]);
        let middle = psf.side / 2;
        let peak = f64::from(psf.share[middle * psf.side + middle]);
        for k in 1..40usize {
            let v = std::f64::consts::PI * CLEAR.aperture_um * k as f64 * CLEAR.pixel_um
                / (CLEAR.wavelength_um * CLEAR.distance_um);
            let airy = (2.0 * j1(v) / v).powi(2);
            for at in [middle * psf.side + middle + k, (middle + k) * psf.side + middle] {
                let found = f64::from(psf.share[at]) / peak;
                assert!((found - airy).abs() < 2e-3, "{k}: {found} {airy}");
            }
        }
        // First dark ring at 1.22 wavelength * distance / D = 6.1 um = 12.2 samples.
        assert!(f64::from(psf.share[middle * psf.side + middle + 12]) / peak < 1e-3);
    }

    #[test]
    fn no_light_is_lost_or_gained() {
        let mut wavefront = Wavefront::default();
        wavefront.coefficient[3..].copy_from_slice(&[0.2, -0.1, 0.15, 0.1, -0.2, 0.05, 0.0, 0.1]);
        for (soft_edge, oversampling) in [(0.0, 1), (0.5, 3), (1.0, 5)] {
            let config = PupilConfig { soft_edge, oversampling, pixel_um: 1.5, field_px: 63, ..CLEAR };
            let psf = psf_of(&config, &wavefront, [0.3, -0.4]);
            let total: f64 = psf.share.iter().map(|v| f64::from(*v)).sum();
            assert!((total - 1.0).abs() < 1e-5, "{total}");
        }
    }

    #[test]
    fn the_light_is_centred_at_the_given_place_for_any_aberrations() {
        let config = PupilConfig { soft_edge: 0.6, oversampling: 3, pixel_um: 1.5, field_px: 127, ..CLEAR };
        let mut coma = Wavefront::default();
        coma.coefficient[3..].copy_from_slice(&[0.1, 0.05, -0.1, 0.2, -0.1, 0.05, 0.0, 0.05]);
        // Tilts are removed.
        coma.coefficient[1] = 0.7;
        for shift in [[0.0, 0.0], [0.5, 0.0], [-0.27, 0.41], [3.0, -2.6]] {
            let found = centroid(&psf_of(&config, &coma, shift));
            for axis in 0..2 {
                assert!((found[axis] - shift[axis]).abs() < 1e-3, "{shift:?}: {found:?}");
            }
        }
        // A whole pixel moves the samples themselves.
        let (a, b) = (psf_of(&config, &coma, [0.0, 0.0]), psf_of(&config, &coma, [1.0, 0.0]));
        let peak = a.share.iter().fold(0.0f32, |m, v| m.max(*v));
        for i in 0..a.share.len() - a.side {
            assert!((a.share[i] - b.share[i + a.side]).abs() < 1e-4 * peak);
        }
    }

    #[test]
    fn pixels_integrate_the_intensity() {
        // Three samples a pixel against fifteen: the midpoint rule has converged.
        let config = |oversampling| PupilConfig { soft_edge: 0.6, oversampling, pixel_um: 1.5, field_px: 31, ..CLEAR };
        let (coarse, fine) = (
            psf_of(&config(3), &Wavefront::default(), [0.2, 0.1]),
            psf_of(&config(15), &Wavefront::default(), [0.2, 0.1]),
        );
        let peak = fine.share.iter().fold(0.0f32, |m, v| m.max(*v));
        let worst = coarse.share.iter().zip(&fine.share).fold(0.0f32, |m, (a, b)| m.max((a - b).abs()));
        assert!(worst < 0.01 * peak, "{}", worst / peak);
    }

    #[test]
    fn impossible_pupils_are_refused() {
        for (config, field) in [
            (PupilConfig { wavelength_um: 0.0, ..CLEAR }, "wavelength_um"),
            (PupilConfig { oversampling: 2, ..CLEAR }, "oversampling"),
            (PupilConfig { field_px: 40, ..CLEAR }, "field_px"),
            (PupilConfig { soft_edge: 1.5, ..CLEAR }, "soft_edge"),
            (PupilConfig { pixel_um: 5.0, ..CLEAR }, "oversampling"),
        ] {
            assert_eq!(config.build().unwrap_err().field, field);
        }
    }
}
