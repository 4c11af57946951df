//! Draws mixed Poisson-Gaussian noise, fast enough for new noise in each training step.
//!
//! Below [`NORMAL_ABOVE_E`] electrons, counts are drawn from the Poisson distribution by inversion. Above, they are
//! normal variates with the first three cumulants of the Poisson distribution, `n + sqrt(n) z + (z^2 - 1) / 6`
//! (Cornish-Fisher expansion), rounded to whole electrons and never negative. The mean is exact, the variance to a
//! relative 1/(18 n), and the skewness to first order.

use rand::Rng;

/// Number of expected electrons from which the normal approximation is used.
pub const NORMAL_ABOVE_E: f32 = 30.0;

/// A uniform number in (0, 1) from the high bits of one word.
fn uniform(rng: &mut impl Rng) -> f32 {
    ((rng.next_u32() >> 8) as f32 + 0.5) * (1.0 / 16_777_216.0)
}

/// Normal variates by the Box-Muller transform, which yields two at a time.
struct Normals {
    spare: Option<f32>,
}

impl Normals {
    fn next(&mut self, rng: &mut impl Rng) -> f32 {
        if let Some(z) = self.spare.take() {
            return z;
        }
        let radius = (-2.0 * uniform(rng).ln()).sqrt();
        let (sin, cos) = (std::f32::consts::TAU * uniform(rng)).sin_cos();
        self.spare = Some(radius * sin);
        radius * cos
    }
}

/// Replaces each expected number of electrons by a Poisson count. Negative expectations count as zero.
pub fn draw_poisson(electrons: &mut [f32], rng: &mut impl Rng) {
    let mut normals = Normals { spare: None };
    for e in electrons {
        *e = poisson(*e, &mut normals, rng);
    }
}

/// Replaces each expected number of electrons by a Poisson count plus normal read noise of `read_noise_e` electrons
/// rms.
pub fn draw_electrons(electrons: &mut [f32], read_noise_e: f32, rng: &mut impl Rng) {
    let mut normals = Normals { spare: None };
    for e in electrons {
        *e = poisson(*e, &mut normals, rng) + read_noise_e * normals.next(rng);
    }
}

fn poisson(mean: f32, normals: &mut Normals, rng: &mut impl Rng) -> f32 {
    if mean >= NORMAL_ABOVE_E {
        let z = normals.next(rng);
        return (mean + mean.sqrt() * z + (z * z - 1.0) / 6.0).round().max(0.0);
    }
    if mean <= 0.0 {
        return 0.0;
    }
    // Inversion: walk up the distribution function. It takes a few dozen steps at most.
    let mut left = uniform(rng);
    let mut term = (-mean).exp();
    let mut count = 0.0;
    while left > term && count < 200.0 {
        left -= term;
        count += 1.0;
        term *= mean / count;
    }
    count
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::rng::stream;

    fn cumulants(values: &[f32]) -> [f64; 3] {
        let n = values.len() as f64;
        let mean = values.iter().map(|v| f64::from(*v)).sum::<f64>() / n;
        let moment = |p| values.iter().map(|v| (f64::from(*v) - mean).powi(p)).sum::<f64>() / n;
        [mean, moment(2), moment(3)]
    }

    #[test]
    fn counts_have_the_cumulants_of_the_poisson_law() {
        for mean in [0.2f32, 3.0, 29.0, 31.0, 500.0] {
            let mut e = vec![mean; 200_000];
            draw_poisson(&mut e, &mut stream(3, "poisson", mean as u64));
            assert!(e.iter().all(|v| *v >= 0.0 && v.fract() == 0.0));
            let m = f64::from(mean);
            let n = e.len() as f64;
            let [k1, k2, k3] = cumulants(&e);
            // Five standard errors of each cumulant; rounding adds 1/12 to the variance of the normal approximation.
            assert!((k1 - m).abs() < 5.0 * (m / n).sqrt(), "{mean}: {k1}");
            assert!((k2 - m).abs() < 5.0 * ((2.0 * m * m + m) / n).sqrt() + 1.0 / 12.0 + 1.0 / 18.0, "{mean}: {k2}");
            assert!((k3 - m).abs() < 5.0 * ((6.0 * m.powi(3) + 20.0 * m * m + m) / n).sqrt() + 0.1 * m, "{mean}: {k3}");
        }
    }

    #[test]
    fn reading_adds_its_variance_and_nothing_is_drawn_from_nothing() {
        let mut e = vec![4.0f32; 200_000];
        draw_electrons(&mut e, 2.0, &mut stream(4, "read", 0));
        let [mean, var, _] = cumulants(&e);
        assert!((mean - 4.0).abs() < 0.03 && (var - 8.0).abs() < 0.15, "{mean} {var}");
        let mut none = vec![0.0f32, -3.0];
        draw_electrons(&mut none, 0.0, &mut stream(4, "read", 1));
        assert_eq!(none, [0.0, 0.0]);
    }
}
