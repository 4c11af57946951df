//! The end of the network in one pass: `sigmoid(conv2(pixel_shuffle(conv(y))))`, conv W -> 4 W, conv2 W -> 1, or the
//! same without the sigmoid.
//!
//! The shuffled features, W channels at full resolution, are the largest tensor of the network. It is never stored as a
//! whole: a band of rows is computed, rounded to halves as if it were stored, and convolved at once.

use super::activation::Activation;
use super::conv::Parameters;
use super::error::{NnError, check_scratch, check_shape, check_weights};
use super::packed::{self, OUTPUTS};
use super::pixel_shuffle::shuffled;
use crate::image::{Chw, PlaneMut};
use crate::num::simd::{Kernel, Simd, Vector};
use crate::num::{f16, fused, narrow_slice, widen_slice};

/// Plan of the end of the network.
#[derive(Clone, Copy, Debug)]
pub struct Upscale {
    /// Feature channels W.
    pub channels: usize,
    /// Rows of the features. The output has twice as many.
    pub rows: usize,
    /// Columns of the features. The output has twice as many.
    pub cols: usize,
    /// What is applied to the last sums.
    pub end: Activation,
}

impl Upscale {
    /// Length of scratch for bands of `band` feature rows, numbers. With bands of 1 row it is what [`Self::process`]
    /// needs at least.
    pub const fn scratch_len(&self, band: usize) -> usize {
        self.fixed_len() + band * self.row_len()
    }

    const fn coarse_len(&self) -> usize {
        self.channels * packed::pitch(self.cols)
    }

    const fn fine_len(&self) -> usize {
        self.channels * packed::pitch(2 * self.cols)
    }

    const fn weights_len(&self) -> usize {
        packed::packed_len(self.channels, 4 * self.channels) + packed::packed_len(self.channels, 1)
    }

    const fn fixed_len(&self) -> usize {
        let sums = OUTPUTS * packed::padded(self.cols) + packed::padded(2 * self.cols);
        self.weights_len() + sums + 2 * self.coarse_len() + 3 * self.fine_len()
    }

    const fn row_len(&self) -> usize {
        self.coarse_len() + 2 * self.fine_len()
    }

    /// Computes `output`, the part of the result (2 rows, 2 cols) that begins at pixel `origin` (row, column), from
    /// `input` (channels, rows, cols).
    ///
    /// # Errors
    /// [`NnError::Shape`], [`NnError::Weights`] or [`NnError::Scratch`] where an argument does not fit the plan.
    /// Nothing is written then.
    pub fn process(
        &self,
        simd: Simd,
        [conv, conv2]: [Parameters<'_>; 2],
        input: Chw<'_, f16>,
        origin: [usize; 2],
        output: PlaneMut<'_, f16>,
        scratch: &mut [f32],
    ) -> Result<(), NnError> {
        check_shape([self.channels, self.rows, self.cols], input.shape())?;
        self.check_output(origin, &output)?;
        check_weights(36 * self.channels * self.channels, conv.weights.len())?;
        check_weights(4 * self.channels, conv.bias.len())?;
        check_weights(9 * self.channels, conv2.weights.len())?;
        check_weights(1, conv2.bias.len())?;
        check_scratch(self.scratch_len(1), scratch.len())?;
        simd.run(Job { plan: *self, conv, conv2, input, origin, output, scratch });
        Ok(())
    }

    /// Checks that a part of the result that begins at `origin` lies in it.
    pub(super) fn check_output(&self, origin: [usize; 2], output: &PlaneMut<'_, f16>) -> Result<(), NnError> {
        let end = [origin[0] + output.rows(), origin[1] + output.cols()];
        check_shape([1, 2 * self.rows, 2 * self.cols], [1, end[0].max(2 * self.rows), end[1].max(2 * self.cols)])
    }
}

struct Job<'a> {
    plan: Upscale,
    conv: Parameters<'a>,
    conv2: Parameters<'a>,
    input: Chw<'a, f16>,
    origin: [usize; 2],
    output: PlaneMut<'a, f16>,
    scratch: &'a mut [f32],
}

