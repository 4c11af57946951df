//! The light of each scene relative to its prediction: by a regression of images before anything is fitted, or under a
//! fit of what all scenes share.

use super::record::{SMOOTH_PX, Seen, correlation, median, slope};
use super::solve::pseudo_inverse;
use super::{Fitted, Model};
use crate::data::Shown;
use ndarray::{Array2, Axis};
use ommatidia_model::forward::ForwardError;
use ommatidia_physics::effects::blur_within;
use rayon::prelude::*;

/// A scene that correlates with its prediction by less has no light relative to it.
pub(super) const ALIKE: f64 = 0.8;
/// Share of the variance of a scene's light that must be elsewhere than in the light of its borders. With less, errors
/// of the PSFs are taken for light of the scene.
const ELSEWHERE: f64 = 0.1;
/// Number of parts of a frame along each side.
pub(super) const PARTS: usize = 3;

/// The light of a scene over that of its prediction.
pub(crate) struct Light {
    /// Relative difference.
    pub(super) by: f64,
    /// Its standard error by the noise of the pixels.
    pub(super) sigma: f64,
    /// Chi-squared of the scene beyond its number of pixels.
    pub(super) excess: f64,
    /// The light of its parts over that of their prediction, and how much each part says of it: one over its variance.
    /// They are parts of the sensor in row order, [`PARTS`] x [`PARTS`].
    pub(super) parts: Vec<[f64; 2]>,
}

impl Light {
    /// The light of a scene by its predicted light above the black level, what is left of it beside that, both in DN,
    /// and one over the standard deviation of each pixel, 0 where it does not count; all [rows, cols].
    pub(super) fn of(light_dn: &Array2<f32>, left_dn: &Array2<f32>, inverse_sigma: &Array2<f32>) -> Self {
        let (rows, cols) = light_dn.dim();
        let mut parts = [Sums::default(); PARTS * PARTS];
        let mut excess = 0.0;
        let pixels = light_dn.indexed_iter().zip(left_dn).zip(inverse_sigma);
        for ((((r, c), light), left), w) in pixels.filter(|(_, w)| **w > 0.0) {
            let [light, left, w] = [*light, *left, *w].map(f64::from);
            parts[r * PARTS / rows * PARTS + c * PARTS / cols].add(light, left, w * w);
            excess += (left * w).powi(2) - 1.0;
        }
        let all = parts.iter().fold(Sums::default(), |sum, p| sum.with(p));
        let means = [all.light / all.weight.max(f64::MIN_POSITIVE), all.left / all.weight.max(f64::MIN_POSITIVE)];
        let [by, information] = all.slope(means);
        let of_part = |p: Sums| {
            let [by, information] = p.slope(means);
            [1.0 + by, information]
        };
        Self { by, sigma: information.powf(-0.5), excess, parts: parts.map(of_part).to_vec() }
    }

    /// The fall of chi-squared with the difference.
    pub(super) fn fall(&self) -> f64 {
        (self.by / self.sigma).powi(2)
    }
}

/// The light of scenes under a fit, whose indices among the frames are given. The regression of a scene's residual on
/// its predicted light has an intercept: the black level that all of them share errs where the light of one is wrong.
pub(crate) fn light(model: &Model<'_>, fit: &Fitted, scenes: &[usize]) -> Vec<Light> {
    let black_dn = (model.forward.noise().black_level_dn + fit.state.black_dn) as f32;
    let of = |k: &usize| {
        let here = &fit.predicted[*k];
        Light::of(&here.dn.mapv(|dn| dn - black_dn), &here.residual_dn, &here.inverse_sigma)
    };
    scenes.iter().map(of).collect()
}

/// The light of frame `k`, a scene with a known object, over that of its prediction under a fit, and its standard
/// error, beside the light of the first and the last row and column of its object: a record that is displaced by up to
/// a pixel loses or doubles that. An object that has hardly any other light says nothing: the error is infinite.
///
/// # Errors
/// The parts of the instrument disagree.
pub(crate) fn beside_borders(model: &Model<'_>, fit: &Fitted, k: usize) -> Result<[f64; 2], ForwardError> {
    let Shown::Object(truth) = model.seen.frames[k].shown else { return Ok([0.0, f64::INFINITY]) };
    let object = &model.seen.truths[truth];
    let (rows, cols) = object.dim();
    let chain = model.chain(&fit.state.terms);
    let lines = [(Axis(0), 0), (Axis(0), rows - 1), (Axis(1), 0), (Axis(1), cols - 1)];
    let of_line = |(axis, at)| {
        let mut line = Array2::<f32>::zeros(object.dim());
        line.index_axis_mut(axis, at).assign(&object.index_axis(axis, at));
        let scene = model.scene_of(k, &line, &chain)?;
        Ok(model.sum_e(k, Some(&scene), (&chain, &fit.state), 1.0))
    };
    let borders: Vec<Array2<f32>> = lines.into_iter().map(of_line).collect::<Result<_, ForwardError>>()?;
    let here = &fit.predicted[k];
    Ok(slope_beside(&here.dn, &borders, &here.residual_dn, &here.inverse_sigma))
}

