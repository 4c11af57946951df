//! Kernels on their own grid, their blend, and how one is placed on the pixels of the sensor.

/// A set of kernels. All have the same side, and a sum of 1.
#[derive(Clone, Debug)]
pub(super) struct Set {
    /// Kernels, [design][slice][node]: [side, side] each, row by row.
    pub images: Vec<Vec<Vec<Vec<f32>>>>,
    /// Side of a kernel, samples; odd.
    pub side: usize,
    /// Distance between samples, sensor pixels.
    pub step_px: f64,
}

/// Where and how a kernel lies on the pixels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placed {
    /// Centre (row, col) from the middle of the middle pixel, pixels.
    pub rest: [f64; 2],
    /// Turn, rad, from the column axis to the row axis.
    pub turn_rad: f64,
    /// Factor on the size.
    pub stretch: f64,
    /// Samples in a pixel along each axis.
    pub samples: usize,
}

impl Set {
    /// Number of designs.
    pub(super) fn designs(&self) -> usize {
        self.images.len()
    }

    /// Number of slices in depth.
    pub(super) fn slices(&self) -> usize {
        self.images.first().map_or(0, Vec::len)
    }

    /// Blends designs by `weights` (their sum is 1), the slices around `slice` (0: the middle one), and the nodes
    /// around
    /// field `h` (a corner of the object is at a distance of 1), into `out`, [side, side].
    pub(super) fn blend(&self, weights: &[f64], slice: f64, h: [f64; 2], out: &mut Vec<f32>) {
        out.clear();
        out.resize(self.side * self.side, 0.0);
        for (design, weight) in self.images.iter().zip(weights) {
            let middle = (design.len() as f64 - 1.0) / 2.0;
            for (s, of_slice) in around(middle + slice, design.len()) {
                let Some(nodes) = design.get(s) else { continue };
                // Nodes fill a square that reaches from corner to corner.
                let grid = (nodes.len() as f64).sqrt().round() as usize;
                let at = |h: f64| (0.5 + 0.5 * h * std::f64::consts::SQRT_2) * (grid as f64 - 1.0);
                for (i, of_row) in around(at(h[0]), grid) {
                    for (j, of_col) in around(at(h[1]), grid) {
                        let share = (weight * of_slice * of_row * of_col) as f32;
                        if share != 0.0 {
                            out.iter_mut().zip(&nodes[i * grid + j]).for_each(|(v, k)| *v += share * k);
                        }
                    }
                }
            }
        }
    }

    /// Averages a kernel over the pixels of a field of `side` x `side`, and scales the result to a sum of 1.
    pub(super) fn place(&self, kernel: &[f32], placed: &Placed, side: usize, out: &mut Vec<f32>) {
        out.clear();
        out.resize(side * side, 0.0);
        let (sin, cos) = placed.turn_rad.sin_cos();
        let scale = 1.0 / (placed.stretch * self.step_px);
        let (middle, centre) = ((side / 2) as f64, (self.side / 2) as f64);
        let n = placed.samples;
        let last = self.side - 1;
        for (i, row) in out.chunks_exact_mut(side).enumerate() {
            for a in 0..n {
                let y = i as f64 + (a as f64 + 0.5) / n as f64 - 0.5 - middle - placed.rest[0];
                for (j, pixel) in row.iter_mut().enumerate() {
                    for b in 0..n {
                        let x = j as f64 + (b as f64 + 0.5) / n as f64 - 0.5 - middle - placed.rest[1];
                        // The kernel turns forward, so its samples are found by turning back.
                        let r = (y * cos - x * sin) * scale + centre;
                        let c = (x * cos + y * sin) * scale + centre;
                        if r < 0.0 || c < 0.0 || r >= last as f64 || c >= last as f64 {
                            continue;
                        }
                        let (r0, c0) = (r as usize, c as usize);
                        let (fr, fc) = ((r - r0 as f64) as f32, (c - c0 as f64) as f32);
                        let at = r0 * self.side + c0;
                        let upper = kernel[at] + fc * (kernel[at + 1] - kernel[at]);
                        let (lower, next) = (kernel[at + self.side], kernel[at + self.side + 1]);
                        let lower = lower + fc * (next - lower);
                        *pixel += upper + fr * (lower - upper);
                    }
                }
            }
        }
        let sum: f32 = out.iter().sum();
        out.iter_mut().for_each(|v| *v /= sum.max(f32::MIN_POSITIVE));
    }
}

/// The two samples around a place, with their weights; the ends hold beyond.
fn around(at: f64, n: usize) -> [(usize, f64); 2] {
    let at = at.clamp(0.0, n.saturating_sub(1) as f64);
    let low = (at as usize).min(n.saturating_sub(2));
    let f = at - low as f64;
    [(low, 1.0 - f), ((low + 1).min(n.saturating_sub(1)), f)]
}

/// Makes a kernel's sum 1. False: it has no light.
pub(super) fn normalise(kernel: &mut [f32]) -> bool {
    let sum: f64 = kernel.iter().map(|v| f64::from(*v)).sum();
    if sum > 0.0 {
        kernel.iter_mut().for_each(|v| *v = (f64::from(*v) / sum) as f32);
    }
    sum > 0.0
}

/// Centroid (row, col) and root mean square radius of a kernel of `side` x `side`, samples.
pub(super) fn moments(kernel: &[f32], side: usize) -> ([f64; 2], f64) {
    let total: f64 = kernel.iter().map(|v| f64::from(*v)).sum();
    let mean = |of: &dyn Fn(f64, f64) -> f64| {
        let at = |i: usize| of((i / side) as f64, (i % side) as f64);
        kernel.iter().enumerate().map(|(i, v)| f64::from(*v) * at(i)).sum::<f64>() / total.max(f64::MIN_POSITIVE)
    };
    let [r, c] = [mean(&|r, _| r), mean(&|_, c| c)];
    ([r, c], mean(&|y, x| (y - r).powi(2) + (x - c).powi(2)).sqrt())
}
