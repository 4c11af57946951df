//! Response of each pixel to light, from flats.
//!
//! At each light level the response of a pixel is its mean light over the smooth light around it; the temporal variance
//! of the level gives its noise. The levels are averaged with weights of one over their variance. The remaining noise
//! is reduced by empirical Bayes: the spread of the averages minus the known noise is the spread of the true responses,
//! and each pixel is shrunk towards the mean by the share of noise in it (Efron & Morris, J. Am. Stat. Assoc. 68, 117
//! (1973)). Shading of the lamp is not a property of the pixels: a cubic polynomial over the frame is divided out.

use super::transfer::MODEL_ERROR;
use crate::linalg::{NotConverged, least_squares};
use crate::noise::stats::Summary;
use ndarray::{Array2, Zip};

/// Degree of the polynomial for the shading of the lamp.
const SHADING_DEGREE: i32 = 3;
/// Number of fits of the shading, each without the outliers of the one before.
const SHADING_ROUNDS: usize = 3;
/// Pixels farther from the mean than this many standard deviations are dead, hot or under dust. They are not shrunk.
const OUTLIER: f64 = 6.0;
/// There is a map only if the spread of the responses exceeds this many of its standard errors.
const SIGNIFICANT: f64 = 4.0;

/// One light level of flats.
pub(super) struct Level<'a> {
    /// Mean light above black and offset, DN, [sensor rows, sensor cols]; NaN where a frame was saturated.
    pub light_dn: &'a Array2<f32>,
    /// Number of frames.
    pub frames: f64,
    /// Mean light and temporal variance of a pixel in one frame.
    pub summary: Summary,
}

/// Response of each pixel, and its error.
pub(super) struct ResponseMap {
    /// Response relative to the mean, [sensor rows, sensor cols].
    pub response: Array2<f32>,
    /// Rms difference from the true responses.
    pub error: f64,
}

/// Running sums over light levels; maps are [sensor rows, sensor cols].
#[derive(Default)]
pub(super) struct ResponseSums {
    maps: Option<Maps>,
    /// Sum over the levels of the weight at mean light.
    weight: f64,
    /// Sum over the levels of `(weight * relative standard error of the variance)^2`.
    uncertain: f64,
}

struct Maps {
    /// Weights: one over the variance of the relative light.
    weight: Array2<f32>,
    /// Weight times (relative light - 1).
    excess: Array2<f32>,
    /// Weight over light, by which an error of the offset enters.
    per_dn: Array2<f32>,
}

impl ResponseSums {
    /// Adds a level; `dark_dn2` is the temporal variance of a pixel without light, DN^2.
    ///
    /// # Errors
    /// The fit of the shading did not converge.
    pub(super) fn add(&mut self, level: &Level<'_>, dark_dn2: f64) -> Result<(), NotConverged> {
        let lamp = Shading::fit(level.light_dn)?;
        let (rows, cols) = level.light_dn.dim();
        let maps = self.maps.get_or_insert_with(|| {
            let zero = Array2::zeros((rows, cols));
            Maps { weight: zero.clone(), excess: zero.clone(), per_dn: zero }
        });
        let photons = (level.summary.variance - dark_dn2).max(0.0) / level.summary.mean;
        for r in 0..rows {
            let along = lamp.row(r);
            for c in 0..cols {
                let (light, lit) = (f64::from(level.light_dn[[r, c]]), along.at(c));
                // Places with less than a tenth of the mean light are ignored.
                if !light.is_finite() || lit < 0.1 * level.summary.mean {
                    continue;
                }
                let weight = level.frames * lit * lit / (dark_dn2 + photons * lit).max(f64::MIN_POSITIVE);
                maps.weight[[r, c]] += weight as f32;
                maps.excess[[r, c]] += (weight * (light / lit - 1.0)) as f32;
                maps.per_dn[[r, c]] += (weight / lit) as f32;
            }
        }
        let s = level.summary;
        let weight = level.frames * s.mean * s.mean / s.variance.max(f64::MIN_POSITIVE);
        self.weight += weight;
        self.uncertain += (weight * s.sigma / s.variance.max(f64::MIN_POSITIVE)).powi(2);
        Ok(())
    }

