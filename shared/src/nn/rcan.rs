//! The enhancement network.
//!
//! With C filter channels, W features, all 3x3 convolutions with bias and zero padding 1:
//! ```text
//! x    = PixelUnshuffle2(channels)                       4 C, h, w
//! head = conv(x)                                         W, h, w
//! y    = head
//! for each group:
//!     g = y
//!     for each block:  t = conv(relu(conv(g)));  g = g + attention(t) t
//!     y = y + conv(g)
//! y    = head + conv1(y)
//! out  = sigmoid(conv2(PixelShuffle2(conv(y))))          conv W -> 4 W, conv2 W -> 1
//! ```
//! Every tensor named here is rounded to half once, when it is stored; so is the output of the inner `relu(conv(g))`.
//!
//! # Regions
//! A region of the output costs less than the whole. Before each convolution the features are cut to the window that
//! the region depends on through the rest of the network. That changes no bit inside. But attention depends on the
//! whole frame: where its scales are measured ([`Scales`]), the windows are the whole frame up to the last block, and
//! only later layers are cut. Where they are held from another frame, every window is cut, and so is the input.
//!
//! [`layout`](fn@layout) is the order of the weights in the network file: the order of execution, the weights of each
//! layer before its biases.

pub(crate) use super::layout::attention_count;
pub use super::layout::{Entry, Layer, hidden, layout, weights_count, weights_len};

use super::activation::Activation;
use super::arithmetic::{Arithmetic, Halves, Integers, Rest};
use super::channel_attention::{self, Scales};
use super::conv::{self, Conv3x3, Store, Tensors};
use super::error::{NnError, check_scratch, check_shape, check_weights};
use super::features::Features;
use super::integer::Convolutions;
use super::rcab::{self, Rcab};
use super::upscale::Upscale;
use crate::blob::{self, FeatureBits};
use crate::image::{Chw, PlaneMut, Region};
use crate::num::f16;
use crate::num::simd::Simd;
use core::marker::PhantomData;

/// Convolutions of features after the last attention: the last group's, `conv1`, and the one before the pixel shuffle.
const AFTER_ATTENTION: usize = 3;

/// Parameters of the network.
#[derive(Debug)]
pub struct Parameters<'a> {
    /// Weights in the order of [`layout`]; those of the channel attentions alone where the convolutions are integers.
    pub weights: &'a [f16],
    /// The convolutions of a network in integers.
    pub convolutions: Option<Convolutions<'a>>,
    /// Source of the [`Rcan::scales_len`] scales of the channel attentions.
    pub scales: Scales<'a>,
}

/// Plan of the network for one frame size.
#[derive(Clone, Copy, Debug)]
pub struct Rcan {
    shape: blob::Rcan,
    integers: Option<blob::Integers>,
    filters: usize,
    rows: usize,
    cols: usize,
    end: Activation,
}

impl Rcan {
    /// Plans a network for `channels` filters and an output of `object` pixels, even in both directions, in halves or
    /// in integers.
    ///
    /// # Errors
    /// [`NnError::TooLarge`] where its features would have 4 GiB or more.
    pub fn new(
        shape: blob::Rcan,
        integers: Option<blob::Integers>,
        channels: u8,
        object: blob::Size,
    ) -> Result<Self, NnError> {
        let (rows, cols) = (usize::from(object.rows) / 2, usize::from(object.cols) / 2);
        // At most 8 + 2 + 15 + 15 bits each. All other lengths of the plan are parts of these.
        let feature = u64::from(shape.width) * rows as u64 * cols as u64;
        let input = 4 * u64::from(channels) * rows as u64 * cols as u64;
        let needed = (4 * feature).max(feature + input) * size_of::<f16>() as u64;
        if needed > u64::from(u32::MAX) {
            return Err(NnError::TooLarge { needed });
        }
        Ok(Self { shape, integers, filters: usize::from(channels), rows, cols, end: Activation::Sigmoid })
    }

    /// The plan of the same network without the sigmoid at its end: it gives logits. Of networks in halves only.
    pub const fn to_logits(self) -> Self {
        Self { end: Activation::Linear, ..self }
    }

