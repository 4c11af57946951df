//! Mottle: random light in squares of one to eight pixels, some with sharp and some with smooth edges, from sparse to
//! field-filling.

use super::canvas::{Canvas, between, log_uniform};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

pub(super) fn draw(canvas: &mut Canvas, rng: &mut impl Rng) {
    let side = log_uniform(rng, 1.0, 8.0).round() as usize;
    let (least, smooth) = (rng.random_range(-0.5..1.5), rng.random_bool(0.5));
    let [rows, cols] = canvas.size().map(|n| n / side + 2);
    let mut light: Vec<f64> = (0..rows * cols)
        .map(|_| {
            let z: f64 = StandardNormal.sample(rng);
            (z - least).max(0.0)
        })
        .collect();
    // No scene is dark.
    light[0] += 1.0;
    canvas.add(|pixel| {
        let ([y, x], part) = (pixel.map(|v| v / side), pixel.map(|v| (v % side) as f64 / side as f64));
        let at = |dy: usize, dx: usize| light[(y + dy) * cols + x + dx];
        if !smooth {
            return at(0, 0);
        }
        between(at, part)
    });
}
