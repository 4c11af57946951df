//! The bend of a sensor's response, from flats at several levels.
//!
//! The bend ([`super::bend`]) is the effect `nonlinearity` of the catalogue. Two independent laws show it:
//!
//! - The means: L is proportional to exposure times illumination. A lamp whose light is not proportional to what the
//!   table says imitates a bend.
//! - The noise: `var = g L (1 - 2 beta L / F)^2`, so that to first order `var = g (m - 3 beta m^2 / F)`. Charge that
//!   pushes later charge away (brighter-fatter effect) imitates it.
//!
//! The bend is that of the means, which is far more exact; it counts where the noise agrees.

use super::bend::Bend;
use super::calibration::Estimate;
use super::transfer::{ROUNDING_DN2, variance_error};
use crate::linalg::least_squares;
use crate::noise::stats::Summary;
use ndarray::Array2;

/// Levels of light that a bend needs: a scale, the bend, and two that could contradict.
const LEAST_LEVELS: usize = 4;
/// Relative error of the light of a level beside the scatter of its frames.
const LIGHT_ERROR: f64 = 1e-4;
/// Error of the black level between darks and flats, DN.
const BLACK_ERROR_DN: f64 = 0.1;
/// A bend counts from this many standard errors.
const SIGNIFICANT: f64 = 5.0;
/// The noise agrees with the means within this many standard errors.
const AGREES: f64 = 3.0;
/// Largest bend that counts: beyond it, the law is another.
const MOST: f64 = 0.3;

/// One level of flats.
#[derive(Clone, Copy, Debug)]
pub(super) struct LitLevel {
    /// Exposure times illumination, ms.
    pub dose: f64,
    /// Mean and variance.
    pub summary: Summary,
    /// Standard error of the mean by the scatter of the frames, DN.
    pub mean_error_dn: f64,
}

/// What the levels of flats show of a bend.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Shown {
    /// No bend, or too little to see one.
    Nothing,
    /// Means and noise bend alike.
    Bend(Bend),
    /// The means bend, and the noise does not bend with them.
    Levels(Bend),
}

/// The bend that flats show; `dark` is the level without light.
pub(super) fn bend(levels: &[LitLevel], dark: Option<Summary>, full_scale_dn: f64) -> Shown {
    let Some([beta, sigma]) = of_means(levels, full_scale_dn) else { return Shown::Nothing };
    let found = Bend { beta, sigma, full_scale_dn };
    if beta.abs() < SIGNIFICANT * sigma || beta.abs() > MOST {
        return Shown::Nothing;
    }
    let points: Vec<Summary> = dark.into_iter().chain(levels.iter().map(|l| l.summary)).collect();
    let agrees = of_noise(&points, full_scale_dn).is_some_and(|[noise, error]| {
        // The law of the noise is of first order in the bend.
        let allowed = AGREES * error.hypot(sigma) + beta * beta;
        (noise - beta).abs() <= allowed && noise / beta > 0.5
    });
    if agrees { Shown::Bend(found) } else { Shown::Levels(found) }
}

/// Bend and standard error by the means: `m = c x - beta (c x)^2 / F` over the doses x.
fn of_means(levels: &[LitLevel], full_scale_dn: f64) -> Option<[f64; 2]> {
    let most = levels.iter().map(|l| l.dose).fold(0.0, f64::max);
    let lit: Vec<&LitLevel> = levels.iter().filter(|l| l.dose > 0.0 && l.summary.mean > 0.0).collect();
    if lit.len() < LEAST_LEVELS {
        return None;
    }
    let weight = |l: &LitLevel| 1.0 / l.mean_error_dn.hypot(BLACK_ERROR_DN).hypot(LIGHT_ERROR * l.summary.mean);
    let row = |i: usize| {
        let x = lit[i].dose / most;
        [x, -x * x, lit[i].summary.mean].map(|v| v * weight(lit[i]))
    };
    let [slope, square] = solved(lit.len(), row)?;
    let beta = square.value / (slope.value * slope.value) * full_scale_dn;
    (slope.value > 0.0).then(|| [beta, square.sigma / (slope.value * slope.value) * full_scale_dn])
}

