//! Products of the optics with several vectors at once.
//!
//! Every product runs over whole rows of windows. So a frame gets a border that every window which touches the sensor
//! fits into; no inner loop has to look for an edge.

use super::views::Views;
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;
use std::ops::Range;

/// Most vectors that are multiplied at the same time.
pub(crate) const LANES: usize = 16;

impl Views {
    /// A x for L objects at once: [object pixels] -> [sensor pixels].
    pub(crate) fn forward<const L: usize>(&self, objects: &[[f32; L]]) -> Vec<[f32; L]> {
        let [rows, cols] = self.bordered();
        let band = self.pixels().len().div_ceil(rayon::current_num_threads()).max(1);
        let parts = objects.par_chunks(band).enumerate().map(|(b, objects)| {
            let mut out = vec![[0.0; L]; rows * cols];
            dispatch::<L>(Spread { views: self, first: b * band, objects, out: &mut out });
            out
        });
        let sum = parts.reduce_with(|mut a, b| {
            a.iter_mut().zip(&b).for_each(|(a, b)| a.iter_mut().zip(b).for_each(|(a, b)| *a += b));
            a
        });
        let sum = sum.unwrap_or_else(|| vec![[0.0; L]; rows * cols]);
        (0..self.sensor()[0]).flat_map(|r| sum[self.row(r)..][..self.sensor()[1]].iter().copied()).collect()
    }

    /// A' y for L frames at once: [sensor pixels] -> [object pixels].
    pub(crate) fn adjoint<const L: usize>(&self, frames: &[[f32; L]]) -> Vec<[f32; L]> {
        let frames = self.with_border(frames, [0.0; L]);
        let mut out = vec![[0.0; L]; self.pixels().len()];
        let band = self.object()[1].max(1);
        out.par_chunks_mut(band).enumerate().for_each(|(b, out)| {
            dispatch::<L>(Collect { views: self, first: b * band, frames: &frames, out });
        });
        out
    }

    /// Rows and columns of a frame with its border.
    fn bordered(&self) -> [usize; 2] {
        [self.sensor()[0] + 2 * self.side(), self.sensor()[1] + 2 * self.width()]
    }

    /// The pixel of a frame with its border at which the window of object pixel `x` begins. None: it does not touch the
    /// sensor.
    #[inline(always)]
    fn place(&self, lens: usize, x: usize) -> Option<usize> {
        let [row, col] = self.corner(lens, x);
        let (above, before) = (self.side() as isize, self.width() as isize);
        let on = -above < row && row < self.sensor()[0] as isize && -before < col && col < self.sensor()[1] as isize;
        on.then(|| (row + above) as usize * self.bordered()[1] + (col + before) as usize)
    }

    /// The index of the first pixel of sensor row `r` in a frame with its border.
    fn row(&self, r: usize) -> usize {
        (r + self.side()) * self.bordered()[1] + self.width()
    }

    /// A frame with its border.
    fn with_border<T: Copy>(&self, frame: &[T], border: T) -> Vec<T> {
        let [rows, cols] = self.bordered();
        let mut out = vec![border; rows * cols];
        for (r, row) in frame.chunks_exact(self.sensor()[1]).enumerate() {
            out[self.row(r)..][..row.len()].copy_from_slice(row);
        }
        out
    }

    /// The places of the windows of object pixels side by side from `x` on, if all of them touch the sensor.
    #[inline(always)]
    fn places(&self, lens: usize, x: usize) -> Option<usize> {
        self.place(lens, x + TOGETHER - 1).and(self.place(lens, x))
    }

    /// The windows of object pixels side by side from `x` on.
    #[inline(always)]
    fn neighbours(&self, lens: usize, x: usize) -> [&[f32]; TOGETHER] {
        std::array::from_fn(|k| self.window(lens, x + k))
    }
}

/// A product of L vectors, pixel by pixel of the objects.
trait Product<const L: usize> {
    /// The optics, and the object pixels that are gone through.
    fn pixels(&self) -> (&Views, Range<usize>);
    /// Does its part for one of these pixels behind a lens.
    fn one<S: Simd>(&mut self, simd: S, lens: usize, i: usize);
    /// The same for [`TOGETHER`] of them in a row, whose first window begins at a place of the frame with its border:
    /// for P vectors of values from the `part`-th on, so that each value of a window is read once for all of them.
    fn parts<S: Simd, const P: usize>(&mut self, simd: S, lens: (usize, usize), place: (usize, usize));

    /// The same for all values.
    #[inline(always)]
    fn several<S: Simd>(&mut self, simd: S, lens: (usize, usize), i: usize) {
        let parts = L / S::F32_LANES;
        (0..parts / 2).for_each(|p| self.parts::<S, 2>(simd, lens, (i, 2 * p)));
        if parts % 2 == 1 {
            self.parts::<S, 1>(simd, lens, (i, parts - 1));
        }
    }

