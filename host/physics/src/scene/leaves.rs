//! Dead leaves: opaque ellipses of all sizes on top of each other, even or textured. Their edges and areas follow the
//! same laws at every scale, as those of pictures of nature do (A. B. Lee, D. Mumford, J. Huang, Int. J. Comput. Vis.
//! 41, 35 (2001)).

use super::canvas::{Blend, Canvas, Ink, Point, direction, log_uniform, polar, sub};
use rand::{Rng, RngExt};
use std::f64::consts::TAU;

/// Smallest and largest semi-axis, pixels.
const RADIUS_PX: [f64; 2] = [1.2, 15.0];
/// Shortest and longest period of a texture, pixels.
const PERIOD_PX: [f64; 2] = [2.5, 25.0];

pub(super) fn draw(canvas: &mut Canvas, rng: &mut impl Rng) {
    let pixel = canvas.pixel_um();
    // Radii r have the density r^-power.
    let power = rng.random_range(1.5..3.0) - 1.0;
    let [least, most] = RADIUS_PX.map(|r| r.powf(-power));
    let dark = rng.random_range(0.1..0.8);
    let per_pixel = log_uniform(rng, 0.002, 0.065);
    let count = (per_pixel * canvas.pixels() as f64).ceil() as usize;
    for leaf in 1..=count {
        let radius = pixel * (least + rng.random::<f64>() * (most - least)).powf(-1.0 / power);
        // The last one lies on top and shines, so that no scene is dark.
        let value = if leaf < count && rng.random_bool(dark) { 0.0 } else { rng.random_range(0.08..1.0) };
        let (centre, tilt, slim) = (canvas.anywhere(rng), direction(rng), rng.random_range(0.2..1.0));
        let (sin, cos) = tilt.sin_cos();
        let texture = Texture::draw(pixel, rng);
        canvas.paint([centre, centre], radius, Blend::Over, |p| {
            let [y, x] = sub(p, centre);
            let (along, across) = (cos * y + sin * x, (cos * x - sin * y) / slim);
            // The distance to an ellipse, to first order.
            Ink { distance_um: (along.hypot(across) - radius) * slim, value: value * texture.at(p) }
        });
    }
}

/// A mean of plane waves on top of even light.
struct Texture {
    contrast: f64,
    /// Wave vector, rad/um, and phase of each wave.
    waves: [(Point, f64); 4],
}

impl Texture {
    /// No texture for half of the leaves.
    fn draw(pixel_um: f64, rng: &mut impl Rng) -> Self {
        let contrast = if rng.random_bool(0.5) { rng.random_range(0.2..1.0) } else { 0.0 };
        let [short, long] = PERIOD_PX;
        let wave = |_| {
            let period_um = pixel_um * log_uniform(rng, short, long);
            (polar(TAU / period_um, direction(rng)), direction(rng))
        };
        Self { contrast, waves: std::array::from_fn(wave) }
    }

    fn at(&self, p: Point) -> f64 {
        let wave = |(k, phase): &(Point, f64)| (k[0] * p[0] + k[1] * p[1] + phase).cos();
        1.0 + self.contrast * self.waves.iter().map(wave).sum::<f64>() / self.waves.len() as f64
    }
}
