//! Vessel trees filled with dye. Branches follow Murray's law: the cubes of their radii sum to that of the parent (PNAS
//! 12, 207, 1926).

use super::canvas::{Blend, Canvas, Point, add, log_uniform, polar};
use rand::{Rng, RngExt};
use std::f64::consts::{FRAC_PI_2, PI};

/// Smallest radius of a vessel (a capillary), um.
const LEAST_UM: f64 = 2.2;

pub(super) fn draw(canvas: &mut Canvas, rng: &mut impl Rng) {
    for _ in 0..rng.random_range(1..4) {
        let [h, w] = canvas.half_um();
        let side = rng.random_range(0..4);
        let (start, inward) = match side {
            0 => ([-h, rng.random_range(-w..w)], FRAC_PI_2),
            1 => ([h, rng.random_range(-w..w)], -FRAC_PI_2),
            2 => ([rng.random_range(-h..h), -w], 0.0),
            _ => ([rng.random_range(-h..h), w], PI),
        };
        let radius = log_uniform(rng, 5.0, 13.0);
        let angle = inward + rng.random_range(-0.6..0.6);
        branch(canvas, rng, start, angle, radius, 0);
    }
}

fn branch(canvas: &mut Canvas, rng: &mut impl Rng, mut at: Point, mut angle: f64, radius: f64, depth: u32) {
    if depth > 14 || radius < LEAST_UM {
        return;
    }
    let [h, w] = canvas.half_um();
    let steps = rng.random_range(2..6);
    for _ in 0..steps {
        angle += rng.random_range(-0.22..0.22);
        let next = add(at, polar(2.5 * radius.max(5.0), angle));
        // The light of a filled tube grows with its thickness.
        canvas.stroke([at, next], [radius, radius], 0.35 + radius / 20.0, Blend::Max);
        at = next;
        if at[0].abs() > 1.1 * h || at[1].abs() > 1.1 * w {
            return;
        }
    }
    // Shares of the flow: r0^3 = r1^3 + r2^3.
    let share: f64 = rng.random_range(0.5..0.9);
    let (large, small) = (radius * share.cbrt(), radius * (1.0 - share).cbrt());
    let turn = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
    branch(canvas, rng, at, angle - turn * 0.35 * (1.0 - share) * 2.0, large, depth + 1);
    let side = angle + turn * rng.random_range(0.5..1.1);
    branch(canvas, rng, at, side, small, depth + 1);
}
