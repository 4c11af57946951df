//! Which region of a frame is reconstructed, and whether exactly.

use crate::metrics::psnr_db;
use half::f16;
use ommatidia_shared::image::Region;

/// Which region of each frame is reconstructed, and whether exactly.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Scope {
    /// Region of the object; `None`: the whole object.
    pub region: Option<Region>,
    /// Number of consecutive frames that may take the statistics of the field from an exact frame before them, which
    /// makes them approximate; 0: every frame is exact. See [`ommatidia_shared::pipeline::Field`].
    pub hold: u16,
}

impl From<Region> for Scope {
    /// Exactly this region.
    fn from(region: Region) -> Self {
        Self { region: Some(region), hold: 0 }
    }
}

/// Deviation of frames with held statistics from exact ones: PSNR, dB, against the exact region of the same frame. Each
/// frame has one free scale, since its brightness is on the scale of the frame whose statistics are held.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deviation {
    /// Of the mean, over the frames, of the squared error relative to the frame's peak.
    pub mean_db: f64,
    /// Of the worst frame.
    pub worst_db: f64,
}

impl Deviation {
    /// Of pairs (held, exact) of regions; `None` where there are none.
    pub fn of<'a>(pairs: impl Iterator<Item = (&'a [f16], &'a [f16])>) -> Option<Self> {
        let errors: Vec<f64> = pairs.map(|(held, exact)| relative_error(held, exact)).collect();
        let worst = errors.iter().copied().reduce(f64::max)?;
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        Some(Self { mean_db: psnr_db(1.0, mean), worst_db: psnr_db(1.0, worst) })
    }
}

/// Mean of `(s h - e)^2` over the square of the maximum of e; `s = <h, e> / <h, h>`. No sigmoid leaves a region of
/// zeros.
fn relative_error(held: &[f16], exact: &[f16]) -> f64 {
    let sum = |f: fn(f64, f64) -> f64| held.iter().zip(exact).map(|(h, e)| f(h.to_f64(), e.to_f64())).sum::<f64>();
    let scale = sum(|h, e| h * e) / sum(|h, _| h * h).max(f64::MIN_POSITIVE);
    let peak = exact.iter().fold(f64::MIN_POSITIVE, |peak, e| peak.max(e.to_f64()));
    let square = |(h, e): (&f16, &f16)| ((scale * h.to_f64() - e.to_f64()) / peak).powi(2);
    held.iter().zip(exact).map(square).sum::<f64>() / exact.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_deviation_is_that_of_the_worst_frame_and_of_the_mean_error() {
        let halves = |values: [f32; 4]| values.map(f16::from_f32);
        let exact = halves([0.0, 0.5, 0.0, 0.0]);
        // Twice as bright, and a quarter of the peak where nothing should be: s = 1/2 x 16/17.
        let off = halves([0.25, 1.0, 0.0, 0.0]);
        let pairs = [(&exact[..], &exact[..]), (&off[..], &exact[..])];
        let found = Deviation::of(pairs.into_iter()).unwrap();
        let error = ((4.0_f64 / 17.0).powi(2) + (1.0_f64 / 17.0).powi(2)) / 4.0;
        assert!((found.worst_db + 10.0 * error.log10()).abs() < 1e-9, "{found:?}");
        assert!((found.mean_db + 10.0 * (error / 2.0).log10()).abs() < 1e-9, "{found:?}");
        assert_eq!(Deviation::of(std::iter::empty()), None);
    }
}