    const fn width(&self) -> usize {
        self.shape.width as usize
    }

    /// Room for one feature tensor (W, h, w), halves.
    const fn feature_len(&self) -> usize {
        let len = self.width() * self.rows * self.cols;
        match self.integers {
            Some(blob::Integers { features: FeatureBits::Eight, .. }) => len.div_ceil(2),
            _ => len,
        }
    }

    /// Length of the input (C, 2 h, 2 w), halves.
    pub const fn input_len(&self) -> usize {
        self.filters * 4 * self.rows * self.cols
    }

    /// Shape (C, 2 h, 2 w) of the input.
    pub const fn input_shape(&self) -> [usize; 3] {
        [self.filters, 2 * self.rows, 2 * self.cols]
    }

    /// Length of the weights in halves ([`weights_len`]).
    pub fn weights_len(&self) -> usize {
        weights_len(&self.shape, self.filters as u8)
    }

    /// Length of the arena for [`Self::process`], halves. The input lies at its end and is overwritten.
    pub const fn arena_len(&self) -> usize {
        let (features, head) = (4 * self.feature_len(), self.feature_len() + self.input_len());
        if features > head { features } else { head }
    }

    /// Number of scales of all channel attentions: W in each block.
    pub const fn scales_len(&self) -> usize {
        self.width() * self.shape.groups as usize * self.shape.blocks as usize
    }

    /// Number of convolutions of features, one after the other.
    pub const fn depth(&self) -> usize {
        1 + self.shape.groups as usize * (2 * self.shape.blocks as usize + 1) + 2
    }

    /// Length of scratch for bands of `band` rows, numbers. With bands of 1 row it is what [`Self::process`] needs at
    /// least.
    pub fn scratch_len(&self, band: usize) -> usize {
        match self.integers {
            None => self.scratch_len_in::<Halves>(band),
            // The same for features of 8 bits.
            Some(_) => self.scratch_len_in::<Integers<i16>>(band),
        }
    }

    fn scratch_len_in<A: Arithmetic>(&self, band: usize) -> usize {
        let convs = A::conv_scratch_len(&self.head(), band).max(A::conv_scratch_len(&self.conv(), band));
        let block = self.rcab([self.whole(); 2]).scratch_len::<A>(band);
        convs.max(block).max(A::upscale_scratch_len(&self.upscale(), band))
    }

    const fn head(&self) -> Conv3x3 {
        Conv3x3 { inputs: 4 * self.filters, store: Store::Replace, ..self.conv() }
    }

    /// The convolutions that end in a skip connection.
    const fn conv(&self) -> Conv3x3 {
        Conv3x3 {
            inputs: self.width(),
            outputs: self.width(),
            rows: self.rows,
            cols: self.cols,
            activation: Activation::Linear,
            store: Store::Accumulate,
        }
    }

    const fn rcab(&self, windows: [Region; 2]) -> Rcab {
        Rcab { channels: self.width(), hidden: hidden(&self.shape), windows }
    }

    const fn upscale(&self) -> Upscale {
        Upscale { channels: self.width(), rows: self.rows, cols: self.cols, end: self.end }
    }

    /// The plan of the same network for a window of the features.
    const fn on(&self, window: Region) -> Self {
        Self { rows: window.rows as usize, cols: window.cols as usize, ..*self }
    }

    /// The window of all features.
    const fn whole(&self) -> Region {
        Region::whole(self.rows as u16, self.cols as u16)
    }

    /// The part of the input that [`Self::process`] needs for a region of the output, pixels. `held`: whether the
    /// attention scales are held from another frame; where they are measured, the whole input is needed.
    pub fn input(&self, region: Region, held: bool) -> Region {
        let Region { row, col, rows, cols } = self.first_window(region, held);
        Region { row: 2 * row, col: 2 * col, rows: 2 * rows, cols: 2 * cols }
    }

