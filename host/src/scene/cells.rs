//! Cell bodies: tilted ellipses with an uneven membrane, some with a dark or a bright nucleus.

use super::canvas::{Blend, Canvas, Ink, Point, add, direction, length, log_uniform, polar, sub};
use rand::{Rng, RngExt};
use std::f64::consts::TAU;

/// How a cell is labelled.
#[derive(Clone, Copy)]
enum Label {
    /// In the cytosol: the nucleus is dark.
    Cytosol,
    /// In the nucleus: the rest of the body is dim.
    Nucleus,
    /// In the whole cell.
    Whole,
}

pub(super) fn draw(canvas: &mut Canvas, rng: &mut impl Rng) {
    let label = [Label::Cytosol, Label::Nucleus, Label::Whole][rng.random_range(0..3)];
    for _ in 0..canvas.number(log_uniform(rng, 150.0, 1400.0)) {
        let centre = canvas.anywhere(rng);
        let radius = rng.random_range(6.0..13.0);
        let brightness = log_uniform(rng, 0.15, 1.0);
        cell(canvas, rng, label, centre, radius, brightness);
    }
}

fn cell(canvas: &mut Canvas, rng: &mut impl Rng, label: Label, centre: Point, radius: f64, brightness: f64) {
    let (stretch, tilt) = (rng.random_range(0.65..1.0), direction(rng));
    let lobes: [(f64, f64); 3] = std::array::from_fn(|_| (rng.random_range(0.0..0.09), rng.random_range(0.0..TAU)));
    let nucleus = add(centre, polar(0.2 * radius, direction(rng)));
    let (body, core) = match label {
        Label::Cytosol => (brightness, 0.25 * brightness),
        Label::Nucleus => (0.12 * brightness, brightness),
        Label::Whole => (brightness, brightness),
    };
    canvas.paint([centre, centre], 1.3 * radius, Blend::Add, |p| {
        let [y, x] = sub(p, centre);
        let (along, across) = (x * tilt.cos() + y * tilt.sin(), (y * tilt.cos() - x * tilt.sin()) / stretch);
        let angle = across.atan2(along);
        let wave: f64 = lobes.iter().enumerate().map(|(k, (a, ph))| a * ((k + 2) as f64 * angle + ph).cos()).sum();
        let inside = length(sub(p, nucleus)) < 0.45 * radius;
        let distance_um = along.hypot(across) - radius * (1.0 + wave);
        Ink { distance_um, value: if inside { core } else { body } }
    });
}
