//! Means of channels.

use crate::image::Chw;
use crate::num::simd::{Kernel, Simd, Vector};
use crate::num::{f16, fused};

/// The mean of each channel of halves.
pub(super) fn means(simd: Simd, input: Chw<'_, f16>, mean: &mut [f32]) {
    simd.run(Means { input, mean });
}

struct Means<'a> {
    input: Chw<'a, f16>,
    mean: &'a mut [f32],
}

impl Kernel for Means<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Vector>(self) {
        let [_, rows, cols] = self.input.shape();
        for (channel, mean) in self.mean.iter_mut().enumerate() {
            let sum = (0..rows).fold(0.0, |sum, row| sum + row_sum(self.input.row(channel, row)));
            *mean = sum / (rows * cols) as f32;
        }
    }
}

/// Sum of a row: eight partial sums, added as a tree.
#[inline(always)]
fn row_sum(row: &[f16]) -> f32 {
    let mut p = [0.0_f32; 8];
    fused::add_eights(row, &mut p);
    ((p[0] + p[4]) + (p[2] + p[6])) + ((p[1] + p[5]) + (p[3] + p[7]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_is_summed_by_the_stated_tree() {
        let big = f16::from_f32(2048.0);
        let small = f16::from_f32(2.0_f32.powi(-13));
        // In sequence the small ones would vanish one by one beside the big one; in other columns they add up first.
        let mut row = [small; 17];
        row[0] = big;
        let others = 2.0 * 2.0_f32.powi(-13);
        let expected = ((2048.0 + others) + (others + others)) + ((others + others) + (others + others));
        // Column 16 falls to partial sum 0, where it is lost: 2048 + 2^-13 = 2048 in binary32 (ulp 2^-12, tie to even).
        assert_eq!(row_sum(&row), expected);
    }
}