impl Kernel for Job<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Vector>(self) {
        let Self { plan, conv, conv2, input, origin: [top, left], mut output, scratch } = self;
        let band = ((scratch.len() - plan.fixed_len()) / plan.row_len()).min(plan.rows);
        let (packed, scratch) = scratch.split_at_mut(packed::packed_len(plan.channels, 4 * plan.channels));
        let (packed2, scratch) = scratch.split_at_mut(packed::packed_len(plan.channels, 1));
        let (sums, scratch) = scratch.split_at_mut(OUTPUTS * packed::padded(plan.cols));
        let (sums2, scratch) = scratch.split_at_mut(packed::padded(2 * plan.cols));
        let (coarse, scratch) = scratch.split_at_mut((band + 2) * plan.coarse_len());
        let fine = &mut scratch[..(2 * band + 3) * plan.fine_len()];
        let wanted = top..top + output.rows();
        // Feature rows that the wanted rows depend on.
        let coarse_wanted = top.saturating_sub(1) / 2..wanted.end / 2 + 1;
        let weights2 = packed::pack(conv2.weights, plan.channels, 1, 0, packed2);
        fine.fill(0.0);
        for start in (0..plan.rows).step_by(band) {
            let height = band.min(plan.rows - start);
            plan.widen(input, start, height, coarse);
            fine.copy_within(2 * band * plan.fine_len()..(2 * band + 2) * plan.fine_len(), 0);
            for first in (0..4 * plan.channels).step_by(OUTPUTS) {
                let weights = packed::pack(conv.weights, plan.channels, 4 * plan.channels, first, packed);
                let bias = packed::bias(conv.bias, first);
                for row in (0..height).filter(|row| coarse_wanted.contains(&(start + row))) {
                    let input = &coarse[row * plan.coarse_len()..][..3 * plan.coarse_len()];
                    packed::row::<V>(input, plan.channels, 4 * plan.channels, plan.cols, weights, bias, sums);
                    plan.shuffle(sums, first, row, fine);
                }
            }
            let last = start + height == plan.rows;
            if last {
                fine[(2 * height + 2) * plan.fine_len()..][..plan.fine_len()].fill(0.0);
            }
            let bias2 = packed::bias(conv2.bias, 0);
            let rows = (2 * start).saturating_sub(1)..2 * (start + height) - usize::from(!last);
            for row in rows.start.max(wanted.start)..rows.end.min(wanted.end) {
                let input = &fine[(row + 1 - 2 * start) * plan.fine_len()..][..3 * plan.fine_len()];
                packed::row::<V>(input, plan.channels, 1, 2 * plan.cols, weights2, bias2, sums2);
                let to = output.row_mut(row - top);
                let sums = &mut sums2[left..left + to.len()];
                plan.end.apply(sums);
                match plan.end {
                    Activation::Sigmoid => narrow_slice(sums, to),
                    Activation::Linear | Activation::Relu => fused::narrow_bounded(sums, to),
                }
            }
        }
    }
}

impl Upscale {
    /// Fills the slots with feature rows start - 1..=start + height, zeros outside the frame.
    #[cfg_attr(target_arch = "arm", inline(never))]
    #[cfg_attr(not(target_arch = "arm"), inline(always))]
    fn widen(&self, input: Chw<'_, f16>, start: usize, height: usize, slots: &mut [f32]) {
        let slots = slots.chunks_exact_mut(self.coarse_len()).take(height + 2);
        for (slot, to) in slots.enumerate() {
            to.fill(0.0);
            let row = start + slot;
            if row == 0 || row > self.rows {
                continue;
            }
            for (channel, to) in to.chunks_exact_mut(packed::pitch(self.cols)).enumerate() {
                widen_slice(input.row(channel, row - 1), &mut to[1..1 + self.cols]);
            }
        }
    }

