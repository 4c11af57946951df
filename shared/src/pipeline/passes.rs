//! Networks with more than one pass: those after the first compare what was found with the frame.
//!
//! ```text
//! l   = rcan_0(f) without its sigmoid                        logits, halves; f as for one pass
//! for each later pass:
//!     x = sigmoid(l)                                         halves
//!     p = filters of (A x / max |A x|), cropped              A: see crate::predict; zeros where A x is 0, or where
//!                                                            a p is not finite
//!     d = 4 (f - s p),  s = <f, p> / max(<p, p>, 1e-12)      over all channels and pixels; halves
//!     l = l + rcan_i(d, x) without its sigmoid               halves
//! out = sigmoid(l)
//! ```
//! The scale s absorbs the unit of A x. Both sums run over all values in the order of the tensor (channel, row, col):
//! values 8 k + j go to partial sum j of eight, in binary32, in ascending order of k; then
//! `((0 + 1) + (2 + 3)) + ((4 + 5) + (6 + 7))`. A magnitude of s below 2^-60 counts as 0. d is
//! `4 (f + (-s p))` with the product and the sum rounded to binary32. The logits of a pass are stored as halves before
//! they are added.
//!
//! A region of the object is cut in the last pass alone, since what it compares with is the whole frame. Its
//! statistics of the field cannot be held.
//!
//! # Memory
//! f, l and, with three passes or more, the logits of a pass are kept from pass to pass. Everything else of a pass lies
//! in the work space: x at its end, and before it p and then d, where the enhancement network reads its input. Filters
//! that transform the whole frame at once do so before they give p, so the predicted frame lies where p will lie and
//! before that, and the spectra of the prediction, then that of the frame, lie at the start. Otherwise the predicted
//! frame lies at the start, and behind it the spectra of the prediction, which end where x begins, then those of the
//! filters.

use super::error::PipelineError;
use super::field::Stats;
use super::later::Later;
use super::reconstruct::{Memory, Normalise, Pipeline, Source};
use crate::filter::Filters;
use crate::image::{ChwMut, PlaneMut, Region};
use crate::nn::channel_attention::Scales;
use crate::nn::rcan::{self, Rcan};
use crate::num::simd::{Kernel, Vector};
use crate::num::{f16, fused, max_finite, narrow_slice, sigmoid_slice, widen, widen_slice};

/// Least sum of squares of what was predicted.
const DARK: f32 = 1.0e-12;
/// 2^-60. Products of a smaller scale could be too small for normal numbers, which vectors of some targets flush.
const NO_SCALE: f32 = 1.0 / (1_u64 << 60) as f32;

