//! Estimates unknown specimens from their frames.
//!
//! Richardson-Lucy with the read noise as a constant light (Snyder et al., J. Opt. Soc. Am. A 10, 1014, 1993), on the
//! pixels of the training blocks. The estimate shapes the signatures of the effects and the weights of the pixels; no
//! residual depends on it, since everything that a change of the specimen can make is taken out of the residuals.

use crate::fit::projection::{LANES, Views};
use ndarray::Array2;

/// Number of iterations: later ones fit noise.
const ITERATIONS: usize = 25;

/// Object pixels with less light on the sensor, relative to the brightest, are not estimated.
const LEAST: f32 = 1e-3;

/// An estimated specimen.
pub(super) struct Estimate {
    /// [object rows, object cols].
    pub(super) object: Array2<f32>,
    /// Its light on the sensor, electrons, [sensor rows, sensor cols].
    pub(super) light_e: Array2<f32>,
}

/// Specimens that explain frames, each [object rows, object cols] >= 0. `frames_e` are the frames without their dark
/// signal, electrons, [sensor rows, sensor cols]; `weight` is positive at the pixels that count; `floor_e2` is the
/// variance of the read noise.
pub(super) fn specimens(views: &Views, frames_e: &[Array2<f32>], weight: &[f32], floor_e2: f32) -> Vec<Estimate> {
    let of = |group: &[Array2<f32>]| match group.len() {
        ..=4 => together::<4>(views, group, weight, floor_e2),
        5..=8 => together::<8>(views, group, weight, floor_e2),
        _ => together::<LANES>(views, group, weight, floor_e2),
    };
    frames_e.chunks(LANES).flat_map(of).collect()
}

/// The same for at most L frames at once.
fn together<const L: usize>(views: &Views, frames_e: &[Array2<f32>], weight: &[f32], floor_e2: f32) -> Vec<Estimate> {
    let mut measured: Vec<[f32; L]> = vec![[0.0; L]; weight.len()];
    for (lane, frame) in frames_e.iter().enumerate() {
        measured.iter_mut().zip(frame).for_each(|(m, y)| m[lane] = (y + floor_e2).max(0.0));
    }
    let used: Vec<[f32; L]> = weight.iter().map(|w| [f32::from(u8::from(*w > 0.0)); L]).collect();
    // Low-rank PSFs have small negative values; object pixels with hardly any light on the sensor stay dark.
    let seen = views.adjoint(&used);
    let least = seen.iter().map(|s| s[0]).fold(0.0f32, f32::max) * LEAST;
    let mut objects: Vec<[f32; L]> = vec![[1.0; L]; views.unknowns()];
    for _ in 0..ITERATIONS {
        let mut ratio = views.forward(&objects);
        for ((r, m), u) in ratio.iter_mut().zip(&measured).zip(&used) {
            r.iter_mut().zip(m).zip(u).for_each(|((r, m), u)| *r = u * m / (r.max(0.0) + floor_e2));
        }
        let back = views.adjoint(&ratio);
        for ((x, b), s) in objects.iter_mut().zip(&back).zip(&seen) {
            x.iter_mut().zip(b).zip(s).for_each(|((x, b), s)| *x = if *s > least { *x * b.max(0.0) / s } else { 0.0 });
        }
    }
    let light = views.forward(&objects);
    let image = |of: &[[f32; L]], [rows, cols]: [usize; 2], lane: usize| {
        Array2::from_shape_fn((rows, cols), |(r, c)| of[r * cols + c][lane])
    };
    let one = |lane: usize| Estimate {
        object: image(&objects, views.object(), lane),
        light_e: image(&light, views.sensor(), lane),
    };
    (0..frames_e.len()).map(one).collect()
}