    /// Goes through all pixels, lens by lens.
    #[inline(always)]
    fn all<S: Simd>(&mut self, simd: S) {
        let mut i = 0;
        loop {
            let (views, Range { start, end }) = self.pixels();
            let (x, lenses) = (start + i, views.lenses());
            if x >= end {
                return;
            }
            let step = if x + TOGETHER <= end && views.are_side_by_side(x, TOGETHER) { TOGETHER } else { 1 };
            let whole = step == TOGETHER && L.is_multiple_of(S::F32_LANES);
            for lens in 0..lenses {
                match whole.then(|| self.pixels().0.places(lens, x)).flatten() {
                    Some(at) => self.several(simd, (lens, at), i),
                    None => {
                        for i in i..i + step {
                            self.one(simd, lens, i);
                        }
                    }
                }
            }
            i += step;
        }
    }
}

/// Runs a product for L vectors with the widest vectors of this processor that L values fill.
fn dispatch<const L: usize>(product: impl WithSimd<Output = ()>) {
    #[cfg(target_arch = "x86_64")]
    if L < 16
        && let Some(simd) = pulp::x86::V3::try_new()
    {
        return Simd::vectorize(simd, product);
    }
    Arch::new().dispatch(product);
}

/// Number of object pixels side by side whose windows are read together: each begins a column further than the last, so
/// that a value of the frame meets one of each while it is in a register.
const TOGETHER: usize = 4;

/// Adds the light of objects from pixel `first` on to frames with their border.
struct Spread<'a, const L: usize> {
    views: &'a Views,
    first: usize,
    objects: &'a [[f32; L]],
    out: &'a mut [[f32; L]],
}

impl<const L: usize> Product<L> for Spread<'_, L> {
    fn pixels(&self) -> (&Views, Range<usize>) {
        (self.views, self.first..self.first + self.objects.len())
    }

    /// The light of one object pixel behind a lens.
    #[inline(always)]
    fn one<S: Simd>(&mut self, simd: S, lens: usize, i: usize) {
        let (width, cols) = (self.views.width(), self.views.bordered()[1]);
        let Some(at) = self.views.place(lens, self.first + i) else { return };
        let window = self.views.window(lens, self.first + i);
        for (row, values) in window.chunks_exact(width).enumerate() {
            let out = &mut self.out[at + row * cols..][..width];
            for (out, h) in out.iter_mut().zip(values) {
                add(simd, out, *h, &self.objects[i]);
            }
        }
    }

    /// The light of object pixels side by side from `i` on behind a lens; their windows begin at `at`.
    #[inline(always)]
    fn parts<S: Simd, const P: usize>(&mut self, simd: S, (lens, at): (usize, usize), (i, part): (usize, usize)) {
        let (width, cols) = (self.views.width(), self.views.bordered()[1]);
        let windows = self.views.neighbours(lens, self.first + i);
        let light: [[S::f32s; P]; TOGETHER] =
            std::array::from_fn(|k| std::array::from_fn(|p| S::as_simd_f32s(&self.objects[i + k]).0[part + p]));
        for row in 0..self.views.side() {
            let out = &mut self.out[at + row * cols..][..width + TOGETHER - 1];
            let values = windows.map(|w| &w[row * width..][..width]);
            let mut put = |j: usize, of: Range<usize>| {
                let out = &mut S::as_mut_simd_f32s(&mut out[j]).0;
                let mut sums: [S::f32s; P] = std::array::from_fn(|p| out[part + p]);
                for k in of {
                    let h = simd.splat_f32s(values[k][j - k]);
                    for p in 0..P {
                        sums[p] = simd.mul_add_f32s(h, light[k][p], sums[p]);
                    }
                }
                out[part..part + P].copy_from_slice(&sums);
            };
            (0..TOGETHER - 1).for_each(|j| put(j, 0..j + 1));
            (TOGETHER - 1..width).for_each(|j| put(j, 0..TOGETHER));
            (1..TOGETHER).for_each(|k| put(width + k - 1, k..TOGETHER));
        }
    }
}

impl<const L: usize> WithSimd for Spread<'_, L> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        self.all(simd);
    }
}

/// Collects frames with their border in the windows of object pixels from `first` on.
struct Collect<'a, const L: usize> {
    views: &'a Views,
    first: usize,
    frames: &'a [[f32; L]],
    out: &'a mut [[f32; L]],
}

