//! Which sensor pixels see which object pixels.

use ndarray::Array2;
use std::ops::Range;

/// The core of a window reaches so far from its middle, pixels.
pub(in crate::fit) const CORE: usize = 4;

/// Where the light of each object pixel falls: in a window behind each lens.
#[derive(Clone, Debug)]
pub(crate) struct Footprint {
    /// Rows and columns of the object.
    pub(crate) object: [usize; 2],
    /// Rows and columns of the sensor.
    pub(crate) sensor: [usize; 2],
    /// Rows and columns of a window.
    pub(crate) side: usize,
    /// For each lens the sensor pixel at which the window of object pixel (0, 0) begins, [row, col]. That of pixel
    /// (r, c) begins r rows and c columns further.
    pub(crate) corners: Vec<[isize; 2]>,
}

impl Footprint {
    /// Object pixels with light on some of the sensor pixels `on`: flat indices, ascending.
    pub(crate) fn seen_by(&self, on: &Array2<bool>) -> Vec<u32> {
        let (sums, side) = (Sums::of(on), self.side as isize);
        let is_seen = |p: &u32| {
            let at = [*p as usize / self.object[1], *p as usize % self.object[1]];
            self.corners.iter().any(|corner| {
                let [row, col] = [0, 1].map(|a| corner[a] + at[a] as isize);
                sums.within(row..row + side, col..col + side) > 0
            })
        };
        (0..(self.object[0] * self.object[1]) as u32).filter(is_seen).collect()
    }

    /// Whether each sensor pixel sees object pixels of `of`, one of them at most [`CORE`] pixels from the middle of its
    /// window, and no others, [sensor rows, sensor cols] in steps of `step` pixels.
    pub(crate) fn alone(&self, of: &Array2<bool>, step: usize) -> Array2<bool> {
        let (inside, outside) = (Sums::of(of), Sums::of(&of.mapv(|v| !v)));
        let tail = (self.side / 2).saturating_sub(CORE) as isize;
        let count = |sums: &Sums, at: [usize; 2], without: isize| {
            let of_lens = |corner: &[isize; 2]| {
                let [rows, cols] = [0, 1].map(|a| {
                    let last = (at[a] * step) as isize - corner[a];
                    last + 1 - self.side as isize + without..last + 1 - without
                });
                sums.within(rows, cols)
            };
            self.corners.iter().map(of_lens).sum::<u32>()
        };
        let shape = self.sensor.map(|n| n.div_ceil(step));
        Array2::from_shape_fn(shape, |(r, c)| count(&outside, [r, c], 0) == 0 && count(&inside, [r, c], tail) > 0)
    }
}

/// Numbers of pixels that are set above and left of each place, [rows + 1, cols + 1].
struct Sums(Array2<u32>);

impl Sums {
    fn of(set: &Array2<bool>) -> Self {
        let (rows, cols) = set.dim();
        let mut sums = Array2::zeros((rows + 1, cols + 1));
        for r in 0..rows {
            let mut row = 0;
            for c in 0..cols {
                row += u32::from(set[[r, c]]);
                sums[[r + 1, c + 1]] = sums[[r, c + 1]] + row;
            }
        }
        Self(sums)
    }

    /// The number in a rectangle, which may reach beyond.
    fn within(&self, rows: Range<isize>, cols: Range<isize>) -> u32 {
        let (height, width) = self.0.dim();
        let clip = |v: isize, n: usize| v.clamp(0, n as isize - 1) as usize;
        let [top, bottom] = [rows.start, rows.end].map(|v| clip(v, height));
        let [left, right] = [cols.start, cols.end].map(|v| clip(v, width));
        self.0[[bottom, right]] + self.0[[top, left]] - self.0[[top, right]] - self.0[[bottom, left]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pixel by pixel, with windows that overlap and that reach beyond the sensor.
    #[test]
    fn a_sensor_pixel_sees_the_object_pixels_whose_windows_cover_it() {
        let corners = vec![[-2, -1], [1, 9], [9, -3], [8, 7]];
        let it = Footprint { object: [7, 8], sensor: [18, 19], side: 3, corners };
        let sees = |s: (usize, usize), o: (usize, usize)| {
            it.corners.iter().any(|corner| {
                let from = [corner[0] + o.0 as isize, corner[1] + o.1 as isize];
                (0..3).contains(&(s.0 as isize - from[0])) && (0..3).contains(&(s.1 as isize - from[1]))
            })
        };
        let of = Array2::from_shape_fn((7, 8), |(r, c)| (2..6).contains(&r) && c < 5);
        let found = it.alone(&of, 1);
        for (s, found) in found.indexed_iter() {
            let seen: Vec<bool> = of.indexed_iter().filter(|(o, _)| sees(s, *o)).map(|(_, of)| *of).collect();
            assert_eq!(*found, !seen.is_empty() && seen.iter().all(|of| *of), "{s:?}");
        }
        assert!(found.iter().filter(|v| **v).count() > 20);
        assert!(it.alone(&of, 4).indexed_iter().all(|((r, c), v)| *v == found[[4 * r, 4 * c]]));
        let on = Array2::from_shape_fn((18, 19), |(r, c)| r == 10 && c > 11);
        for (o, p) in (0..56).map(|p| ((p / 8, p % 8), p as u32)) {
            let is_seen = on.indexed_iter().any(|(s, on)| *on && sees(s, o));
            assert_eq!(it.seen_by(&on).contains(&p), is_seen, "{o:?}");
        }
    }
}