    /// Runs the network. The end of `arena` holds the filtered channels (C, rows, columns of [`Self::input`]), divided
    /// by their maximum. `output` receives `region` of the result (2 h, 2 w), 0 to 1, or its logits. The arena is
    /// overwritten.
    ///
    /// # Errors
    /// [`NnError`] where the weights, the scales, the arena, the output or the scratch do not fit the plan.
    pub fn process(
        &self,
        simd: Simd,
        parameters: Parameters<'_>,
        arena: &mut [f16],
        region: Region,
        output: PlaneMut<'_, f16>,
        scratch: &mut [f32],
    ) -> Result<(), NnError> {
        let Parameters { weights, convolutions, scales } = parameters;
        match (self.integers, convolutions) {
            (Some(integers), Some(convolutions)) => {
                check_weights(attention_count(&self.shape, self.filters as u8) as usize, weights.len())?;
                let rest = Rest { halves: weights, weights: convolutions.bytes(), channels: convolutions.channels };
                if integers.features == FeatureBits::Eight {
                    let arithmetic = in_integers::<i8>(simd, integers);
                    self.process_in(arithmetic, rest, scales, arena, region, output, scratch)
                } else {
                    let arithmetic = in_integers::<i16>(simd, integers);
                    self.process_in(arithmetic, rest, scales, arena, region, output, scratch)
                }
            }
            _ => {
                check_weights(weights_len(&self.shape, self.filters as u8), weights.len())?;
                let rest = Rest { halves: weights, weights: &[], channels: &[] };
                self.process_in(Halves(simd), rest, scales, arena, region, output, scratch)
            }
        }
    }

    /// Not inlined: the kinds would share one large frame on the stack.
    #[inline(never)]
    #[expect(clippy::too_many_arguments, reason = "those of `process`, and the kind of numbers")]
    fn process_in<A: Arithmetic>(
        &self,
        arithmetic: A,
        rest: Rest<'_>,
        mut scales: Scales<'_>,
        arena: &mut [f16],
        region: Region,
        output: PlaneMut<'_, f16>,
        scratch: &mut [f32],
    ) -> Result<(), NnError> {
        check_scratch(self.arena_len(), arena.len())?;
        check_scratch(self.scratch_len(1), scratch.len())?;
        check_shape([1, region.rows.into(), region.cols.into()], [1, output.rows(), output.cols()])?;
        let held = match &scales {
            Scales::Measured(None) => false,
            Scales::Measured(Some(place)) => check_weights(self.scales_len(), place.len()).map(|()| false)?,
            Scales::Held(scales) => check_weights(self.scales_len(), scales.len()).map(|()| true)?,
        };
        let window = |left| if held || left <= AFTER_ATTENTION { self.window(region, left) } else { self.whole() };
        let first = self.first_window(region, held);
        let mut layers = Layers { entries: layout(&self.shape, self.filters as u8), rest };
        let plan = self.on(first);
        let (head, rest) = arena.split_at_mut(plan.feature_len());
        let mut head = Features::new(numbers::<A>(head), self.width(), first);
        let input = plan.read(&rest[rest.len() - plan.input_len()..])?;
        let tensors = Tensors::Unshuffled { input, output: head.cut(first)? };
        arithmetic.conv(&plan.head(), layers.next_conv::<A>(), tensors, scratch)?;
        let (y, rest) = rest.split_at_mut(plan.feature_len());
        let (g, t) = rest.split_at_mut(plan.feature_len());
        let [y, g, t] = [y, g, t].map(numbers::<A>);
        let [mut y, mut g] = [y, g].map(|data| Features::new(data, self.width(), first));
        y.copy_from(&head)?;
        // Number of convolutions of features that follow.
        let mut left = self.depth() - 1;
        for _ in 0..self.shape.groups {
            g.copy_from(&y)?;
            for _ in 0..self.shape.blocks {
                let (rcab, scales) = (self.rcab([window(left), window(left - 1)]), scales.next(self.width()));
                rcab.process(arithmetic, layers.next_block::<A>(), scales, &mut g, t, scratch)?;
                left -= 2;
            }
            self.skip(arithmetic, layers.next_conv::<A>(), window(left), [&mut g, &mut y], scratch)?;
            left -= 1;
        }
        self.skip(arithmetic, layers.next_conv::<A>(), window(2), [&mut y, &mut head], scratch)?;
        let last = window(1);
        let tail = [layers.next_conv::<A>(), layers.next_conv::<A>()];
        let origin = [region.row - 2 * last.row, region.col - 2 * last.col].map(usize::from);
        arithmetic.upscale(&self.on(last).upscale(), tail, head.cut(last)?.as_chw(), origin, output, scratch)
    }

