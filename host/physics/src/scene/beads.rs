//! Fluorescent beads of random size, brightness and place.

use super::canvas::{Blend, Canvas, log_uniform};
use rand::{Rng, RngExt};

pub(super) fn draw(canvas: &mut Canvas, rng: &mut impl Rng) {
    let density = log_uniform(rng, 200.0, 2200.0);
    // One batch of beads has one nominal size.
    let nominal_um = log_uniform(rng, 1.4, 6.0);
    for _ in 0..canvas.number(density) {
        let centre = canvas.anywhere(rng);
        let radius = nominal_um * rng.random_range(0.8..1.25);
        canvas.disc(centre, radius, rng.random_range(0.15..1.0), Blend::Add);
    }
}
