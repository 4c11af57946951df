//! The optics as an explicit matrix: for each object pixel that is not known the window of light behind each lens.
//!
//! The rows of a window are filled up with zeros to whole vectors.

use super::footprint::Footprint;
use ndarray::Array2;
use rayon::prelude::*;
use std::collections::HashMap;

/// Share of the light of an object pixel below which what falls on pixels that are used is a tail.
const TAIL: f32 = 0.1;
/// Rows and columns of object pixels that become one unknown. Tiles of the normal matrix hold whole ones.
pub(in crate::fit) const MERGED: usize = 4;
/// The rows of windows are filled up to a multiple of so many values.
const VECTOR: usize = 8;

/// The light of unit sources at object pixels behind all lenses, electrons at the exposure of the calibration.
#[derive(PartialEq)]
pub(crate) struct Views {
    object: [usize; 2],
    sensor: [usize; 2],
    /// The object pixels that are not known: flat indices, ascending.
    pixels: Vec<u32>,
    /// The unknown that each of them belongs to; unknowns are numbered in the order of their first pixels.
    unknowns: Vec<u32>,
    /// Whether each of them is seen by its tails alone.
    tails: Vec<bool>,
    /// Rows and columns of a window.
    side: usize,
    /// For each lens the sensor pixel at which the window of object pixel (0, 0) begins, [row, col]. That of pixel
    /// (r, c) begins r rows and c columns further.
    corners: Vec<[isize; 2]>,
    /// For each lens [these pixels, side, width].
    windows: Vec<Vec<f32>>,
}

impl Views {
    /// Number of values that a matrix of so many object pixels takes.
    pub(crate) fn values(pixels: usize, side: usize, lenses: usize) -> usize {
        pixels * lenses * side * side.next_multiple_of(VECTOR)
    }

    /// Dark windows of `footprint` for the object pixels `pixels`: flat indices, ascending. Each is an unknown.
    pub(crate) fn dark(footprint: Footprint, pixels: Vec<u32>) -> Self {
        let Footprint { object, sensor, side, corners } = footprint;
        let windows = vec![vec![0.0; Self::values(pixels.len(), side, 1)]; corners.len()];
        let (unknowns, tails) = ((0..pixels.len() as u32).collect(), vec![false; pixels.len()]);
        Self { object, sensor, pixels, unknowns, tails, side, corners, windows }
    }

    /// The object pixels that are not known: flat indices, ascending.
    pub(crate) fn pixels(&self) -> &[u32] {
        &self.pixels
    }

    /// Number of unknowns.
    pub(crate) fn unknowns(&self) -> usize {
        self.unknowns.iter().max().map_or(0, |last| *last as usize + 1)
    }

    /// The unknown that the `x`-th object pixel belongs to.
    pub(super) fn unknown(&self, x: usize) -> usize {
        self.unknowns[x] as usize
    }

    /// Whether the `x`-th object pixel is seen by its tails alone.
    pub(crate) fn is_tail(&self, x: usize) -> bool {
        self.tails[x]
    }

    /// Makes one unknown of neighbouring object pixels that are seen by their faint tails alone: those of which behind
    /// each lens less than [`TAIL`] of the light falls on pixels that are used (1 in `used`, else 0, [sensor rows,
    /// sensor cols]). Tails are smooth, so that they show the sum of such pixels and hardly their detail.
    pub(crate) fn merge_tails(&mut self, used: &Array2<f32>) {
        let is_tail = |x: usize| {
            let of_lens = |lens: usize| {
                let ([top, left], window) = (self.corner(lens, x), self.window(lens, x));
                let mut sums = [0.0f32; 2];
                for (i, row) in window.chunks_exact(self.width()).enumerate() {
                    for (j, v) in row.iter().enumerate().filter(|(_, v)| **v != 0.0) {
                        let at =
                            [top + i as isize, left + j as isize].map(|v| usize::try_from(v).unwrap_or(usize::MAX));
                        sums[0] += v * used.get(at).copied().unwrap_or(0.0);
                        sums[1] += v;
                    }
                }
                sums
            };
            let lenses: Vec<[f32; 2]> = (0..self.lenses()).map(of_lens).collect();
            let most = |i: usize| lenses.iter().fold(0.0f32, |m, sums| m.max(sums[i]));
            most(0) < TAIL * most(1)
        };
        self.tails = (0..self.pixels.len()).into_par_iter().map(is_tail).collect();
        let mut first = HashMap::new();
        let mut count = 0;
        for x in 0..self.pixels.len() {
            let mut new = || {
                count += 1;
                count - 1
            };
            self.unknowns[x] = match self.tails[x] {
                true => *first.entry(self.place_of(x).map(|v| v / MERGED)).or_insert_with(new),
                false => new(),
            };
        }
    }

    /// Rows and columns of the object.
    pub(crate) fn object(&self) -> [usize; 2] {
        self.object
    }

    /// Rows and columns of the sensor.
    pub(crate) fn sensor(&self) -> [usize; 2] {
        self.sensor
    }

    /// Takes the window of the `x`-th object pixel from the image of a lens.
    pub(crate) fn take(&mut self, lens: usize, x: usize, image: &Array2<f32>) {
        let (area, width) = (self.side * self.width(), self.width());
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

    /// Number of lenses.
    pub(super) fn lenses(&self) -> usize {
        self.corners.len()
    }

    /// Rows and columns of a window.
    pub(super) fn side(&self) -> usize {
        self.side
    }

    /// Row and column in the object of the `x`-th object pixel that is not known.
    #[inline(always)]
    pub(super) fn place_of(&self, x: usize) -> [usize; 2] {
        let pixel = self.pixels[x] as usize;
        [pixel / self.object[1], pixel % self.object[1]]
    }

    /// The sensor pixel at which its window begins.
    #[inline(always)]
    pub(super) fn corner(&self, lens: usize, x: usize) -> [isize; 2] {
        self.corner_at(lens, self.place_of(x))
    }

    /// The sensor pixel at which the window of the object pixel in row `r` and column `c` begins.
    #[inline(always)]
    pub(super) fn corner_at(&self, lens: usize, [r, c]: [usize; 2]) -> [isize; 2] {
        let [row, col] = self.corners[lens];
        [row + r as isize, col + c as isize]
    }

    /// Whether the object pixels `x` to `x + count - 1` lie side by side in one row of the object.
    #[inline(always)]
    pub(super) fn are_side_by_side(&self, x: usize, count: usize) -> bool {
        let last = self.pixels.get(x + count - 1).is_some_and(|p| *p as usize == self.pixels[x] as usize + count - 1);
        last && self.pixels[x] as usize % self.object[1] + count <= self.object[1]
    }

    /// The window of the `x`-th object pixel, [side, width].
    #[inline(always)]
    pub(super) fn window(&self, lens: usize, x: usize) -> &[f32] {
        let area = self.side * self.width();
        &self.windows[lens][x * area..(x + 1) * area]
    }
}
