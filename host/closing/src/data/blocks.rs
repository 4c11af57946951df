//! The pixels that are used, in spatial blocks, some of which are held out.

use std::ops::Range;

/// Of so many blocks one is held out, if there is more to hold out.
const EVERY: usize = 8;

/// Pixels of the sensor in spatial blocks.
pub(crate) struct Blocks {
    /// Flat indices into a frame, block by block.
    pub(crate) pixels: Vec<u32>,
    /// The range of `pixels` of each block; blocks are in row order.
    pub(crate) ranges: Vec<Range<usize>>,
    /// Whether a block is kept out of every fit.
    pub(crate) held_out: Vec<bool>,
}

impl Blocks {
    /// Those pixels of a sensor of [rows, cols] that `taken` names by row and column, in `side` x `side` blocks. Blocks
    /// without a pixel are left out.
    ///
    /// Every eighth block is held out, or every second one, like the fields of one colour of a chessboard, if there is
    /// little else to hold out (`single`).
    pub(crate) fn of(
        [rows, cols]: [usize; 2],
        taken: impl Fn(usize, usize) -> bool,
        side: usize,
        single: bool,
    ) -> Self {
        let side = side.max(1);
        let mut it = Self { pixels: Vec::new(), ranges: Vec::new(), held_out: Vec::new() };
        for [i, j] in (0..side * side).map(|b| [b / side, b % side]) {
            let start = it.pixels.len();
            for r in i * rows / side..(i + 1) * rows / side {
                let row = (j * cols / side..(j + 1) * cols / side).filter(|c| taken(r, *c));
                it.pixels.extend(row.map(|c| (r * cols + c) as u32));
            }
            if it.pixels.len() > start {
                it.ranges.push(start..it.pixels.len());
                it.held_out.push(if single { (i + j) % 2 == 1 } else { (3 * i + j) % EVERY == 5 });
            }
        }
        it
    }

    /// An even sample of at most about `most` pixels of a sensor of [rows, cols]; all of them where they are not more.
    pub(crate) fn even([rows, cols]: [usize; 2], most: usize, side: usize, single: bool) -> Self {
        let every = (rows * cols).div_ceil(most.max(1));
        // A Weyl sequence is even and favours neither odd nor even rows and columns.
        let taken = |r, c| every <= 1 || ((r * cols + c) as f64 * 0.618_033_988_75).fract() * (every as f64) < 1.0;
        Self::of([rows, cols], taken, side, single)
    }

    /// The share of the pixels that is not held out.
    pub(crate) fn fitted_share(single: bool) -> f64 {
        if single { 0.5 } else { 1.0 - 1.0 / EVERY as f64 }
    }

    /// The pixels that are held out.
    pub(crate) fn held_out_pixels(&self) -> impl Iterator<Item = u32> {
        let held_out = self.ranges.iter().zip(&self.held_out).filter(|(_, held_out)| **held_out);
        held_out.flat_map(|(range, _)| self.pixels[range.clone()].iter().copied())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pixel_is_in_one_block_and_empty_blocks_are_left_out() {
        let all = Blocks::of([10, 11], |_, _| true, 3, false);
        let mut sorted = all.pixels.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, (0..110).collect::<Vec<u32>>());
        assert!(all.ranges.len() == 9 && all.ranges.windows(2).all(|w| w[0].end == w[1].start));
        // The block in the middle and the one right of it.
        let some = Blocks::of([9, 9], |r, c| r == 4 && c >= 3, 3, true);
        assert_eq!(some.pixels, [39, 40, 41, 42, 43, 44]);
        assert_eq!((some.ranges, some.held_out), (vec![0..3, 3..6], vec![false, true]));
    }
    #[test]
    fn a_sample_is_even_and_as_much_is_held_out_as_is_said() {
        let some = Blocks::even([100, 100], 1000, 4, false).pixels;
        let odd = some.iter().filter(|p| *p % 2 == 1).count();
        assert!((900..1100).contains(&some.len()), "{}", some.len());
        assert!((some.len() as i64 - 2 * odd as i64).abs() < 100, "{odd} of {}", some.len());
        for single in [true, false] {
            let all = Blocks::even([96, 96], 10_000, 16, single);
            let fitted = 1.0 - all.held_out_pixels().count() as f64 / 9216.0;
            assert_eq!(fitted, Blocks::fitted_share(single));
        }
    }
}
