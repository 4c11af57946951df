//! The optics as an explicit matrix: for each object pixel the window of light behind each lens.

use ndarray::Array2;
use pulp::Arch;
use rayon::prelude::*;

/// Most vectors that are multiplied at the same time.
pub(crate) const LANES: usize = 16;

/// The light of unit sources at all object pixels behind all lenses, electrons at the exposure of the calibration.
pub(crate) struct Views {
    object: [usize; 2],
    sensor: [usize; 2],
    /// Rows and columns of a window.
    side: usize,
    /// For each lens the sensor pixel at which the window of object pixel (0, 0) begins, [row, col]. That of pixel
    /// (r, c) begins r rows and c columns further.
    corners: Vec<[isize; 2]>,
    /// For each lens [object pixels, side, side].
    windows: Vec<Vec<f32>>,
}

impl Views {
    /// Dark windows of `side` pixels that begin at `corners` for object pixel (0, 0).
    pub(super) fn dark(object: [usize; 2], sensor: [usize; 2], side: usize, corners: Vec<[isize; 2]>) -> Self {
        let windows = vec![vec![0.0; object[0] * object[1] * side * side]; corners.len()];
        Self { object, sensor, side, corners, windows }
    }

    /// Number of object pixels.
    pub(crate) fn unknowns(&self) -> usize {
        self.object[0] * self.object[1]
    }

    /// Rows and columns of the object.
    pub(crate) fn object(&self) -> [usize; 2] {
        self.object
    }

    /// Takes the window of an object pixel from the image of a lens.
    pub(super) fn take(&mut self, lens: usize, [r, c]: [usize; 2], image: &Array2<f32>) {
        let (area, x) = (self.side * self.side, r * self.object[1] + c);
        let from = self.corner(lens, x);
        for (i, v) in self.windows[lens][x * area..(x + 1) * area].iter_mut().enumerate() {
            let at = [from[0] + (i / self.side) as isize, from[1] + (i % self.side) as isize];
            if let (Ok(row), Ok(col)) = (usize::try_from(at[0]), usize::try_from(at[1])) {
                *v = image.get((row, col)).copied().unwrap_or(0.0);
            }
        }
    }

    /// The sensor pixel at which the window of object pixel `x` begins.
    fn corner(&self, lens: usize, x: usize) -> [isize; 2] {
        let [row, col] = self.corners[lens];
        [row + (x / self.object[1]) as isize, col + (x % self.object[1]) as isize]
    }

    /// The window of an object pixel.
    fn window(&self, lens: usize, x: usize) -> &[f32] {
        let area = self.side * self.side;
        &self.windows[lens][x * area..(x + 1) * area]
    }

    /// Calls `row` with the part of each window row of object pixel `x` that lies on the sensor: its first sensor pixel
    /// and its values.
    #[inline(always)]
    fn each_row(&self, x: usize, mut row: impl FnMut(usize, &[f32])) {
        for lens in 0..self.corners.len() {
            let ([top, left], window) = (self.corner(lens, x), self.window(lens, x));
            let first = (-left).clamp(0, self.side as isize) as usize;
            let last = (self.sensor[1] as isize - left).clamp(first as isize, self.side as isize) as usize;
            for (i, values) in window.chunks_exact(self.side).enumerate() {
                let r = top + i as isize;
                if first < last && (0..self.sensor[0] as isize).contains(&r) {
                    let at = r * self.sensor[1] as isize + left + first as isize;
                    row(at as usize, &values[first..last]);
                }
            }
        }
    }

    /// A x for L objects at once: [object pixels] -> [sensor pixels].
    pub(crate) fn forward<const L: usize>(&self, objects: &[[f32; L]]) -> Vec<[f32; L]> {
        let empty = || vec![[0.0; L]; self.sensor[0] * self.sensor[1]];
        let band = self.unknowns().div_ceil(rayon::current_num_threads()).max(1);
        let parts = objects.par_chunks(band).enumerate().map(|(b, objects)| {
            let mut out = empty();
            for (i, light) in objects.iter().enumerate() {
                Arch::new().dispatch(|| {
                    self.each_row(b * band + i, |at, values| {
                        for (out, h) in out[at..at + values.len()].iter_mut().zip(values) {
                            out.iter_mut().zip(light).for_each(|(o, x)| *o += h * x);
                        }
                    });
                });
            }
            out
        });
        parts.reduce(empty, |mut a, b| {
            a.iter_mut().zip(&b).for_each(|(a, b)| a.iter_mut().zip(b).for_each(|(a, b)| *a += b));
            a
        })
    }