    /// The responses relative to the mean; `None` if the flats show no spread beyond their noise.
    ///
    /// `offset_dn2` is the error variance of the offsets that were subtracted from all levels, DN^2.
    pub(super) fn finish(self, offset_dn2: f64) -> Option<ResponseMap> {
        let maps = self.maps?;
        // (relative response - 1, its noise variance); `None` for pixels without data.
        let known = maps.weight.iter().zip(&maps.excess).zip(&maps.per_dn).map(|((w, e), p)| {
            let w = f64::from(*w);
            let offset = f64::from(*p) / w;
            (w > 0.0).then(|| (f64::from(*e) / w, 1.0 / w + offset_dn2 * offset * offset))
        });
        let pixels: Vec<Option<(f64, f64)>> = known.collect();
        let spread = Spread::of(&pixels)?;
        let total = spread.total();
        let counting = total * (2.0 / spread.count).sqrt();
        let noise = spread.noise * (self.uncertain.sqrt() / self.weight).hypot(MODEL_ERROR);
        if spread.between <= SIGNIFICANT * counting.hypot(noise) {
            return None;
        }
        let response = |(u, v): (f64, f64)| {
            let (off, all) = (u - spread.mean, spread.between + v);
            let kept = if off * off <= OUTLIER * OUTLIER * all { spread.between / all } else { 1.0 };
            (1.0 + kept * off) as f32
        };
        let values = pixels.into_iter().map(|p| p.map_or(1.0, response)).collect();
        let left = spread.between * spread.noise / total;
        let response = Array2::from_shape_vec(maps.weight.dim(), values).ok()?;
        Some(ResponseMap { response, error: left.sqrt() })
    }
}

/// Statistics of the responses over the pixels, without outliers.
struct Spread {
    count: f64,
    mean: f64,
    /// Variance due to noise.
    noise: f64,
    /// Variance of the true responses.
    between: f64,
}

impl Spread {
    fn of(pixels: &[Option<(f64, f64)>]) -> Option<Self> {
        let mut spread = Self { count: 0.0, mean: 0.0, noise: f64::INFINITY, between: 0.0 };
        for _ in 0..4 {
            let limit = OUTLIER * OUTLIER * spread.total();
            let inside = pixels.iter().flatten().filter(|(u, _)| (u - spread.mean).powi(2) <= limit);
            let mut s = [0.0; 4];
            for (u, v) in inside {
                for (sum, x) in s.iter_mut().zip([1.0, *u, u * u, *v]) {
                    *sum += x;
                }
            }
            if s[0] < 2.0 {
                return None;
            }
            let (mean, noise) = (s[1] / s[0], s[3] / s[0]);
            let variance = (s[2] - s[0] * mean * mean).max(0.0) / (s[0] - 1.0);
            spread = Self { count: s[0], mean, noise, between: (variance - noise).max(0.0) };
        }
        Some(spread)
    }

    fn total(&self) -> f64 {
        self.between + self.noise
    }
}

/// Light of the lamp over the frame: `sum c_ij y^i x^j`, `i + j <= 3`, y and x from -1 to 1.
struct Shading {
    shape: [usize; 2],
    /// Powers (i, j) of y and x, and the coefficient c_ij.
    terms: Vec<([i32; 2], f64)>,
}

/// The polynomial along one row: coefficients of the powers of x.
struct AlongRow {
    cols: usize,
    powers: [f64; SHADING_DEGREE as usize + 1],
}

impl Shading {
    fn fit(light_dn: &Array2<f32>) -> Result<Self, NotConverged> {
        let powers = (0..=SHADING_DEGREE).flat_map(|i| (0..=SHADING_DEGREE - i).map(move |j| ([i, j], 0.0)));
        let mut lamp = Self { shape: [light_dn.nrows(), light_dn.ncols()], terms: powers.collect() };
        let mut limit = f64::INFINITY;
        for _ in 0..SHADING_ROUNDS {
            let n = lamp.terms.len();
            let (mut normal, mut right) = (Array2::<f64>::zeros((n, n)), Array2::<f64>::zeros((n, 1)));
            let mut basis = vec![0.0; n];
            let near = |lamp: &Self, r: usize, c: usize, along: &AlongRow| {
                let light = f64::from(light_dn[[r, c]]);
                (light.is_finite() && (light - along.at(c)).abs() <= limit).then(|| (light, at(c, lamp.shape[1])))
            };
            for r in 0..lamp.shape[0] {
                let (y, along) = (at(r, lamp.shape[0]), lamp.row(r));
                for c in 0..lamp.shape[1] {
                    let Some((light, x)) = near(&lamp, r, c, &along) else { continue };
                    for (b, ([i, j], _)) in basis.iter_mut().zip(&lamp.terms) {
                        *b = y.powi(*i) * x.powi(*j);
                    }
                    for i in 0..n {
                        right[[i, 0]] += basis[i] * light;
                        (0..=i).for_each(|j| normal[[i, j]] += basis[i] * basis[j]);
                    }
                }
            }
            let lower = normal.clone();
            Zip::indexed(&mut normal).for_each(|(i, j), v| *v = lower[[i.max(j), i.min(j)]]);
            let solved = least_squares(&normal, &right)?;
            lamp.terms.iter_mut().zip(solved.iter()).for_each(|((_, c), s)| *c = *s);
            limit = 5.0 * lamp.misfit(light_dn, limit);
        }
        Ok(lamp)
    }

