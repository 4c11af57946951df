//! What the blocks of a frame receive of the points of an object, and how displaced lenses change it.

use ndarray::{Array1, Array2, ArrayView1};
use ommatidia_model::forward::Forward;
use ommatidia_model::instrument::Instrument;
use ommatidia_shared::blob::Size;
use ommatidia_shared::watch::{MOMENTS, blocks};

/// About so many points of the object, on an even grid.
const POINTS: usize = 1024;

/// The functions over a frame that maps are made of: in each block 1, `(2 r - h + 1) / h` and `(2 c - w + 1) / w`.
#[derive(Clone, Copy, Debug)]
pub struct Basis {
    /// Size of the frame, pixels.
    pub frame: Size,
    /// Side of a block, pixels.
    pub block: u8,
}

impl Basis {
    /// Number of functions.
    pub fn len(self) -> usize {
        MOMENTS * blocks(self.frame, self.block).iter().product::<usize>()
    }

    /// Index of the first function of the block of a pixel, their values there, and the sides of the block.
    pub fn at(self, row: usize, col: usize) -> (usize, [f64; MOMENTS], [usize; 2]) {
        let side = usize::from(self.block);
        let along = |i: usize, n: u16| {
            let first = i / side * side;
            let len = side.min(usize::from(n) - first);
            ((2 * (i - first) + 1) as f64 / len as f64 - 1.0, len)
        };
        let ((down, height), (right, width)) = (along(row, self.frame.rows), along(col, self.frame.cols));
        let block = row / side * blocks(self.frame, self.block)[1] + col / side;
        (MOMENTS * block, [1.0, down, right], [height, width])
    }

    /// Adds `light` at a pixel, which may lie off the frame, to the sums over the functions.
    fn add(self, to: &mut Array1<f64>, at: [isize; 2], light: f64) {
        let [Ok(row), Ok(col)] = at.map(usize::try_from) else { return };
        if row < self.frame.rows.into() && col < self.frame.cols.into() {
            let (first, values, _) = self.at(row, col);
            values.iter().enumerate().for_each(|(m, v)| to[first + m] += light * v);
        }
    }

    /// Sums of an image, [rows, cols], over the functions.
    pub fn of(self, image: &Array2<f32>) -> Array1<f64> {
        let mut to = Array1::zeros(self.len());
        image.indexed_iter().for_each(|((r, c), v)| self.add(&mut to, [r as isize, c as isize], f64::from(*v)));
        to
    }

    /// Value of a map with these coefficients at a pixel.
    pub fn value(self, map: ArrayView1<'_, f64>, row: usize, col: usize) -> f64 {
        let (first, values, _) = self.at(row, col);
        values.iter().enumerate().map(|(m, v)| map[first + m] * v).sum()
    }
}

/// What the blocks receive of one point, as sums over the functions of [`Basis`], for a light of 1 on the sensor.
#[derive(Clone, Debug)]
pub struct Point {
    /// Of all lenses.
    pub whole: Array1<f64>,
    /// Change by each parameter: displacements of all lenses along the rows by 1 pixel, along the columns, gains by 1.
    pub change: Vec<Array1<f64>>,
}

impl Point {
    /// The same with other sums in place of each.
    pub fn mapped(&self, of: impl Fn(&Array1<f64>) -> Array1<f64>) -> Self {
        Self { whole: of(&self.whole), change: self.change.iter().map(of).collect() }
    }
}

/// The points of the object of an instrument. Dark ones are left out.
///
/// A lens that moves by a pixel moves its image by a pixel, so the change is half the difference of the images that
/// lie one pixel ahead and one behind.
pub fn points_of(instrument: &Instrument, forward: &Forward, basis: Basis) -> Vec<Point> {
    let [rows, cols] = forward.operator().object_shape();
    let step = ((rows * cols) as f64 / POINTS as f64).sqrt().round().max(1.0) as usize;
    let middle = |n: usize| (n - 1) % step / 2;
    let places =
        (middle(rows)..rows).step_by(step).flat_map(|r| (middle(cols)..cols).step_by(step).map(move |c| [r, c]));
    places.filter_map(|at| point(instrument, forward, basis, at)).collect()
}

fn point(instrument: &Instrument, forward: &Forward, basis: Basis, at: [usize; 2]) -> Option<Point> {
    let corners = forward.operator().corners();
    let half = (instrument.psf.basis.dim().2 / 2) as isize;
    let zero = || Array1::<f64>::zeros(basis.len());
    let mut point = Point { whole: zero(), change: vec![zero(); 3 * corners.len()] };
    let mut light = 0.0;
    for (lens, corner) in corners.iter().enumerate() {
        let Some(corner) = corner else { continue };
        let window = instrument.psf.window(lens, at.map(|v| v as f64), instrument.psf.depth_nearest(0.0));
        let image = |by: [isize; 2]| {
            let mut sums = zero();
            for ((r, c), v) in window.indexed_iter() {
                let on = |a: usize, i: usize| corner[a] + at[a] as isize + i as isize - half + by[a];
                let place = [on(0, r), on(1, c)];
                let response = instrument.response.as_ref().map_or(1.0, |map| {
                    let [row, col] = place.map(|v| usize::try_from(v).unwrap_or(usize::MAX));
                    map.get([row, col]).copied().unwrap_or(0.0)
                });
                basis.add(&mut sums, place, v * f64::from(response));
            }
            sums
        };
        let here = image([0, 0]);
        light += here.iter().step_by(MOMENTS).sum::<f64>();
        point.whole += &here;
        for (axis, by) in [[1, 0], [0, 1]].into_iter().enumerate() {
            point.change[axis * corners.len() + lens] = (image(by) - image(by.map(|v: isize| -v))) / 2.0;
        }
        point.change[2 * corners.len() + lens] = here;
    }
    if light <= 0.0 {
        return None;
    }
    point.whole /= light;
    point.change.iter_mut().for_each(|change| *change /= light);
    Some(point)
}