/// Bend and standard error by the noise: `var - 1/12 = i + g m - 3 g beta m^2 / F`.
fn of_noise(points: &[Summary], full_scale_dn: f64) -> Option<[f64; 2]> {
    let row = |i: usize| {
        let (p, m) = (&points[i], points[i].mean / full_scale_dn);
        [m, -3.0 * m * m, 1.0, p.variance - ROUNDING_DN2].map(|v| v / variance_error(p))
    };
    let [gain, bent, _] = solved(points.len(), row)?;
    (gain.value > 0.0).then(|| [bent.value / gain.value, bent.sigma / gain.value])
}

/// Least squares over `count` rows, each of N regressors and a value in units of its error. Errors grow with the
/// scatter about the fit where that is larger than the stated ones. None: too few rows.
fn solved<const N: usize, const M: usize>(count: usize, row: impl Fn(usize) -> [f64; M]) -> Option<[Estimate; N]> {
    let freedom = count.checked_sub(N).filter(|f| *f > 0)?;
    let design = Array2::from_shape_fn((count, N), |(i, a)| row(i)[a]);
    let wanted = Array2::from_shape_fn((count, 1), |(i, _)| row(i)[N]);
    let values = least_squares(&design, &wanted).ok()?;
    let covariance = least_squares(&design.t().dot(&design), &Array2::eye(N)).ok()?;
    let misfit = design.dot(&values) - wanted;
    let scatter = (misfit.iter().map(|v| v * v).sum::<f64>() / freedom as f64).max(1.0);
    Some(std::array::from_fn(|a| Estimate { value: values[[a, 0]], sigma: (scatter * covariance[[a, a]]).sqrt() }))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    const FULL_DN: f64 = 4000.0;

    /// Five levels at gain 0.4 of a sensor that bends by `beta` under a lamp that bends by `lamp`; the noise bends by
    /// `noise`.
    fn levels(beta: f64, lamp: f64, noise: f64) -> Vec<LitLevel> {
        let level = |dose: f64| {
            let light = 3000.0 * dose * (1.0 - lamp * 0.75 * dose);
            let mean = light - beta * light * light / FULL_DN;
            let variance = 0.4 * mean * (1.0 - 3.0 * noise * mean / FULL_DN) + 1.0 + ROUNDING_DN2;
            LitLevel { dose, summary: Summary { mean, variance, sigma: 0.002 * variance }, mean_error_dn: 0.05 }
        };
        [0.1, 0.3, 0.5, 0.7, 0.9].map(level).to_vec()
    }

    fn dark() -> Option<Summary> {
        Some(Summary { mean: 0.0, variance: 1.0 + ROUNDING_DN2, sigma: 0.002 })
    }

    #[test]
    fn a_bend_of_the_sensor_is_found_from_either_side() {
        for beta in [-0.02, 0.008, 0.03, 0.1] {
            let Shown::Bend(found) = bend(&levels(beta, 0.0, beta), dark(), FULL_DN) else { panic!("{beta}") };
            assert!((found.beta - beta).abs() < 3.0 * found.sigma + 1e-5 && found.sigma < 1e-3, "{found:?}");
        }
    }

    #[test]
    fn lamps_noise_alone_and_straight_sensors_are_no_bend() {
        assert_eq!(bend(&levels(0.0, 0.0, 0.0), dark(), FULL_DN), Shown::Nothing);
        // The noise alone bends: brighter-fatter effect.
        assert_eq!(bend(&levels(0.0, 0.0, 0.03), dark(), FULL_DN), Shown::Nothing);
        // The means alone bend: the lamp.
        assert!(matches!(bend(&levels(0.0, 0.03, 0.0), dark(), FULL_DN), Shown::Levels(_)));
        // Levels that are numbered, and not measured.
        let mut numbered = levels(0.0, 0.0, 0.0);
        for (i, (level, light)) in numbered.iter_mut().zip([300.0, 1000.0, 2500.0, 3000.0, 3900.0]).enumerate() {
            (level.dose, level.summary.mean) = (1.0 + i as f64, light);
        }
        assert_eq!(bend(&numbered, dark(), FULL_DN), Shown::Nothing);
        // Three levels could not contradict.
        assert_eq!(bend(&levels(0.03, 0.0, 0.03)[..3], dark(), FULL_DN), Shown::Nothing);
    }
}
