//! Brain sections: bands of labelled cells of different density over a glowing, mottled neuropil, with dark fibre tracts and vessels.
//!
//! Unlike the other specimens it is bright nearly everywhere, as tissue is: the overlapping views have no dark ground to stand on.

use super::canvas::{Blend, Canvas, Point, add, direction, length, log_uniform, polar, sub};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

/// Waves that the mottle of the neuropil is made of.
const WAVES: usize = 120;
/// Longest and shortest of them, um; their strength goes with the root of the length, between white noise and smooth shading.
const WAVE_UM: [f64; 2] = [12.0, 400.0];
/// Mean light of the neuropil where a cell has 1.
const GROUND: f64 = 0.25;

pub(super) fn draw(canvas: &mut Canvas, rng: &mut impl Rng) {
    let [h, w] = canvas.half_um();
    ground(canvas, rng);
    // Layers run across the field; each has a density of its own.
    let across = direction(rng);
    let extent = h.hypot(w);
    let mut edge = -extent;
    while edge < extent {
        let next = edge + log_uniform(rng, 40.0, 220.0);
        let (per_mm2, radius) = (log_uniform(rng, 80.0, 2500.0), rng.random_range(4.0..8.0));
        let share = (next.min(extent) - edge) / (2.0 * extent);
        for _ in 0..(per_mm2 * canvas.area_mm2() * share).round() as usize {
            let deep = rng.random_range(edge..next);
            let at = add(
                polar(deep, across),
                polar(rng.random_range(-extent..extent), across + std::f64::consts::FRAC_PI_2),
            );
            if at[0].abs() < h && at[1].abs() < w {
                canvas.disc(at, radius * rng.random_range(0.8..1.25), log_uniform(rng, 0.25, 1.0), Blend::Max);
            }
        }
        edge = next;
    }
    for _ in 0..canvas.number(12.0) {
        let radius = log_uniform(rng, 4.0, 14.0);
        let (at, heading) = (canvas.anywhere(rng), if rng.random_bool(0.6) { across } else { direction(rng) });
        shadow(canvas, [at, add(at, polar(rng.random_range(30.0..200.0), heading))], radius);
    }
}

/// A sum of plane waves of random direction, length and phase, about an even light, never below zero.
fn ground(canvas: &mut Canvas, rng: &mut impl Rng) {
    let [h, w] = canvas.half_um();
    let waves: Vec<(Point, f64, f64)> = (0..WAVES)
        .map(|_| {
            let um = log_uniform(rng, WAVE_UM[0], WAVE_UM[1]);
            let z: f64 = StandardNormal.sample(rng);
            (polar(std::f64::consts::TAU / um, direction(rng)), direction(rng), z * (um / WAVE_UM[1]).sqrt())
        })
        .collect();
    let norm = (waves.iter().map(|(_, _, a)| a * a / 2.0).sum::<f64>()).sqrt().max(f64::MIN_POSITIVE);
    canvas.paint([[-h, -w], [h, w]], 0.0, Blend::Add, |p| {
        let mottle: f64 = waves.iter().map(|(k, phase, a)| a * (k[0] * p[0] + k[1] * p[1] + phase).sin()).sum();
        (f64::NEG_INFINITY, (GROUND * (1.0 + 0.35 * mottle / norm)).max(0.0))
    });
}

/// A dark stroke with soft ends: what does not glow hides what lies there.
fn shadow(canvas: &mut Canvas, ends: [Point; 2], radius: f64) {
    let axis = sub(ends[1], ends[0]);
    let square = axis[0] * axis[0] + axis[1] * axis[1];
    canvas.dim(ends, radius, |p| {
        let q = sub(p, ends[0]);
        let t = ((q[0] * axis[0] + q[1] * axis[1]) / square.max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        length(sub(q, [t * axis[0], t * axis[1]])) - radius
    });
}