    /// The features that a region of the output depends on through `left` convolutions of features and the last one,
    /// which is at full resolution.
    pub fn window(&self, region: Region, left: usize) -> Region {
        let [rows, cols] = region.ranges();
        let axis = |part: core::ops::Range<usize>, all: usize| {
            let start = (part.start.saturating_sub(1) / 2).saturating_sub(left);
            let end = (part.end / 2 + 1 + left).min(all);
            (start as u16, (end - start) as u16)
        };
        let ((row, rows), (col, cols)) = (axis(rows, self.rows), axis(cols, self.cols));
        Region { row, col, rows, cols }
    }

    /// The features that the first convolution computes.
    fn first_window(&self, region: Region, held: bool) -> Region {
        if held { self.window(region, self.depth()) } else { self.whole() }
    }

    /// `to = to + conv(from)` on a window of both.
    fn skip<A: Arithmetic>(
        &self,
        arithmetic: A,
        weights: A::Conv<'_>,
        window: Region,
        [from, to]: [&mut Features<'_, A::Number>; 2],
        scratch: &mut [f32],
    ) -> Result<(), NnError> {
        let (input, output) = (from.cut(window)?, to.cut(window)?);
        let tensors = Tensors::Apart { input: input.as_chw(), output };
        arithmetic.conv(&self.on(window).conv(), weights, tensors, scratch)
    }

    fn read<'a>(&self, data: &'a [f16]) -> Result<Chw<'a, f16>, NnError> {
        Chw::new(data, self.filters, 2 * self.rows, 2 * self.cols)
            .map_err(|error| NnError::Scratch { expected: error.expected, found: error.found })
    }
}

/// Halves as features, which have the same size or half of it.
fn numbers<A: Arithmetic>(halves: &mut [f16]) -> &mut [A::Number] {
    bytemuck::cast_slice_mut(halves)
}

/// Integers with the scales of the header.
const fn in_integers<F>(simd: Simd, integers: blob::Integers) -> Integers<F> {
    Integers {
        features: PhantomData,
        simd,
        input_scale: power_of_two(integers.input_log2),
        feature: power_of_two(-integers.feature_log2),
        output: integers.output,
    }
}

/// `2^exponent`, for exponents from -126 to 127.
const fn power_of_two(exponent: i8) -> f32 {
    f32::from_bits(((exponent as i32 + 127) as u32) << 23)
}

/// Divides the weights among the layers. The total length has been checked, so no layer gets too few.
struct Layers<'a, I> {
    entries: I,
    rest: Rest<'a>,
}

impl<'a, I: Iterator<Item = Entry>> Layers<'a, I> {
    fn next_entry(&mut self) -> Entry {
        self.entries.next().unwrap_or(Entry { layer: Layer::Head, outputs: 0, inputs: 0, kernel: 0 })
    }

    fn next_conv<A: Arithmetic>(&mut self) -> A::Conv<'a> {
        let entry = self.next_entry();
        A::take(&mut self.rest, &entry)
    }

    fn next_dense(&mut self) -> conv::Parameters<'a> {
        let entry = self.next_entry();
        self.rest.halves(&entry)
    }

    fn next_block<A: Arithmetic>(&mut self) -> rcab::Parameters<'a, A::Conv<'a>> {
        let convs = [self.next_conv::<A>(), self.next_conv::<A>()];
        let [squeeze, excite] = [self.next_dense(), self.next_dense()];
        let attention = channel_attention::Parameters {
            squeeze: squeeze.weights,
            squeeze_bias: squeeze.bias,
            excite: excite.weights,
            excite_bias: excite.bias,
        };
        rcab::Parameters { convs, attention }
    }
}

#[cfg(test)]
mod tests;
