//! Zernike polynomials on the unit disc, in the order and normalisation of Noll (J. Opt. Soc. Am. 66, 207, 1976).

/// Number of polynomials in a [`Wavefront`]: piston to primary spherical aberration.
pub const NOLL_COUNT: usize = 11;

/// A wavefront error as coefficients of Noll's Z_1 to Z_11: piston, two tilts, defocus, two astigmatisms, two comas,
/// two trefoils, primary spherical aberration.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wavefront {
    /// Coefficients, waves rms; `coefficient[0]` belongs to Z_1.
    pub coefficient: [f64; NOLL_COUNT],
}

impl Wavefront {
    /// Rms wavefront error without piston and tilts, waves (the polynomials are orthonormal).
    pub fn rms_waves(&self) -> f64 {
        self.coefficient[3..].iter().map(|c| c * c).sum::<f64>().sqrt()
    }
}

/// Radial degree n and azimuthal degree m, as (n, m), of Noll's index j >= 1; m < 0 for the sine terms.
pub fn noll(j: usize) -> (u32, i32) {
    let mut n = 0;
    let mut left = j.max(1) - 1;
    while left > n {
        n += 1;
        left -= n;
    }
    // Within degree n, |m| ascends in steps of two: 0 2 2 4 4 ... or 1 1 3 3 ...
    let m = (n % 2) + 2 * ((left + (n + 1) % 2) / 2);
    let sign = if m == 0 || j.is_multiple_of(2) { 1 } else { -1 };
    (n as u32, sign * m as i32)
}

/// Noll's Z_j at the polar coordinates (rho, theta) of the unit disc, with theta in rad from the column axis to the row
/// axis. Its rms over the disc is 1.
pub fn zernike(j: usize, rho: f64, theta: f64) -> f64 {
    let (n, m) = noll(j);
    let k = m.unsigned_abs();
    let radial = radial(n, k, rho);
    let norm = f64::from(n + 1).sqrt();
    match m {
        0 => norm * radial,
        m if m > 0 => norm * std::f64::consts::SQRT_2 * radial * (f64::from(k) * theta).cos(),
        _ => norm * std::f64::consts::SQRT_2 * radial * (f64::from(k) * theta).sin(),
    }
}

/// Radial polynomial R_n^m (Noll's Eq. 2).
fn radial(n: u32, m: u32, rho: f64) -> f64 {
    let factorial = |k: u32| (1..=k).map(f64::from).product::<f64>();
    (0..=(n - m) / 2)
        .map(|s| {
            let sign = if s % 2 == 0 { 1.0 } else { -1.0 };
            let denominator = factorial(s) * factorial((n + m) / 2 - s) * factorial((n - m) / 2 - s);
            sign * factorial(n - s) / denominator * rho.powi((n - 2 * s) as i32)
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{PI, TAU};

    #[test]
    fn the_order_is_nolls() {
        // Table I of Noll's paper.
        let table = [(0, 0), (1, 1), (1, -1), (2, 0), (2, -2), (2, 2), (3, -1), (3, 1), (3, -3), (3, 3), (4, 0)];
        for (j, expected) in table.into_iter().enumerate() {
            assert_eq!(noll(j + 1), expected, "Z_{}", j + 1);
        }
        assert_eq!([noll(12), noll(13), noll(14), noll(15)], [(4, 2), (4, -2), (4, 4), (4, -4)]);
    }

    #[test]
    fn closed_forms() {
        let (rho, theta) = (0.7f64, 0.4f64);
        let cases = [
            (4, 3f64.sqrt() * (2.0 * rho * rho - 1.0)),
            (5, 6f64.sqrt() * rho * rho * (2.0 * theta).sin()),
            (8, 8f64.sqrt() * (3.0 * rho.powi(3) - 2.0 * rho) * theta.cos()),
            (11, 5f64.sqrt() * (6.0 * rho.powi(4) - 6.0 * rho * rho + 1.0)),
        ];
        for (j, expected) in cases {
            assert!((zernike(j, rho, theta) - expected).abs() < 1e-12, "Z_{j}");
        }
    }

    #[test]
    fn they_are_orthonormal_over_the_disc() {
        // Midpoint rule in rho^2 (even weight on the disc) and theta, exact in theta.
        let (nr, nt) = (4000, 32);
        for i in 1..=NOLL_COUNT {
            for j in 1..=i {
                let mut sum = 0.0;
                for r in 0..nr {
                    let rho = ((f64::from(r) + 0.5) / f64::from(nr)).sqrt();
                    for t in 0..nt {
                        let theta = TAU * f64::from(t) / f64::from(nt);
                        sum += zernike(i, rho, theta) * zernike(j, rho, theta);
                    }
                }
                let product = sum / f64::from(nr * nt);
                let expected = if i == j { 1.0 } else { 0.0 };
                assert!((product - expected).abs() < 1e-5, "<Z_{i}, Z_{j}> = {product}");
            }
        }
        assert!((zernike(1, 0.3, PI) - 1.0).abs() < 1e-15);
    }
}
