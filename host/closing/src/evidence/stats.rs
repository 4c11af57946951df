//! Tail probabilities and multiple testing.

use puruspe::{betai, erfc, gammp, gammq, inverfc};

/// Probability that a chi-squared variable with `ndf` degrees of freedom exceeds `x`; 1 for arguments out of range.
///
/// ```
/// use ommatidia_closing::evidence::stats::{chi2_tail, holm, sigmas};
/// // Abramowitz & Stegun, table 26.8.
/// assert!((chi2_tail(18.307, 10.0) - 0.05).abs() < 1e-4);
/// assert!((sigmas(0.0455) - 2.0).abs() < 1e-3);
/// assert_eq!(holm(&[0.01, 0.04, 0.03, 0.005], 0.05), [true, false, false, true]);
/// ```
pub fn chi2_tail(x: f64, ndf: f64) -> f64 {
    let counts = |v: f64| v.is_finite() && v > 0.0;
    if !counts(x) || !counts(ndf) {
        return 1.0;
    }
    if ndf > 2e3 {
        // Wilson and Hilferty (PNAS 17, 684, 1931): the cube root is nearly normal.
        let k = 2.0 / (9.0 * ndf);
        let z = ((x / ndf).cbrt() - 1.0 + k) / k.sqrt();
        return 0.5 * erfc(z / std::f64::consts::SQRT_2);
    }
    gammq(ndf / 2.0, x / 2.0).clamp(0.0, 1.0)
}

/// Probability that a Poisson variable with mean `mean` is `n`, a whole number above 0, or more.
pub fn at_least(n: f64, mean: f64) -> f64 {
    if mean > 0.0 { gammp(n, mean).clamp(0.0, 1.0) } else { 0.0 }
}

/// Probability that an F variable with `d` and `nu` degrees of freedom exceeds `f`; `nu` may be infinite.
pub fn f_tail(f: f64, d: f64, nu: f64) -> f64 {
    if !f.is_finite() || f <= 0.0 || d <= 0.0 {
        return 1.0;
    }
    if nu.is_nan() || nu >= 1e5 {
        return chi2_tail(f * d, d);
    }
    betai(nu / 2.0, d / 2.0, nu / (nu + d * f)).clamp(0.0, 1.0)
}

/// Number of standard deviations at which the two-sided tail of a normal variable has probability `p`.
pub fn sigmas(p: f64) -> f64 {
    if p.is_nan() || p >= 1.0 { 0.0 } else { std::f64::consts::SQRT_2 * inverfc(p.max(1e-290)) }
}

/// Two-sided tail probability of a normal variable at `z` standard deviations.
pub fn two_sided(z: f64) -> f64 {
    erfc(z.abs() / std::f64::consts::SQRT_2)
}

/// Which of the null hypotheses with probabilities `p` are rejected at family-wise level `alpha` (Holm, Scand. J. Stat.
/// 6, 65, 1979).
pub fn holm(p: &[f64], alpha: f64) -> Vec<bool> {
    let mut order: Vec<usize> = (0..p.len()).collect();
    order.sort_by(|a, b| p[*a].total_cmp(&p[*b]));
    let mut rejected = vec![false; p.len()];
    for (i, n) in order.iter().enumerate() {
        if p[*n] * (p.len() - i) as f64 > alpha {
            break;
        }
        rejected[*n] = true;
    }
    rejected
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tails_of_tables() {
        // Abramowitz & Stegun, tables 26.8 and 26.9.
        assert!((chi2_tail(3.841, 1.0) - 0.05).abs() < 1e-4);
        assert!((chi2_tail(18.307, 10.0) - 0.05).abs() < 1e-4);
        // On both sides of the threshold of the approximation.
        assert!((chi2_tail(2100.0, 1999.0) / chi2_tail(2102.0, 2001.0) - 1.0).abs() < 0.02);
        assert!(chi2_tail(f64::NAN, 3.0) == 1.0 && f_tail(f64::NAN, 1.0, 5.0) == 1.0 && sigmas(f64::NAN) == 0.0);
        assert!((f_tail(3.33, 5.0, 10.0) - 0.05).abs() < 1e-3);
        assert!((f_tail(2.0, 3.0, f64::INFINITY) - chi2_tail(6.0, 3.0)).abs() < 1e-12);
        for z in [0.5, 1.96, 5.0, 12.0, 30.0] {
            assert!((sigmas(two_sided(z)) - z).abs() < 1e-3 * z, "{z} {}", sigmas(two_sided(z)));
        }
        // Of a Poisson variable with mean 2: 1 - exp(-2) (1 + 2 + 2).
        assert!((at_least(3.0, 2.0) - (1.0 - 5.0 * (-2.0f64).exp())).abs() < 1e-9 && at_least(1.0, 0.0) == 0.0);
        assert!(sigmas(0.0).is_finite() && sigmas(1.0) == 0.0);
    }

    #[test]
    fn holm_steps_down() {
        assert_eq!(holm(&[0.01, 0.04, 0.03, 0.005], 0.05), [true, false, false, true]);
        assert_eq!(holm(&[0.2], 0.05), [false]);
    }
}
