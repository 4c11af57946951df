//! The optics as an explicit matrix: for each object pixel the window of light behind each lens.
//!
//! Every product runs over whole rows of windows. So the rows of a window are filled up with zeros to whole vectors,
//! and a frame gets a border that every window which touches the sensor fits into; no inner loop has to look for an
//! edge.

use ndarray::Array2;
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

/// Most vectors that are multiplied at the same time.
pub(crate) const LANES: usize = 16;
/// The rows of windows are filled up to a multiple of so many values.
const VECTOR: usize = 8;
/// Number of rows of the normal matrix that are computed together.
const BLOCK: usize = 8;
/// Most values of a vector of the processor.
const WIDEST: usize = 16;
/// Number of windows that are multiplied with another one at the same time: each value of that is loaded once for all.
const AT_ONCE: usize = 4;

/// The light of unit sources at all object pixels behind all lenses, electrons at the exposure of the calibration.
pub(crate) struct Views {
    object: [usize; 2],
    sensor: [usize; 2],
    /// Rows and columns of a window.
    side: usize,
    /// For each lens the sensor pixel at which the window of object pixel (0, 0) begins, [row, col]. That of pixel
    /// (r, c) begins r rows and c columns further.
    corners: Vec<[isize; 2]>,
    /// For each lens [object pixels, side, width].
    windows: Vec<Vec<f32>>,
}

impl Views {
    /// Number of values that a matrix of this size takes.
    pub(crate) fn values(object: [usize; 2], side: usize, lenses: usize) -> usize {
        object[0] * object[1] * lenses * side * side.next_multiple_of(VECTOR)
    }

    /// Dark windows of `side` pixels that begin at `corners` for object pixel (0, 0).
    pub(crate) fn dark(object: [usize; 2], sensor: [usize; 2], side: usize, corners: Vec<[isize; 2]>) -> Self {
        let windows = vec![vec![0.0; Self::values(object, side, 1)]; corners.len()];
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

    /// Rows and columns of the sensor.
    pub(crate) fn sensor(&self) -> [usize; 2] {
        self.sensor
    }

    /// Takes the window of an object pixel from the image of a lens.
    pub(crate) fn take(&mut self, lens: usize, [r, c]: [usize; 2], image: &Array2<f32>) {
        let (area, width, x) = (self.side * self.width(), self.width(), r * self.object[1] + c);
        let [top, left] = self.corner(lens, x);
        for (i, row) in self.windows[lens][x * area..(x + 1) * area].chunks_exact_mut(width).enumerate() {
            for (j, v) in row[..self.side].iter_mut().enumerate() {
                if let (Ok(row), Ok(col)) = (usize::try_from(top + i as isize), usize::try_from(left + j as isize)) {
                    *v = image.get((row, col)).copied().unwrap_or(0.0);
                }
            }
        }
    }

    /// Number of values in which a row of a window is stored.
    fn width(&self) -> usize {
        self.side.next_multiple_of(VECTOR)
    }

    /// Rows and columns of a frame with its border.
    fn bordered(&self) -> [usize; 2] {
        [self.sensor[0] + 2 * self.side, self.sensor[1] + 2 * self.width()]
    }

    /// The sensor pixel at which the window of object pixel `x` begins.
    #[inline(always)]
    fn corner(&self, lens: usize, x: usize) -> [isize; 2] {
        let [row, col] = self.corners[lens];
        [row + (x / self.object[1]) as isize, col + (x % self.object[1]) as isize]
    }

    /// The pixel of a frame with its border at which the window of object pixel `x` begins. None: it does not touch the
    /// sensor.
    #[inline(always)]
    fn place(&self, lens: usize, x: usize) -> Option<usize> {
        let [row, col] = self.corner(lens, x);
        let (above, before) = (self.side as isize, self.width() as isize);
        let on = -above < row && row < self.sensor[0] as isize && -before < col && col < self.sensor[1] as isize;
        on.then(|| (row + above) as usize * self.bordered()[1] + (col + before) as usize)
    }

    /// The window of an object pixel.
    #[inline(always)]
    fn window(&self, lens: usize, x: usize) -> &[f32] {
        let area = self.side * self.width();
        &self.windows[lens][x * area..(x + 1) * area]
    }

    /// The index of the first pixel of sensor row `r` in a frame with its border.
    fn row(&self, r: usize) -> usize {
        (r + self.side) * self.bordered()[1] + self.width()
    }

    /// A frame with its border.
    fn with_border<T: Copy>(&self, frame: &[T], border: T) -> Vec<T> {
        let [rows, cols] = self.bordered();
        let mut out = vec![border; rows * cols];
        for (r, row) in frame.chunks_exact(self.sensor[1]).enumerate() {
            out[self.row(r)..][..row.len()].copy_from_slice(row);
        }
        out
    }

    /// A x for L objects at once: [object pixels] -> [sensor pixels].
    pub(crate) fn forward<const L: usize>(&self, objects: &[[f32; L]]) -> Vec<[f32; L]> {
        let [rows, cols] = self.bordered();
        let band = self.unknowns().div_ceil(rayon::current_num_threads()).max(1);
        let parts = objects.par_chunks(band).enumerate().map(|(b, objects)| {
            let mut out = vec![[0.0; L]; rows * cols];
            Arch::new().dispatch(Spread { views: self, first: b * band, objects, out: &mut out });
            out
        });
        let sum = parts.reduce_with(|mut a, b| {
            a.iter_mut().zip(&b).for_each(|(a, b)| a.iter_mut().zip(b).for_each(|(a, b)| *a += b));
            a
        });
        let sum = sum.unwrap_or_else(|| vec![[0.0; L]; rows * cols]);
        (0..self.sensor[0]).flat_map(|r| sum[self.row(r)..][..self.sensor[1]].iter().copied()).collect()
    }

    /// A' y for L frames at once: [sensor pixels] -> [object pixels].
    pub(crate) fn adjoint<const L: usize>(&self, frames: &[[f32; L]]) -> Vec<[f32; L]> {
        let frames = self.with_border(frames, [0.0; L]);
        let mut out = vec![[0.0; L]; self.unknowns()];
        let band = self.object[1].max(1);
        out.par_chunks_mut(band).enumerate().for_each(|(b, out)| {
            Arch::new().dispatch(Collect { views: self, first: b * band, frames: &frames, out });
        });
        out
    }

    /// A' W A for weights of the sensor pixels: the upper triangle, row by row, [object pixels, object pixels].
    pub(crate) fn normal(&self, weight: &[f32]) -> Vec<f32> {
        let n = self.unknowns();
        let weight = self.with_border(weight, 0.0);
        let mut out = vec![0.0f32; n * n];
        let area = self.side * 3 * self.width();
        // Blocks of successive object pixels of one row.
        let blocks = (0..self.object[0]).flat_map(|_| (0..self.object[1]).step_by(BLOCK));
        let mut rest = &mut out[..];
        let mut parts = Vec::new();
        let mut first = 0;
        for col in blocks {
            let count = BLOCK.min(self.object[1] - col);
            let (own, after) = rest.split_at_mut(count * n);
            parts.push((first, own));
            (rest, first) = (after, first + count);
        }
        parts.into_par_iter().for_each_init(
            // Whole vectors may reach beyond the last row.
            || (vec![0.0; BLOCK * area + WIDEST], vec![0.0; self.side * (self.width() + WIDEST)]),
            |(own, theirs), (first, out)| {
                Arch::new().dispatch(Meet { views: self, weight: &weight, first, own, theirs, out });
            },
        );
        out
    }
}

/// Adds the light of objects from pixel `first` on to frames with their border.
struct Spread<'a, const L: usize> {
    views: &'a Views,
    first: usize,
    objects: &'a [[f32; L]],
    out: &'a mut [[f32; L]],
}