    /// Rms difference between light and polynomial over the pixels that differ by at most `limit`, DN.
    fn misfit(&self, light_dn: &Array2<f32>, limit: f64) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        for (r, row) in light_dn.outer_iter().enumerate() {
            let along = self.row(r);
            for off in row.iter().enumerate().map(|(c, v)| f64::from(*v) - along.at(c)) {
                if off.abs() <= limit {
                    (sum, count) = (sum + off * off, count + 1.0);
                }
            }
        }
        (sum / f64::max(count, 1.0)).sqrt()
    }

    fn row(&self, r: usize) -> AlongRow {
        let y = at(r, self.shape[0]);
        let mut powers = [0.0; SHADING_DEGREE as usize + 1];
        for ([i, j], c) in &self.terms {
            powers[*j as usize] += c * y.powi(*i);
        }
        AlongRow { cols: self.shape[1], powers }
    }
}

impl AlongRow {
    fn at(&self, c: usize) -> f64 {
        let x = at(c, self.cols);
        self.powers.iter().rev().fold(0.0, |sum, p| sum * x + p)
    }
}

/// Coordinate of pixel `i` of `n`, from -1 to 1.
fn at(i: usize, n: usize) -> f64 {
    let half = (n as f64 - 1.0) / 2.0;
    if half > 0.0 { (i as f64 - half) / half } else { 0.0 }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use rand_distr::{Distribution, StandardNormal};

    const SHAPE: (usize, usize) = (90, 110);

    fn normals(seed: u64) -> Array2<f64> {
        let mut rng = crate::rng::stream(seed, "response", 0);
        Array2::from_shape_simple_fn(SHAPE, || StandardNormal.sample(&mut rng))
    }

    /// Levels of 8 frames at gain 0.4, with a lamp that falls off to one corner and responses of the given rms.
    fn measured(rms: f64, spoil: impl Fn(&mut Array2<f64>)) -> (Array2<f64>, Option<Array2<f32>>) {
        let mut truth = normals(1).mapv(|z| 1.0 + rms * z);
        spoil(&mut truth);
        let mut sums = ResponseSums::default();
        for (i, mean) in [200.0, 800.0, 1600.0, 2400.0].into_iter().enumerate() {
            let z = normals(2 + i as u64);
            let light_dn = Array2::from_shape_fn(SHAPE, |(r, c)| {
                let lamp = mean * (1.0 - 0.002 * r as f64 - 1e-5 * (c * c) as f64);
                let light = lamp * truth[[r, c]];
                (light + ((0.4 * light + 0.7) / 8.0).sqrt() * z[[r, c]]) as f32
            });
            let mean = light_dn.iter().map(|v| f64::from(*v)).sum::<f64>() / light_dn.len() as f64;
            let variance = 0.4 * mean + 0.7;
            let sigma = variance * (2.0 / (7.0 * light_dn.len() as f64)).sqrt();
            let level = Level { light_dn: &light_dn, frames: 8.0, summary: Summary { mean, variance, sigma } };
            sums.add(&level, 0.7).unwrap();
        }
        (truth, sums.finish(0.0).map(|r| r.response))
    }

    fn rms(a: impl Iterator<Item = f64>) -> f64 {
        let (sum, count) = a.fold((0.0, 0.0f64), |(s, n), v| (s + v * v, n + 1.0));
        (sum / count).sqrt()
    }

    #[test]
    fn responses_are_as_exact_as_noise_and_their_own_spread_allow() {
        for spread in [0.002, 0.01] {
            let (truth, found) = measured(spread, |_| ());
            let found = found.unwrap();
            let error = rms(truth.iter().zip(&found).map(|(t, f)| t - f64::from(*f)));
            // Light of the four levels over their frames: 1 / v = 8 (200 + 800 + 1600 + 2400) 0.86 / 0.4.
            let noise = 1.0 / (8.0 * 5000.0 * 0.86 / 0.4f64).sqrt();
            let best = spread * noise / spread.hypot(noise);
            assert!(error < 1.1 * best, "{spread}: {error} {best}");
            assert!((found.mean().unwrap() - 1.0).abs() < 1e-5);
        }
    }

    #[test]
    fn a_sensor_without_spread_has_no_map() {
        assert!(measured(0.0, |_| ()).1.is_none());
        assert!(measured(0.0003, |_| ()).1.is_none());
    }

    #[test]
    fn dead_and_shadowed_pixels_are_not_shrunk() {
        let (_, found) = measured(0.003, |truth| {
            truth[[7, 9]] = 0.0;
            truth.slice_mut(ndarray::s![40..44, 50..54]).mapv_inplace(|t| 0.7 * t);
        });
        let found = found.unwrap();
        assert!(
            found[[7, 9]].abs() < 0.01 && (found[[41, 51]] - 0.7).abs() < 0.02,
            "{} {}",
            found[[7, 9]],
            found[[41, 51]]
        );
        assert!((found.mean().unwrap() - 1.0).abs() < 1e-3);
    }
}
