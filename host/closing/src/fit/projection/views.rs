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
    pub(super) fn width(&self) -> usize {
        self.side.next_multiple_of(VECTOR)
    }

    /// Rows and columns of a frame with its border.
    fn bordered(&self) -> [usize; 2] {
        [self.sensor[0] + 2 * self.side, self.sensor[1] + 2 * self.width()]
    }

    /// Number of lenses.
    pub(super) fn lenses(&self) -> usize {
        self.corners.len()
    }

    /// Rows and columns of a window.
    pub(super) fn side(&self) -> usize {
        self.side
    }

    /// The sensor pixel at which the window of object pixel `x` begins.
    #[inline(always)]
    pub(super) fn corner(&self, lens: usize, x: usize) -> [isize; 2] {
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

    /// The window of an object pixel, [side, width].
    #[inline(always)]
    pub(super) fn window(&self, lens: usize, x: usize) -> &[f32] {
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
