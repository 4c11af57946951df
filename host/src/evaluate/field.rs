//! Error against field radius. Aberrations and vignetting grow towards the edge, so one figure for a whole frame is not
//! enough.

use crate::metrics::psnr_db;
use crate::session::ObjectGrid;
use ndarray::{Array2, ArrayView2};
use serde::{Deserialize, Serialize};

/// Figures of one ring of the field.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Ring {
    /// Inner radius, um from the centre of the object grid.
    pub inner_um: f64,
    /// Outer radius, um.
    pub outer_um: f64,
    /// Number of object pixels in the ring.
    pub pixels: usize,
    /// Root mean squared error over all frames relative to the root mean squared truth in the ring; 0 where the truth
    /// is 0.
    pub nrmse: f64,
    /// Peak signal-to-noise ratio in the ring, dB, from the mean squared error relative to the squared maximum of each
    /// frame, averaged over frames.
    pub psnr_db: f64,
}

/// Sums of errors in rings of equal width around the centre of the object grid.
#[derive(Clone, Debug)]
pub struct Rings {
    ring_of_pixel: Array2<usize>,
    width_um: f64,
    pixels: Vec<usize>,
    squared_error: Vec<f64>,
    squared_truth: Vec<f64>,
    relative_error: Vec<f64>,
    frames: f64,
}

impl Rings {
    /// `count` rings between the centre and the corner of the grid.
    pub fn new(grid: &ObjectGrid, count: usize) -> Self {
        let centre = [(grid.rows as f64 - 1.0) / 2.0, (grid.cols as f64 - 1.0) / 2.0];
        let radius = |r: usize, c: usize| (r as f64 - centre[0]).hypot(c as f64 - centre[1]) * grid.pixel_um;
        let width_um = radius(0, 0).max(f64::MIN_POSITIVE) / count as f64;
        let ring = |(r, c)| ((radius(r, c) / width_um) as usize).min(count - 1);
        let ring_of_pixel = Array2::from_shape_fn((grid.rows, grid.cols), ring);
        let mut pixels = vec![0; count];
        ring_of_pixel.iter().for_each(|&i| pixels[i] += 1);
        let zeros = vec![0.0; count];
        Self {
            ring_of_pixel,
            width_um,
            pixels,
            squared_error: zeros.clone(),
            squared_truth: zeros.clone(),
            relative_error: zeros,
            frames: 0.0,
        }
    }

    /// Adds one frame: the reconstruction `x` times `scale` against the truth, both [object rows, object cols] (the
    /// caller checks the shapes).
    pub fn add(&mut self, x: ArrayView2<'_, f32>, truth: ArrayView2<'_, f32>, scale: f64) {
        let peak = truth.iter().fold(0.0f64, |m, &v| m.max(f64::from(v)));
        for ((&ring, &x), &t) in self.ring_of_pixel.iter().zip(x).zip(truth) {
            let (d, t) = (scale * f64::from(x) - f64::from(t), f64::from(t));
            self.squared_error[ring] += d * d;
            self.squared_truth[ring] += t * t;
            self.relative_error[ring] += d * d / (peak * peak);
        }
        self.frames += 1.0;
    }

    /// The figures of each ring that holds at least one pixel.
    pub fn figures(&self) -> Vec<Ring> {
        let ring = |i: usize| Ring {
            inner_um: i as f64 * self.width_um,
            outer_um: (i + 1) as f64 * self.width_um,
            pixels: self.pixels[i],
            nrmse: match self.squared_truth[i] {
                t if t > 0.0 => (self.squared_error[i] / t).sqrt(),
                _ => 0.0,
            },
            psnr_db: psnr_db(1.0, self.relative_error[i] / (self.pixels[i] as f64 * self.frames)),
        };
        (0..self.pixels.len()).filter(|&i| self.pixels[i] > 0).map(ring).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> ObjectGrid {
        ObjectGrid { rows: 20, cols: 20, pixel_um: 2.0 }
    }

    #[test]
    fn rings_cover_the_grid_to_its_corner() {
        let mut rings = Rings::new(&grid(), 4);
        rings.add(Array2::ones((20, 20)).view(), Array2::ones((20, 20)).view(), 1.0);
        let figures = rings.figures();
        assert_eq!(figures.iter().map(|r| r.pixels).sum::<usize>(), 400);
        let corner = 9.5 * 2.0 * std::f64::consts::SQRT_2;
        assert!((figures[3].outer_um - corner).abs() < 1e-9 && figures[0].inner_um == 0.0);
    }

    #[test]
    fn an_error_in_the_corner_shows_in_the_outer_ring_alone() {
        let mut rings = Rings::new(&grid(), 4);
        let truth = Array2::ones((20, 20));
        let mut x = truth.clone();
        x[[0, 0]] = 3.0f32;
        rings.add(x.view(), truth.view(), 1.0);
        let figures = rings.figures();
        assert!(figures[..3].iter().all(|r| r.nrmse == 0.0 && r.psnr_db == 200.0));
        let n = figures[3].pixels as f64;
        assert!((figures[3].nrmse - (4.0 / n).sqrt()).abs() < 1e-12);
        assert!((figures[3].psnr_db - 10.0 * (n / 4.0).log10()).abs() < 1e-9);
    }
}