    /// A' y for L frames at once: [sensor pixels] -> [object pixels].
    pub(crate) fn adjoint<const L: usize>(&self, frames: &[[f32; L]]) -> Vec<[f32; L]> {
        let one = |x: usize| {
            Arch::new().dispatch(|| {
                let mut sum = [0.0f32; L];
                self.each_row(x, |at, values| {
                    for (y, h) in frames[at..at + values.len()].iter().zip(values) {
                        sum.iter_mut().zip(y).for_each(|(s, y)| *s += h * y);
                    }
                });
                sum
            })
        };
        (0..self.unknowns()).into_par_iter().map(one).collect()
    }

    /// A' W A for weights of the sensor pixels: the upper triangle, row by row, [object pixels, object pixels].
    pub(crate) fn normal(&self, weight: &[f32]) -> Vec<f32> {
        let (n, side) = (self.unknowns(), self.side as isize);
        let mut out = vec![0.0f32; n * n];
        out.par_chunks_mut(n).enumerate().for_each(|(x, row)| {
            let mut own = vec![0.0f32; self.side * self.side];
            for lens in 0..self.corners.len() {
                let from = self.corner(lens, x);
                for (i, (own, h)) in own.iter_mut().zip(self.window(lens, x)).enumerate() {
                    let at = [from[0] + i as isize / side, from[1] + i as isize % side];
                    let on = [0, 1].iter().all(|a| (0..self.sensor[*a] as isize).contains(&at[*a]));
                    *own = if on { h * weight[at[0] as usize * self.sensor[1] + at[1] as usize] } else { 0.0 };
                }
                Arch::new().dispatch(|| {
                    for other in 0..self.corners.len() {
                        self.meet(from, &own, other, x, row);
                    }
                });
            }
        });
        out
    }

    /// Adds to `row` the products of a weighted window, which begins at `from`, with the windows of all object pixels
    /// from `first` on behind lens `lens`.
    #[inline(always)]
    fn meet(&self, from: [isize; 2], own: &[f32], lens: usize, first: usize, row: &mut [f32]) {
        let (side, near) = (self.side as isize, |a: usize| {
            let middle = from[a] - self.corners[lens][a];
            (middle - self.side as isize + 1).max(0)..(middle + self.side as isize).min(self.object[a] as isize)
        });
        for r in near(0) {
            for c in near(1) {
                let x = r as usize * self.object[1] + c as usize;
                if x < first {
                    continue;
                }
                let (at, window) = (self.corner(lens, x), self.window(lens, x));
                let [down, right] = [at[0] - from[0], at[1] - from[1]];
                let width = (side - right.abs()) as usize;
                let (a, b) = (right.max(0) as usize, (-right).max(0) as usize);
                row[x] += (down.max(0)..side.min(side + down))
                    .map(|i| {
                        let (p, q) = ((i * side) as usize + a, ((i - down) * side) as usize + b);
                        dot(&own[p..p + width], &window[q..q + width])
                    })
                    .sum::<f32>();
            }
        }
    }
}

/// Sum of products in eight partial sums, which the compiler keeps in vectors.
#[inline(always)]
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut sums = [0.0f32; 8];
    let (left, right) = (a.chunks_exact(8), b.chunks_exact(8));
    let rest: f32 = left.remainder().iter().zip(right.remainder()).map(|(a, b)| a * b).sum();
    for (a, b) in left.zip(right) {
        sums.iter_mut().zip(a.iter().zip(b)).for_each(|(s, (a, b))| *s += a * b);
    }
    rest + sums.iter().sum::<f32>()
}
