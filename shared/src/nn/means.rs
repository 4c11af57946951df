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
