//! The lamp of the flats. Its light falls off over the sensor, which is no property of the instrument: as in a
//! calibration ([`ommatidia_physics::noise`]), the smooth part of the flats belongs to it.
//!
//! One shape holds for all flats of a session, since one lamp lights them at several levels:
//! ```text
//! light(r, c) = level (1 + sum_ij a_ij y^i x^j),   1 <= i + j <= 4,   y and x from -1 to 1 over the sensor
//! ```
//! The fourteen values are nuisances of the fit. An effect that is as smooth as this (a vignetting) belongs to the lamp
//! in flats, and acts in other frames alone: a fit of both in flats would take what the shape of a lamp has beyond this
//! polynomial for the effect. The fourth power leaves room for a quadratic lamp under a quadratic falloff.

use ndarray::Array2;

/// Number of values.
pub const TERMS: usize = 14;
/// The values a of a lamp's shape; all zero: even light.
pub type Lamp = [f64; TERMS];
/// Powers of y and x.
const POWERS: [[i32; 2]; TERMS] =
    [[1, 0], [0, 1], [2, 0], [1, 1], [0, 2], [3, 0], [2, 1], [1, 2], [0, 3], [4, 0], [3, 1], [2, 2], [1, 3], [0, 4]];

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
