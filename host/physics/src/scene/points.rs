//! Sources of a single object pixel, from a few to a tenth of all pixels: the sharpest specimen that the grid holds.

use super::canvas::{Canvas, log_uniform};
use rand::Rng;

pub(super) fn draw(canvas: &mut Canvas, rng: &mut impl Rng) {
    let most = 0.1 * canvas.pixels() as f64;
    let dimmest = log_uniform(rng, 0.05, 1.0);
    for _ in 0..log_uniform(rng, 3.0, most.max(4.0)) as usize {
        let at = canvas.anywhere(rng);
        canvas.point(at, log_uniform(rng, dimmest, 1.0 + 1e-9));
    }
}
