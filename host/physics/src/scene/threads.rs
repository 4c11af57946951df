//! Threads: curved lines a pixel wide, from stiff to tangled.

use super::canvas::{Blend, Canvas, add, direction, log_uniform, polar};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

pub(super) fn draw(canvas: &mut Canvas, rng: &mut impl Rng) {
    let pixel = canvas.pixel_um();
    for _ in 0..rng.random_range(1..25) {
        let (mut at, mut heading) = (canvas.anywhere(rng), direction(rng));
        let (value, bend) = (rng.random_range(0.1..1.0), log_uniform(rng, 0.01, 0.25));
        // Half of the threads run through pixels, the others have soft edges.
        let sharp = rng.random_bool(0.5);
        canvas.light_up(at, value);
        for _ in 0..rng.random_range(20..300) {
            let z: f64 = StandardNormal.sample(rng);
            heading += bend * z;
            let next = add(at, polar(0.7 * pixel, heading));
            if sharp {
                canvas.light_up(next, value);
            } else {
                canvas.stroke([at, next], [0.5 * pixel; 2], value, Blend::Max);
            }
            at = next;
        }
    }
}