impl<const L: usize> Product<L> for Collect<'_, L> {
    fn pixels(&self) -> (&Views, Range<usize>) {
        (self.views, self.first..self.first + self.out.len())
    }

    /// What the window of one object pixel behind a lens collects.
    #[inline(always)]
    fn one<S: Simd>(&mut self, simd: S, lens: usize, i: usize) {
        let (width, cols) = (self.views.width(), self.views.bordered()[1]);
        let Some(at) = self.views.place(lens, self.first + i) else { return };
        let window = self.views.window(lens, self.first + i);
        for (row, values) in window.chunks_exact(width).enumerate() {
            for (y, h) in self.frames[at + row * cols..][..width].iter().zip(values) {
                add(simd, &mut self.out[i], *h, y);
            }
        }
    }

    /// The same of object pixels side by side from `i` on, whose windows begin at `at`: several sums at once, since
    /// each addition waits for the one before.
    #[inline(always)]
    fn parts<S: Simd, const P: usize>(&mut self, simd: S, (lens, at): (usize, usize), (i, part): (usize, usize)) {
        let (width, cols) = (self.views.width(), self.views.bordered()[1]);
        let windows = self.views.neighbours(lens, self.first + i);
        let mut sums: [[S::f32s; P]; TOGETHER] =
            std::array::from_fn(|k| std::array::from_fn(|p| S::as_simd_f32s(&self.out[i + k]).0[part + p]));
        for row in 0..self.views.side() {
            let frame = &self.frames[at + row * cols..][..width + TOGETHER - 1];
            let values = windows.map(|w| &w[row * width..][..width]);
            let mut take = |j: usize, of: Range<usize>| {
                let y: [S::f32s; P] = std::array::from_fn(|p| S::as_simd_f32s(&frame[j]).0[part + p]);
                for k in of {
                    let h = simd.splat_f32s(values[k][j - k]);
                    for p in 0..P {
                        sums[k][p] = simd.mul_add_f32s(h, y[p], sums[k][p]);
                    }
                }
            };
            (0..TOGETHER - 1).for_each(|j| take(j, 0..j + 1));
            (TOGETHER - 1..width).for_each(|j| take(j, 0..TOGETHER));
            (1..TOGETHER).for_each(|k| take(width + k - 1, k..TOGETHER));
        }
        for (k, sums) in sums.into_iter().enumerate() {
            for (p, sum) in sums.into_iter().enumerate() {
                S::as_mut_simd_f32s(&mut self.out[i + k]).0[part + p] = sum;
            }
        }
    }
}

impl<const L: usize> WithSimd for Collect<'_, L> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        self.all(simd);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::projection::Footprint;
    use ndarray::Array2;

    /// Windows at the middle, over each edge and off the sensor, for objects whose rows are no multiple of
    /// [`TOGETHER`], pixel by pixel.
    fn compare<const L: usize>() {
        let (object, sensor, side) = ([5, 11], [17, 23], 5);
        let corners = vec![[4, 6], [-3, -4], [9, 15], [15, -30], [16, 3]];
        // All but two object pixels are unknown.
        let pixels: Vec<u32> = (0..(object[0] * object[1]) as u32).filter(|p| ![14, 37].contains(p)).collect();
        let mut views = Views::dark(Footprint { object, sensor, side, corners: corners.clone() }, pixels);
        let value = |k: usize| ((k * 37 % 101) as f32) / 101.0 - 0.3;
        let image = Array2::from_shape_fn((sensor[0], sensor[1]), |(r, c)| value(3 * r + 5 * c));
        for lens in 0..corners.len() {
            (0..views.pixels().len()).for_each(|x| views.take(lens, x, &image));
        }
        let objects: Vec<[f32; L]> =
            (0..views.pixels().len()).map(|x| std::array::from_fn(|lane| value(x + 13 * lane))).collect();
        let frames: Vec<[f32; L]> =
            (0..sensor[0] * sensor[1]).map(|p| std::array::from_fn(|lane| value(7 * p + lane))).collect();
        let mut light = vec![[0.0f64; L]; frames.len()];
        let mut back = vec![[0.0f64; L]; objects.len()];
        for (x, (o, b)) in objects.iter().zip(&mut back).enumerate() {
            for lens in 0..corners.len() {
                let [top, left] = views.corner(lens, x);
                for (i, h) in views.window(lens, x).iter().enumerate() {
                    let at = [top + (i / views.width()) as isize, left + (i % views.width()) as isize];
                    if at.iter().zip(sensor).all(|(v, n)| (0..n as isize).contains(v)) {
                        let p = at[0] as usize * sensor[1] + at[1] as usize;
                        for lane in 0..L {
                            light[p][lane] += f64::from(h * o[lane]);
                            b[lane] += f64::from(h * frames[p][lane]);
                        }
                    }
                }
            }
        }
        let same = |found: &[[f32; L]], naive: &[[f64; L]]| {
            let pairs = found.iter().flatten().zip(naive.iter().flatten());
            pairs.map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max)
        };
        assert!(light.iter().flatten().any(|v| v.abs() > 1.0));
        assert!(same(&views.forward(&objects), &light) < 1e-5, "{L}");
        assert!(same(&views.adjoint(&frames), &back) < 1e-5, "{L}");
    }

    #[test]
    fn products_are_the_sums_over_the_windows() {
        compare::<1>();
        compare::<4>();
        compare::<8>();
        compare::<16>();
    }
}
