//! Brain sections: layers of labelled cells of different densities on a bright, mottled neuropil, with dark fibre
//! tracts and vessels.
//!
//! Unlike the other specimens, a section is bright nearly everywhere, like tissue, so the overlapping views have no
//! dark background.

use super::canvas::{Blend, Canvas, Ink, Point, add, direction, length, log_uniform, polar, sub};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

/// Number of waves in the mottle of the neuropil.
const WAVES: usize = 120;
/// Shortest and longest wave, um. The amplitude grows with the square root of the length: between white noise and
/// smooth shading.
const WAVE_UM: [f64; 2] = [12.0, 400.0];
/// Mean light of the neuropil, relative to the brightest cells.
const GROUND: f64 = 0.25;

pub(super) fn draw(canvas: &mut Canvas, rng: &mut impl Rng) {
    let [h, w] = canvas.half_um();
    ground(canvas, rng);
    // Layers run across the field; each has its own density of cells.
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

/// Even light plus plane waves of random direction, length and phase, never below zero.
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
        Ink { distance_um: f64::NEG_INFINITY, value: (GROUND * (1.0 + 0.35 * mottle / norm)).max(0.0) }
    });
}

/// A dark stroke with round ends, which hides what is under it.
fn shadow(canvas: &mut Canvas, ends: [Point; 2], radius: f64) {
    let axis = sub(ends[1], ends[0]);
    let square = axis[0] * axis[0] + axis[1] * axis[1];
    canvas.dim(ends, radius, |p| {
        let q = sub(p, ends[0]);
        let t = ((q[0] * axis[0] + q[1] * axis[1]) / square.max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        length(sub(q, [t * axis[0], t * axis[1]])) - radius
    });
}