impl Pipeline<'_> {
    /// Runs all passes. The lengths have been checked.
    pub(super) fn run_passes(
        &self,
        later: &Later<'_>,
        frame: &[u16],
        region: Region,
        Memory { fast, bulk }: Memory<'_>,
        output: &mut [f16],
    ) -> Result<Stats, PipelineError> {
        let pixels = later.object_len();
        let (seen, rest) = bulk.split_at_mut(self.filter.output_len());
        let (logits, rest) = rest.split_at_mut(pixels);
        let (change, work) = rest.split_at_mut(if later.count() > 1 { pixels } else { 0 });
        let (saturated_px, frame_max_dn) = self.survey(frame, fast);
        let raw = Source::Raw { pipeline: self, frame, max: frame_max_dn };
        self.filtered(Some(&raw), seen, work, fast)?;
        let (filter_max, filter_finite) = self.simd.run(Normalise { values: seen, by: None });
        let (weights, mut rest) = self.weights.rcan.split_at(self.rcan.weights_len());
        let at = work.len() - seen.len();
        work[at..].copy_from_slice(seen);
        self.logits(&self.rcan.to_logits(), weights, work, (self.whole(), logits), fast)?;
        for left in (0..later.count()).rev() {
            let (weights, next) = rest.split_at(later.rcan.weights_len());
            rest = next;
            self.compare(later, [seen, logits], work, fast)?;
            if left > 0 {
                self.logits(&later.rcan, weights, work, (self.whole(), change), fast)?;
                add(change, logits, fast);
            } else {
                self.logits(&later.rcan, weights, work, (region, output), fast)?;
            }
        }
        let [rows, cols] = region.ranges();
        for (to, row) in output.chunks_exact_mut(cols.len()).zip(rows) {
            let before = logits.chunks_exact(later.cols[0]).nth(row).and_then(|row| row.get(cols.clone()));
            let to_add = &mut fast[..cols.len()];
            widen_slice(before.unwrap_or_default(), to_add);
            fused::accumulate(to_add, to);
            sigmoids(to, to_add);
        }
        Ok(Stats { saturated_px, frame_max_dn, filter_max, filter_finite })
    }

    /// The filter outputs of a frame, (channels, object rows, object cols). The start of `arena` is overwritten.
    fn filtered(
        &self,
        source: Option<&Source<'_>>,
        output: &mut [f16],
        arena: &mut [f16],
        fast: &mut [f32],
    ) -> Result<(), PipelineError> {
        let [channels, rows, cols] = self.rcan.input_shape();
        let filters = Filters { halves: self.weights.filters, index: self.weights.index };
        let tensor = ChwMut::new(output, channels, rows, cols)?;
        Ok(self.filter.process(self.simd, source, filters, tensor, arena, fast)?)
    }

    /// The logits of one pass for a region, of the input at the end of `work`, which is overwritten.
    fn logits(
        &self,
        rcan: &Rcan,
        weights: &[f16],
        work: &mut [f16],
        (region, to): (Region, &mut [f16]),
        fast: &mut [f32],
    ) -> Result<(), PipelineError> {
        let at = work.len() - rcan.arena_len();
        let parameters = rcan::Parameters { weights, convolutions: None, scales: Scales::Measured(None) };
        let output = PlaneMut::new(to, region.rows.into(), region.cols.into())?;
        Ok(rcan.process(self.simd, parameters, &mut work[at..], region, output, fast)?)
    }

    /// Writes the input of a later pass to the end of `work`: what the frame holds beyond the prediction of the
    /// reconstruction with these logits, and the reconstruction.
    fn compare(
        &self,
        later: &Later<'_>,
        [seen, logits]: [&[f16]; 2],
        work: &mut [f16],
        fast: &mut [f32],
    ) -> Result<(), PipelineError> {
        let (work, x) = work.split_at_mut(work.len() - logits.len());
        x.copy_from_slice(logits);
        x.chunks_exact_mut(later.cols[0]).for_each(|row| sigmoids(row, &mut fast[..later.cols[0]]));
        let (frame_len, at) = (later.predictor.frame_len(), work.len() - seen.len());
        let predict = |frame: &mut [f16], arena: &mut [f16], fast: &mut [f32]| {
            later.predictor.process(self.simd, self.weights.predictor, x, frame, arena, fast)?;
            self.simd.run(Largest(frame));
            Ok::<_, PipelineError>(())
        };
        let difference = if self.filter.is_whole() {
            let (arena, frame) = work.split_at_mut(work.len() - frame_len);
            predict(frame, arena, fast)?;
            let source = Source::Predicted { frame, cols: later.cols[1] };
            self.filter.prepare(self.simd, &source, arena, fast)?;
            let (arena, difference) = work.split_at_mut(at);
            self.filtered(None, difference, arena, fast)?;
            difference
        } else {
            let (frame, arena) = work.split_at_mut(frame_len);
            predict(frame, arena, fast)?;
            let (arena, difference) = arena.split_at_mut(at - frame_len);
            self.filtered(Some(&Source::Predicted { frame, cols: later.cols[1] }), difference, arena, fast)?;
            difference
        };
        self.simd.run(Difference { seen, predicted: difference });
        Ok(())
    }
}

/// Replaces halves by their logistic function; `wide` is scratch of the same length.
fn sigmoids(halves: &mut [f16], wide: &mut [f32]) {
    widen_slice(halves, wide);
    sigmoid_slice(wide);
    narrow_slice(wide, halves);
}

/// `to = to + from`, in parts that fit into scratch.
fn add(from: &[f16], to: &mut [f16], scratch: &mut [f32]) {
    for (from, to) in from.chunks(scratch.len().max(1)).zip(to.chunks_mut(scratch.len().max(1))) {
        let wide = &mut scratch[..from.len()];
        widen_slice(from, wide);
        fused::accumulate(wide, to);
    }
}

/// Divides by the largest magnitude, where there is any.
struct Largest<'a>(&'a mut [f16]);

impl Kernel for Largest<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Vector>(self) {
        // The bits of magnitudes are in their order.
        let most = self.0.iter().fold(0, |most, value| (value.to_bits() & 0x7fff).max(most));
        if most > 0 {
            fused::divide(self.0, widen(f16::from_bits(most)));
        }
    }
}

/// Replaces what the filters make of a prediction by what they make of the frame beyond it.
struct Difference<'a> {
    seen: &'a [f16],
    predicted: &'a mut [f16],
}

impl Kernel for Difference<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Vector>(self) {
        let Self { seen, predicted } = self;
        if !max_finite(predicted).1 {
            predicted.fill(f16::ZERO);
        }
        let product = |a: &[f16], b: &[f16]| {
            let mut sums = [0.0; 8];
            fused::add_products_eights(a, b, &mut sums);
            let [a, b, c, d, e, f, g, h] = sums;
            ((a + b) + (c + d)) + ((e + f) + (g + h))
        };
        let square = product(predicted, predicted);
        let scale = product(seen, predicted) / if square > DARK { square } else { DARK };
        fused::difference(if scale.abs() < NO_SCALE { 0.0 } else { scale }, seen, predicted);
    }
}