impl<const L: usize> WithSimd for Spread<'_, L> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (width, cols) = (self.views.width(), self.views.bordered()[1]);
        for (i, light) in self.objects.iter().enumerate() {
            for lens in 0..self.views.corners.len() {
                let Some(at) = self.views.place(lens, self.first + i) else { continue };
                let window = self.views.window(lens, self.first + i);
                for (row, values) in window.chunks_exact(width).enumerate() {
                    let out = &mut self.out[at + row * cols..][..width];
                    for (out, h) in out.iter_mut().zip(values) {
                        add(simd, out, *h, light);
                    }
                }
            }
        }
    }
}

/// Collects frames with their border in the windows of object pixels from `first` on.
struct Collect<'a, const L: usize> {
    views: &'a Views,
    first: usize,
    frames: &'a [[f32; L]],
    out: &'a mut [[f32; L]],
}

impl<const L: usize> WithSimd for Collect<'_, L> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (width, cols) = (self.views.width(), self.views.bordered()[1]);
        for (i, out) in self.out.iter_mut().enumerate() {
            let mut sum = [0.0f32; L];
            for lens in 0..self.views.corners.len() {
                let Some(at) = self.views.place(lens, self.first + i) else { continue };
                let window = self.views.window(lens, self.first + i);
                for (row, values) in window.chunks_exact(width).enumerate() {
                    for (y, h) in self.frames[at + row * cols..][..width].iter().zip(values) {
                        add(simd, &mut sum, *h, y);
                    }
                }
            }
            *out = sum;
        }
    }
}

/// Rows of A' W A from their diagonal elements on: the products of the windows of some successive object pixels of one
/// row with those of all others. The pixels share what they read: a window that is in the cache meets all of them.
struct Meet<'a> {
    views: &'a Views,
    /// With its border.
    weight: &'a [f32],
    /// The first of the object pixels.
    first: usize,
    /// For each of them a weighted window with a window of zeros on its left and on its right, [side, 3 width].
    own: &'a mut [f32],
    /// Room for a window whose rows are filled up with zeros to whole vectors of the processor.
    theirs: &'a mut [f32],
    /// [pixels, object pixels].
    out: &'a mut [f32],
}

impl WithSimd for Meet<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        for lens in 0..self.views.corners.len() {
            self.weigh(lens);
            for other in 0..self.views.corners.len() {
                self.meet(simd, lens, other);
            }
        }
    }
}