    /// Distributes one row of a block of channels over the fine rows, rounded to halves.
    #[cfg_attr(target_arch = "arm", inline(never))]
    #[cfg_attr(not(target_arch = "arm"), inline(always))]
    fn shuffle(&self, sums: &[f32], first: usize, row: usize, fine: &mut [f32]) {
        let pitch = packed::pitch(2 * self.cols);
        // Channels come in pairs that lie side by side in a row.
        for (pair, sums) in sums.chunks_exact(2 * packed::padded(self.cols)).enumerate() {
            let (channel, row, left) = shuffled(first + 2 * pair, row);
            // Slots 0 and 1 hold the last two rows of the band before; column 0 is padding.
            let to = &mut fine[(row + 2) * self.fine_len() + channel * pitch + 1 + left..];
            let (even, odd) = sums.split_at(packed::padded(self.cols));
            fused::round_interleaved(&even[..self.cols], &odd[..self.cols], &mut to[..2 * self.cols]);
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use crate::naive::{self, Noise, Tensor, wide};
    use std::vec;
    use std::vec::Vec;

    /// The rounding of the fine features carried through a convolution and the slope 1/4 of the sigmoid; its error; one
    /// rounding.
    const TOLERANCE: f64 = 1.0e-3;

    struct Case {
        plan: Upscale,
        weights: [Vec<f16>; 2],
        bias: [Vec<f16>; 2],
        input: Vec<f16>,
    }

    impl Case {
        fn new(channels: usize, rows: usize, cols: usize) -> Self {
            let mut noise = Noise(8);
            Self {
                plan: Upscale { channels, rows, cols, end: Activation::Sigmoid },
                weights: [noise.halves(36 * channels * channels, 0.3), noise.halves(9 * channels, 0.3)],
                bias: [noise.halves(4 * channels, 0.5), noise.halves(1, 0.5)],
                input: noise.halves(channels * rows * cols, 1.0),
            }
        }

        fn run(&self, simd: Simd, band: usize) -> Vec<f16> {
            let Upscale { channels, rows, cols, .. } = self.plan;
            let mut output = vec![f16::NAN; 4 * rows * cols];
            let len = self.plan.scratch_len(band);
            let mut scratch = vec![f32::NAN; len + 4];
            let parameters = [0, 1].map(|i| Parameters { weights: &self.weights[i], bias: &self.bias[i] });
            let input = Chw::new(&self.input, channels, rows, cols).unwrap();
            let plane = PlaneMut::new(&mut output, 2 * rows, 2 * cols).unwrap();
            self.plan.process(simd, parameters, input, [0, 0], plane, &mut scratch[..len]).unwrap();
            assert!(scratch[len..].iter().all(|x| x.is_nan()), "wrote behind the scratch");
            output
        }
    }

    #[test]
    fn agrees_with_the_definition_whatever_the_band() {
        for (channels, rows, cols) in [(1, 1, 1), (3, 2, 5), (8, 7, 10), (16, 12, 24)] {
            let case = Case::new(channels, rows, cols);
            let x = Tensor::new([channels, rows, cols], wide(&case.input));
            let up = naive::shuffle(&naive::conv3x3(&x, &wide(&case.weights[0]), &wide(&case.bias[0])));
            let expected = naive::conv3x3(&up, &wide(&case.weights[1]), &wide(&case.bias[1])).map(naive::sigmoid);
            let found = case.run(Simd::detect(), 1);
            let error = naive::error(&found, &expected.data);
            assert!(error < TOLERANCE, "{channels}, {rows} x {cols}: {error:e}");
            for band in [2, 3, 5, 40] {
                assert_eq!(case.run(Simd::PORTABLE, band), found, "bands of {band} rows");
            }
        }
    }
}
