//! Neurons: a bright soma and dendrites that wander, taper and branch.

use super::canvas::{Blend, Canvas, Point, add, direction, log_uniform, polar};
use rand::{Rng, RngExt};

pub(super) fn draw(canvas: &mut Canvas, rng: &mut impl Rng) {
    for _ in 0..canvas.number(log_uniform(rng, 30.0, 160.0)) {
        let soma = canvas.anywhere(rng);
        let radius = rng.random_range(5.0..9.0);
        let brightness = log_uniform(rng, 0.3, 1.0);
        canvas.disc(soma, radius, brightness, Blend::Max);
        let dendrites = rng.random_range(3..7);
        let first = direction(rng);
        for k in 0..dendrites {
            let angle =
                first + std::f64::consts::TAU * f64::from(k) / f64::from(dendrites) + rng.random_range(-0.4..0.4);
            let from = add(soma, polar(0.8 * radius, angle));
            let reach = rng.random_range(40.0..120.0);
            let width = rng.random_range(1.2..2.4);
            dendrite(canvas, rng, Tip { at: from, angle, radius: width, left: reach }, brightness, 3);
        }
    }
}

/// The growing end of a dendrite.
#[derive(Clone, Copy)]
struct Tip {
    at: Point,
    angle: f64,
    radius: f64,
    left: f64,
}

fn dendrite(canvas: &mut Canvas, rng: &mut impl Rng, mut tip: Tip, brightness: f64, branches: u32) {
    const STEP_UM: f64 = 6.0;
    while tip.left > 0.0 {
        tip.angle += rng.random_range(-0.28..0.28);
        let next = add(tip.at, polar(STEP_UM, tip.angle));
        let thin = (tip.radius * 0.97).max(0.6);
        canvas.stroke([tip.at, next], [tip.radius, thin], 0.75 * brightness, Blend::Max);
        tip = Tip { at: next, angle: tip.angle, radius: thin, left: tip.left - STEP_UM };
        if branches > 0 && rng.random_bool(0.08) {
            let side = if rng.random_bool(0.5) { 0.7 } else { -0.7 };
            let twig = Tip { angle: tip.angle + side, radius: 0.8 * tip.radius, left: 0.7 * tip.left, ..tip };
            dendrite(canvas, rng, twig, brightness, branches - 1);
        }
    }
}
