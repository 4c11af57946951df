//! Resolution targets: three-bar groups of several pitches, or a Siemens star.

use super::canvas::{Blend, Canvas, Ink, Point, add, direction, length, polar, sub};
use rand::{Rng, RngExt};

pub(super) fn draw(canvas: &mut Canvas, rng: &mut impl Rng) {
    if rng.random_bool(0.4) { siemens_star(canvas, rng) } else { bars(canvas, rng) }
}

/// A star of bright spokes, finest at its centre.
fn siemens_star(canvas: &mut Canvas, rng: &mut impl Rng) {
    let [h, w] = canvas.half_um();
    let centre = [rng.random_range(-0.4 * h..0.4 * h), rng.random_range(-0.4 * w..0.4 * w)];
    let radius = rng.random_range(0.5..0.9) * h.min(w);
    let spokes = f64::from(rng.random_range(8..25));
    let phase = direction(rng);
    let bore = spokes * canvas.pixel_um() / std::f64::consts::PI;
    canvas.paint([centre, centre], radius, Blend::Add, |p| {
        let d = sub(p, centre);
        let r = length(d);
        // Distance to the nearest edge of a spoke along the circle. The bore is left dark: pixels cannot resolve spokes
        // there.
        let wave = (spokes * d[0].atan2(d[1]) + phase).sin();
        let edge = -wave.asin() / spokes * r;
        Ink { distance_um: (r - radius).max(edge).max(0.5 * bore - r), value: 1.0 }
    });
}

/// Groups of three horizontal and three vertical bars of random widths, as on the USAF-1951 chart.
fn bars(canvas: &mut Canvas, rng: &mut impl Rng) {
    let pixel = canvas.pixel_um();
    for _ in 0..canvas.number(rng.random_range(60.0..200.0)) {
        let bar_um = pixel * 2f64.powf(rng.random_range(0.0..3.0));
        let at = canvas.anywhere(rng);
        let tilt = if rng.random_bool(0.7) { 0.0 } else { direction(rng) };
        let value = rng.random_range(0.4..1.0);
        group(canvas, at, tilt, bar_um, value);
        group(canvas, add(at, polar(7.0 * bar_um, tilt)), tilt + std::f64::consts::FRAC_PI_2, bar_um, value);
    }
}

fn group(canvas: &mut Canvas, centre: Point, tilt: f64, bar_um: f64, value: f64) {
    for k in [-1.0, 0.0, 1.0] {
        let middle = add(centre, polar(2.0 * bar_um * k, tilt + std::f64::consts::FRAC_PI_2));
        canvas.paint([middle, middle], 3.6 * bar_um, Blend::Max, |p| {
            let [y, x] = sub(p, middle);
            let (along, across) = (x * tilt.cos() + y * tilt.sin(), y * tilt.cos() - x * tilt.sin());
            Ink { distance_um: (along.abs() - 2.5 * bar_um).max(across.abs() - 0.5 * bar_um), value }
        });
    }
}
