//! Undulating worms with a tapering body and bright gut granules. With time, a wave runs down the body and the worm
//! glides along its heading.

use super::canvas::{Blend, Canvas, Point, add, direction, length, log_uniform, polar, sub};
use rand::{Rng, RngExt};
use std::f64::consts::{PI, TAU};

/// Undulations per second of a swimming worm (C. elegans in water: about 1.8; Gray & Lissmann, J. Exp. Biol. 41, 135,
/// 1964).
const HZ: f64 = 1.8;
/// Distance that a worm glides in one undulation, body lengths.
const STRIDE: f64 = 0.12;

pub(super) fn draw(canvas: &mut Canvas, time_s: f64, rng: &mut impl Rng) {
    for _ in 0..canvas.number(log_uniform(rng, 20.0, 110.0)) {
        let brightness = log_uniform(rng, 0.25, 1.0);
        let thickest = rng.random_range(5.0..9.0);
        let body = midline(canvas.anywhere(rng), time_s, rng);
        let n = body.len() as f64;
        let radius = |i: usize| thickest * (PI * (i as f64 + 0.6) / (n + 0.2)).sin().max(0.0).powf(0.6);
        for i in 1..body.len() {
            canvas.stroke([body[i - 1], body[i]], [radius(i - 1), radius(i)], 0.55 * brightness, Blend::Max);
        }
        for _ in 0..rng.random_range(4..14) {
            let i = rng.random_range(1..body.len());
            let to = add(body[i], polar(0.4 * radius(i), direction(rng)));
            canvas.disc(to, rng.random_range(1.4..2.8), brightness, Blend::Max);
        }
    }
}

/// Points along the body, about 6 um apart, from head to tail.
fn midline(head: Point, time_s: f64, rng: &mut impl Rng) -> Vec<Point> {
    let body_um = rng.random_range(110.0..240.0);
    let (heading, phase) = (direction(rng), direction(rng));
    let (bend, waves) = (rng.random_range(0.4..1.0), rng.random_range(0.8..1.8));
    let steps = (body_um / 6.0) as usize;
    // The wave runs from the head to the tail.
    let posture = |time_s: f64| {
        let mut points = vec![head];
        let mut at = head;
        for k in 0..steps {
            let angle = heading + bend * (TAU * (waves * k as f64 / steps as f64 - HZ * time_s) + phase).sin();
            at = add(at, polar(6.0, angle));
            points.push(at);
        }
        points
    };
    let mut points = posture(time_s);
    debug_assert!(points.iter().all(|at| length(sub(*at, head)) <= body_um));
    if time_s != 0.0 {
        // The middle of the worm glides in the direction opposite to that from head to tail.
        let middle = |points: &[Point]| {
            let sum = points.iter().fold([0.0; 2], |sum, p| add(sum, *p));
            sum.map(|v| v / points.len() as f64)
        };
        let to = add(middle(&posture(0.0)), polar(-STRIDE * body_um * HZ * time_s, heading));
        let by = sub(to, middle(&points));
        points.iter_mut().for_each(|p| *p = add(*p, by));
    }
    points
}