impl Meet<'_> {
    /// Number of the pixels.
    #[inline(always)]
    fn count(&self) -> usize {
        self.out.len() / self.views.unknowns()
    }

    /// Weights the windows of the pixels behind a lens.
    #[inline(always)]
    fn weigh(&mut self, lens: usize) {
        let (views, width, cols) = (self.views, self.views.width(), self.views.bordered()[1]);
        for b in 0..self.count() {
            let own = &mut self.own[b * 3 * width * views.side..][..3 * width * views.side];
            let Some(at) = views.place(lens, self.first + b) else {
                own.fill(0.0);
                continue;
            };
            for (i, values) in views.window(lens, self.first + b).chunks_exact(width).enumerate() {
                let weight = &self.weight[at + i * cols..][..width];
                let own = &mut own[(3 * i + 1) * width..][..width];
                for j in 0..width {
                    own[j] = values[j] * weight[j];
                }
            }
        }
    }

    /// Adds the products of the weighted windows behind `lens` with the windows of all object pixels behind `other`.
    #[inline(always)]
    fn meet<S: Simd>(&mut self, simd: S, lens: usize, other: usize) {
        let (views, width, n) = (self.views, self.views.width(), self.views.unknowns());
        let (side, object_cols) = (views.side as isize, views.object[1] as isize);
        let (from, [top, left]) = (views.corner(lens, self.first), views.corners[other]);
        let count = self.count() as isize;
        let padded = width.next_multiple_of(S::F32_LANES);
        // The object pixels whose windows overlap with one of these.
        let [above, below] = [from[0] - top - side + 1, from[0] - top + side];
        let [before, after] = [from[1] - left - side + 1, from[1] - left + side + count - 1];
        for r in above.max(self.first as isize / object_cols)..below.min(views.object[0] as isize) {
            let down = top + r - from[0];
            // The rows that both windows have: of the other, and of these.
            let (skipped, height) = ((-down).max(0) as usize, (side - down.abs()) as usize);
            let begin = down.max(0) as usize * 3 * width;
            for c in before.max(0)..after.min(object_cols) {
                let x = (r * object_cols + c) as usize;
                let window = &views.window(other, x)[skipped * width..][..height * width];
                for (to, from) in self.theirs.chunks_exact_mut(padded).zip(window.chunks_exact(width)) {
                    to[..width].copy_from_slice(from);
                }
                let theirs = &self.theirs[..height * padded];
                let right = left + c - from[1];
                // Of the pixels: those that come before the other one in the triangle and overlap with it.
                let last = (right + side).min(count).min(x as isize - self.first as isize + 1).max(0) as usize;
                let mine = |b: usize| {
                    let own = b * 3 * width * views.side + begin;
                    &self.own[own + (width as isize + right - b as isize) as usize..]
                };
                let mut b = (right - side + 1).max(0) as usize;
                while b < last {
                    if b + AT_ONCE <= last {
                        let four: [&[f32]; AT_ONCE] = std::array::from_fn(|i| mine(b + i));
                        for (i, sum) in products(simd, four, 3 * width, theirs, padded).into_iter().enumerate() {
                            self.out[(b + i) * n + x] += sum;
                        }
                        b += AT_ONCE;
                    } else {
                        let [sum] = products(simd, [mine(b)], 3 * width, theirs, padded);
                        self.out[b * n + x] += sum;
                        b += 1;
                    }
                }
            }
        }
    }
}

/// `sum += h x` for L values.
#[inline(always)]
fn add<S: Simd, const L: usize>(simd: S, sum: &mut [f32; L], h: f32, x: &[f32; L]) {
    if L.is_multiple_of(S::F32_LANES) {
        let h = simd.splat_f32s(h);
        for (sum, x) in S::as_mut_simd_f32s(sum).0.iter_mut().zip(S::as_simd_f32s(x).0) {
            *sum = simd.mul_add_f32s(h, *x, *sum);
        }
    } else {
        sum.iter_mut().zip(x).for_each(|(sum, x)| *sum += h * x);
    }
}

/// Sums of the products of N images with another: rows of `mine` are `stride` values apart, those of `theirs` have
/// `padded` values, whole vectors. Where `mine` holds no window, `theirs` holds zeros.
#[inline(always)]
fn products<S: Simd, const N: usize>(
    simd: S,
    mine: [&[f32]; N],
    stride: usize,
    theirs: &[f32],
    padded: usize,
) -> [f32; N] {
    let mut sums = [simd.splat_f32s(0.0); N];
    for (i, theirs) in theirs.chunks_exact(padded).enumerate() {
        let rows = mine.map(|m| S::as_simd_f32s(&m[i * stride..][..padded]).0);
        for (v, theirs) in S::as_simd_f32s(theirs).0.iter().enumerate() {
            for (sum, row) in sums.iter_mut().zip(rows) {
                *sum = simd.mul_add_f32s(row[v], *theirs, *sum);
            }
        }
    }
    sums.map(|sum| simd.reduce_sum_f32s(sum))
}
