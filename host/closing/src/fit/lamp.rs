//! The lamp of the flats. Its light falls off over the sensor, which is no property of the instrument: as in a
//! calibration ([`ommatidia_physics::noise`]), the smooth part of the flats belongs to it.
//!
//! One shape holds for all flats of a session, since one lamp lights them at several levels:
//! ```text
//! light(r, c) = level (1 + sum_ij a_ij y^i x^j),   1 <= i + j <= 3,   y and x from -1 to 1 over the sensor
//! ```
//! The nine values are nuisances of the fit. So no flat shows an effect that is as smooth as this (a vignetting):
//! scenes do.

use super::solve::pseudo_inverse;
use ndarray::{Array1, Array2};

/// Number of values.
pub const TERMS: usize = 9;
/// The values a of a lamp's shape; all zero: even light.
pub type Lamp = [f64; TERMS];
/// Powers of y and x.
const POWERS: [[i32; 2]; TERMS] = [[1, 0], [0, 1], [2, 0], [1, 1], [0, 2], [3, 0], [2, 1], [1, 2], [0, 3]];

/// Pixels along each axis that a quotient of two shapes is fitted at.
const SAMPLES: usize = 32;
/// Factors below this share leave no light to tell the lamp from.
const DARK: f32 = 0.05;

/// The function that value `term` multiplies, [sensor rows, sensor cols].
pub(super) fn shape(dim: (usize, usize), term: usize) -> Array2<f32> {
    let [i, j] = POWERS[term];
    let at = |k: usize, n: usize| if n > 1 { 2.0 * k as f64 / (n as f64 - 1.0) - 1.0 } else { 0.0 };
    let along = |n: usize, power: i32| -> Vec<f64> { (0..n).map(|k| at(k, n).powi(power)).collect() };
    let (rows, cols) = (along(dim.0, i), along(dim.1, j));
    Array2::from_shape_fn(dim, |(r, c)| (rows[r] * cols[c]) as f32)
}

/// The light of a lamp over its level, [sensor rows, sensor cols]; never below zero.
pub(super) fn light(dim: (usize, usize), lamp: &Lamp) -> Array2<f32> {
    let mut light = Array2::ones(dim);
    for (term, a) in lamp.iter().enumerate().filter(|(_, a)| **a != 0.0) {
        light.scaled_add(*a as f32, &shape(dim, term));
    }
    light.mapv_inplace(|v: f32| v.max(0.0));
    light
}

/// The lamp whose light, times `factor` [sensor rows, sensor cols], comes closest to the light of `lamp` (least squares
/// of the quotient), and its level over that of `lamp`: the two together are what the flats show.
pub(super) fn beside(lamp: &Lamp, factor: &Array2<f32>) -> (f64, Lamp) {
    let dim = factor.dim();
    let light = light(dim, lamp);
    let shapes: Vec<Array2<f32>> = (0..TERMS).map(|term| shape(dim, term)).collect();
    let (mut gram, mut along) = (Array2::<f64>::zeros((TERMS + 1, TERMS + 1)), Array1::<f64>::zeros(TERMS + 1));
    let step = |n: usize| n.div_ceil(SAMPLES).max(1);
    for r in (0..dim.0).step_by(step(dim.0)) {
        for c in (0..dim.1).step_by(step(dim.1)).filter(|c| factor[[r, *c]] > DARK) {
            let quotient = f64::from(light[[r, c]] / factor[[r, c]]);
            let x: Vec<f64> = std::iter::once(1.0).chain(shapes.iter().map(|s| f64::from(s[[r, c]]))).collect();
            for (i, a) in x.iter().enumerate() {
                along[i] += a * quotient;
                x.iter().enumerate().for_each(|(j, b)| gram[[i, j]] += a * b);
            }
        }
    }
    let fitted = pseudo_inverse(&gram).dot(&along);
    let level = fitted[0];
    if !(level > 0.0 && level.is_finite()) {
        return (1.0, *lamp);
    }
    (level, std::array::from_fn(|term| fitted[term + 1] / level))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A quadratic lamp times an even falloff is of the fourth power: the lamp beside the falloff is the quadratic one.
    #[test]
    fn a_lamp_beside_a_falloff_is_the_lamp() {
        let dim = (90, 120);
        let mut truth = [0.0; TERMS];
        [truth[0], truth[2], truth[4]] = [0.05, -0.12, -0.2];
        let falloff = 1.0 - 0.5 * (shape(dim, 2) * 0.36 + shape(dim, 4) * 0.64);
        // What a fit without the falloff finds: the cubic that comes closest to the product.
        let product = light(dim, &truth) * &falloff;
        let (level, whole) = beside(&[0.0; TERMS], &product.mapv(|v| 1.0 / v));
        let (again, lamp) = beside(&whole, &falloff);
        for (a, b) in lamp.iter().zip(truth) {
            assert!((a - b).abs() < 0.06, "{lamp:?}");
        }
        assert!((level * again - 1.0).abs() < 0.05, "{level} {again}");
        // Where the product is known exactly, the lamp is exact.
        let (one, exact) = beside(&truth, &Array2::ones(dim));
        assert!((one - 1.0).abs() < 1e-6 && exact.iter().zip(truth).all(|(a, b)| (a - b).abs() < 1e-6), "{exact:?}");
    }
}