/// The slope of what is left on the light, beside slopes on other images and an intercept, and its standard error; all
/// [rows, cols].
fn slope_beside(
    light: &Array2<f32>,
    others: &[Array2<f32>],
    left: &Array2<f32>,
    inverse_sigma: &Array2<f32>,
) -> [f64; 2] {
    let n = others.len() + 1;
    let (mut gram, mut cross) = (Array2::<f64>::zeros((n, n)), Array2::<f64>::zeros((n, 2)));
    let (mut squares, mut product) = (0.0, 0.0);
    let mut row = vec![1.0; n];
    for (at, w) in inverse_sigma.indexed_iter().filter(|(_, w)| **w > 0.0) {
        let [light, left, w] = [light[at], left[at], *w].map(f64::from);
        row.iter_mut().zip(others).for_each(|(v, o)| *v = f64::from(o[at]));
        for i in 0..n {
            let v = w * w * row[i];
            (0..n).for_each(|j| gram[[i, j]] += v * row[j]);
            cross[[i, 0]] += v * light;
            cross[[i, 1]] += v * left;
        }
        squares += w * w * light * light;
        product += w * w * light * left;
    }
    // What the others explain of both is taken from them.
    let explained = cross.t().dot(&pseudo_inverse(&gram)).dot(&cross);
    let information = squares - explained[[0, 0]];
    let varies = squares - cross[[n - 1, 0]].powi(2) / gram[[n - 1, n - 1]].max(f64::MIN_POSITIVE);
    if information <= ELSEWHERE * varies {
        return [0.0, f64::INFINITY];
    }
    [(product - explained[[0, 1]]) / information, information.powf(-0.5)]
}

/// Weighted sums over the pixels of a part of a scene, for a regression of what is left on the light.
#[derive(Clone, Copy, Default)]
struct Sums {
    weight: f64,
    light: f64,
    left: f64,
    squares: f64,
    products: f64,
}

impl Sums {
    fn add(&mut self, light: f64, left: f64, weight: f64) {
        *self = self.with(&Self {
            weight,
            light: weight * light,
            left: weight * left,
            squares: weight * light * light,
            products: weight * light * left,
        });
    }

    fn with(&self, other: &Self) -> Self {
        Self {
            weight: self.weight + other.weight,
            light: self.light + other.light,
            left: self.left + other.left,
            squares: self.squares + other.squares,
            products: self.products + other.products,
        }
    }

    /// The slope beside means of light and left, and one over its variance.
    fn slope(&self, [light, left]: [f64; 2]) -> [f64; 2] {
        let products = self.products - light * self.left - left * self.light + light * left * self.weight;
        let squares = self.squares - 2.0 * light * self.light + light * light * self.weight;
        let squares = squares.max(f64::MIN_POSITIVE);
        [products / squares, squares]
    }
}

/// Logarithms of the light of scenes relative to their median.
pub(super) fn logs(light: &[Light]) -> Vec<f64> {
    beside_median(light.iter().map(|l| l.by.ln_1p()).collect())
}

/// Differences of some values from their median.
pub(super) fn beside_median(values: Vec<f64>) -> Vec<f64> {
    let usual = median(values.clone()).unwrap_or(0.0);
    values.into_iter().map(|v| v - usual).collect()
}

/// Light of each frame over that of its record, both blurred, and their correlation. The regression has an intercept,
/// so that an even background is no light of the specimen.
pub(crate) fn slopes(frames: &[Seen]) -> Vec<[f64; 2]> {
    let of = |s: &Seen| {
        let [y, m] = [&s.measured, &s.own].map(|image| blur_within(image, SMOOTH_PX));
        [slope(&y, &m), correlation(&y, &m)]
    };
    frames.par_iter().map(of).collect()
}

/// Median of the sizes of some values.
pub(super) fn scatter(values: &[f64]) -> f64 {
    median(values.iter().map(|v| v.abs()).collect()).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slope_does_not_see_an_error_of_the_black_level() {
        let mut parts = [Sums::default(); 2];
        for i in 0..20 {
            let light = f64::from(i % 7) * 10.0;
            // A quarter more light, and 3 DN of black level.
            parts[i as usize % 2].add(light, 0.25 * light + 3.0, 1.0 + f64::from(i % 3));
        }
        let all = parts[0].with(&parts[1]);
        let means = [all.light / all.weight, all.left / all.weight];
        for sums in [all, parts[0], parts[1]] {
            let [by, information] = sums.slope(means);
            assert!((by - 0.25).abs() < 1e-12 && information > 0.0, "{by}");
        }
        // Without light nothing is known.
        assert_eq!(Sums::default().slope([0.0, 0.0])[0], 0.0);
    }

    #[test]
    fn light_at_the_borders_is_no_light_of_the_scene() {
        let image = |period: usize| Array2::from_shape_fn((20, 20), |(r, c)| ((r * 7 + c * 3) % period) as f32);
        let (light, border, ones) = (image(11), image(5), Array2::ones((20, 20)));
        let left = &light * 0.1 - &border * 0.5 + 2.0;
        let [by, sigma] = slope_beside(&light, std::slice::from_ref(&border), &left, &ones);
        assert!((by - 0.1).abs() < 1e-6 && sigma > 0.0 && sigma < 0.1, "{by} {sigma}");
        // All of its light is there.
        assert_eq!(slope_beside(&light, &[border, light.clone()], &left, &ones)[1], f64::INFINITY);
    }
}
