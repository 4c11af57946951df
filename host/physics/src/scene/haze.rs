//! Haze: smooth light over the whole field, as tissue out of focus gives it.

use super::canvas::{Canvas, between, log_uniform};
use rand::{Rng, RngExt};

/// Adds haze to a specimen, by chance to two of five.
pub(super) fn maybe(canvas: &mut Canvas, rng: &mut impl Rng) {
    if !rng.random_bool(0.4) {
        return;
    }
    let (level, cells) = (log_uniform(rng, 0.02, 3.0), rng.random_range(1..6usize));
    let nodes: Vec<f64> = (0..(cells + 1).pow(2)).map(|_| level * rng.random_range(0.1..1.0)).collect();
    let size = canvas.size();
    canvas.add(|at| {
        // Between four nodes, smoothly: 3 t^2 - 2 t^3.
        let [(y, down), (x, across)] = [0, 1].map(|axis| {
            let place = (at[axis] as f64 + 0.5) / size[axis] as f64 * cells as f64;
            let t = place.fract();
            (place as usize, t * t * (3.0 - 2.0 * t))
        });
        let node = |dy: usize, dx: usize| nodes[(y + dy).min(cells) * (cells + 1) + (x + dx).min(cells)];
        between(node, [down, across])
    });
}
