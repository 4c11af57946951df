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
//! A region of the output costs less than all of it: what comes after the last attention is computed for the features that the region
//! takes, and no others, with the same bits. All before it is computed in full, because attention is a mean over the whole frame.
//!
//! [`layout`] gives the order of the weights in the network file: the order of execution, each layer's weights before its biases.

use super::activation::Activation;
use super::channel_attention;
use super::conv::{Addressing, Conv3x3, Parameters, Store, Tensors};
use super::error::{NnError, check_scratch, check_shape, check_weights};
use super::rcab::{self, Rcab};
use super::upscale::Upscale;
use crate::blob;
use crate::image::{Chw, ChwMut, PlaneMut, Region};
use crate::num::f16;
use crate::num::simd::Simd;

/// A layer that has weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layer {
    /// 3x3, 4 C -> W.
    Head,
    /// Convolution `conv` (0 or 1) of an RCAB, 3x3, W -> W.
    BlockConv {
        /// Group.
        group: u8,
        /// Block in the group.
        block: u8,
        /// First (0) or second (1).
        conv: u8,
    },
    /// First layer of a block's channel attention, 1x1, W -> W/r.
    Squeeze {
        /// Group.
        group: u8,
        /// Block in the group.
        block: u8,
    },
    /// Second layer of a block's channel attention, 1x1, W/r -> W.
    Excite {
        /// Group.
        group: u8,
        /// Block in the group.
        block: u8,
    },
    /// Convolution at the end of a group, 3x3, W -> W.
    GroupConv {
        /// Group.
        group: u8,
    },
    /// `conv1`, before the long skip, 3x3, W -> W.
    Conv1,
    /// Before the pixel shuffle, 3x3, W -> 4 W.
    Upscale,
    /// `conv2`, 3x3, W -> 1.
    Conv2,
}

/// One layer of the weight section: `outputs * inputs * kernel^2` weights `[out, in, ky, kx]`, then `outputs` biases.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry {
    /// Which layer.
    pub layer: Layer,
    /// Output channels.
    pub outputs: usize,
    /// Input channels.
    pub inputs: usize,
    /// Side of the kernel: 3 or 1.
    pub kernel: usize,
}

impl Entry {
    /// Halves of the weights.
    pub const fn weights_len(&self) -> usize {
        self.outputs * self.inputs * self.kernel * self.kernel
    }

    /// Halves of the biases.
    pub const fn bias_len(&self) -> usize {
        self.outputs
    }
}

/// The layers of a network with `channels` filters in the order in which their weights lie in the file.
pub fn layout(rcan: &blob::Rcan, channels: u8) -> impl Iterator<Item = Entry> + use<> {
    let rcan = *rcan;
    let (width, filters) = (usize::from(rcan.width), usize::from(channels));
    let hidden = hidden(&rcan);
    let entry = |layer, outputs, inputs, kernel| Entry { layer, outputs, inputs, kernel };
    let body = (0..rcan.groups).flat_map(move |group| {
        let blocks = (0..rcan.blocks).flat_map(move |block| {
            [
                entry(Layer::BlockConv { group, block, conv: 0 }, width, width, 3),
                entry(Layer::BlockConv { group, block, conv: 1 }, width, width, 3),
                entry(Layer::Squeeze { group, block }, hidden, width, 1),
                entry(Layer::Excite { group, block }, width, hidden, 1),
            ]
        });
        blocks.chain([entry(Layer::GroupConv { group }, width, width, 3)])
    });
    let tail = [
        entry(Layer::Conv1, width, width, 3),
        entry(Layer::Upscale, 4 * width, width, 3),
        entry(Layer::Conv2, 1, width, 3),
    ];
    [entry(Layer::Head, width, 4 * filters, 3)].into_iter().chain(body).chain(tail)
}

/// Halves of the whole weight section.
pub fn weights_len(rcan: &blob::Rcan, channels: u8) -> usize {
    layout(rcan, channels).map(|entry| entry.weights_len() + entry.bias_len()).sum()
}

/// Width W/r of the attention's bottleneck; 0 where the reduction is 0 or above the width, which no network may have.
pub const fn hidden(rcan: &blob::Rcan) -> usize {
    match rcan.width.checked_div(rcan.reduction) {
        Some(hidden) => hidden as usize,
        None => 0,
    }
}

/// Plan of the network for one frame size.
#[derive(Clone, Copy, Debug)]
pub struct Rcan {
    shape: blob::Rcan,
    filters: usize,
    rows: usize,
    cols: usize,
}

impl Rcan {
    /// Plans for `channels` filters and an output of `object` pixels (even rows and columns).
    pub fn new(shape: blob::Rcan, channels: u8, object: blob::Size) -> Self {
        Self {
            shape,
            filters: usize::from(channels),
            rows: usize::from(object.rows) / 2,
            cols: usize::from(object.cols) / 2,
        }
    }

    const fn width(&self) -> usize {
        self.shape.width as usize
    }

    /// Halves of one feature tensor (W, h, w).
    pub const fn feature_len(&self) -> usize {
        self.width() * self.rows * self.cols
    }

    /// Halves of the input (C, 2 h, 2 w).
    pub const fn input_len(&self) -> usize {
        self.filters * 4 * self.rows * self.cols
    }

    /// Halves of the arena that [`Self::process`] needs. The input lies at its end and is overwritten.
    pub const fn arena_len(&self) -> usize {
        let (features, head) = (4 * self.feature_len(), self.feature_len() + self.input_len());
        if features > head { features } else { head }
    }

    /// Numbers of scratch for bands of `band` rows; with 1 the least that [`Self::process`] works with.
    pub fn scratch_len(&self, band: usize) -> usize {
        let convs = self.head().scratch_len(band).max(self.conv().scratch_len(band));
        convs.max(self.rcab().scratch_len(band)).max(self.upscale().scratch_len(band))
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

    const fn rcab(&self) -> Rcab {
        Rcab { channels: self.width(), hidden: hidden(&self.shape), rows: self.rows, cols: self.cols }
    }

    const fn upscale(&self) -> Upscale {
        Upscale { channels: self.width(), rows: self.rows, cols: self.cols }
    }

    /// Runs the network. The last [`Self::input_len`] halves of `arena` hold the filtered channels (C, 2 h, 2 w), divided by
    /// their maximum; `output` is `region` of the result (2 h, 2 w), 0 to 1. The arena is overwritten.
    ///
    /// # Errors
    /// [`NnError`] where the weights, the arena, the output or the scratch do not fit the plan.
    pub fn process(
        &self,
        simd: Simd,
        weights: &[f16],
        arena: &mut [f16],
        region: Region,
        output: PlaneMut<'_, f16>,
        scratch: &mut [f32],
    ) -> Result<(), NnError> {
        check_weights(weights_len(&self.shape, self.filters as u8), weights.len())?;
        check_scratch(self.arena_len(), arena.len())?;
        check_scratch(self.scratch_len(1), scratch.len())?;
        check_shape([1, region.rows.into(), region.cols.into()], [1, output.rows(), output.cols()])?;
        let mut layers = Layers { entries: layout(&self.shape, self.filters as u8), rest: weights };
        let (head, rest) = arena.split_at_mut(self.feature_len());
        let input = &rest[rest.len() - self.input_len()..];
        let input = self.input(input)?;
        let tensors = Tensors::Apart { input, addressing: Addressing::Unshuffled, output: self.features(head)? };
        self.head().process(simd, layers.next_conv(), tensors, scratch)?;
        let (y, rest) = rest.split_at_mut(self.feature_len());
        let (g, rest) = rest.split_at_mut(self.feature_len());
        let t = &mut rest[..self.feature_len()];
        y.copy_from_slice(head);
        let mut part = Part { plan: *self, window: Region::whole(self.rows as u16, self.cols as u16) };
        for group in 0..self.shape.groups {
            g.copy_from_slice(y);
            for _ in 0..self.shape.blocks {
                let parameters = layers.next_block();
                self.rcab().process(simd, parameters, self.features(g)?, self.features(t)?, scratch)?;
            }
            if group + 1 == self.shape.groups {
                part = part.cut(self.window(region, 3), [g, y, head])?;
            }
            part.plan.skip(simd, layers.next_conv(), g, y, scratch)?;
        }
        part = part.cut(self.window(region, 2), [y, head])?;
        part.plan.skip(simd, layers.next_conv(), y, head, scratch)?;
        part = part.cut(self.window(region, 1), [head])?;
        let tail = [layers.next_conv(), layers.next_conv()];
        let origin = [region.row - 2 * part.window.row, region.col - 2 * part.window.col].map(usize::from);
        let features = part.plan.features(head)?;
        part.plan.upscale().process(simd, tail, features.as_chw(), origin, output, scratch)
    }

    /// The features that a region of the output takes through `convs` convolutions and the last one, which is at full resolution.
    fn window(&self, region: Region, convs: u16) -> Region {
        let axis = |first: u16, len: u16, all: usize| {
            let start = (first.saturating_sub(1) / 2).saturating_sub(convs);
            let end = ((first + len) / 2 + 1 + convs).min(all as u16);
            (start, end - start)
        };
        let (row, rows) = axis(region.row, region.rows, self.rows);
        let (col, cols) = axis(region.col, region.cols, self.cols);
        Region { row, col, rows, cols }
    }

    /// `to = to + conv(from)`.
    fn skip(
        &self,
        simd: Simd,
        parameters: Parameters<'_>,
        from: &mut [f16],
        to: &mut [f16],
        scratch: &mut [f32],
    ) -> Result<(), NnError> {
        let (input, output) = (self.features(from)?, self.features(to)?);
        let tensors = Tensors::Apart { input: input.as_chw(), addressing: Addressing::Direct, output };
        self.conv().process(simd, parameters, tensors, scratch)
    }

    /// The tensor at the front of `data`.
    fn features<'a>(&self, data: &'a mut [f16]) -> Result<ChwMut<'a, f16>, NnError> {
        let found = data.len();
        let data = data.get_mut(..self.feature_len()).unwrap_or_default();
        ChwMut::new(data, self.width(), self.rows, self.cols)
            .map_err(|error| NnError::Scratch { expected: error.expected, found })
    }

    fn input<'a>(&self, data: &'a [f16]) -> Result<Chw<'a, f16>, NnError> {
        Chw::new(data, self.filters, 2 * self.rows, 2 * self.cols)
            .map_err(|error| NnError::Scratch { expected: error.expected, found: error.found })
    }
}

/// The network for a window of the features. What a convolution makes at its edges lacks what lies beyond, and is cut off before the next,
/// unless the edge is the frame's.
#[derive(Clone, Copy)]
struct Part {
    plan: Rcan,
    window: Region,
}

impl Part {
    /// The part for a window in this one's, to which the tensors are cut.
    fn cut<const N: usize>(self, window: Region, tensors: [&mut [f16]; N]) -> Result<Self, NnError> {
        let Self { plan, window: from } = self;
        for tensor in tensors {
            let (row, col) = (window.row - from.row, window.col - from.col);
            plan.features(tensor)?.cut(Region { row, col, ..window });
        }
        let (rows, cols) = (window.rows.into(), window.cols.into());
        Ok(Self { plan: Rcan { rows, cols, ..plan }, window })
    }
}

/// Hands out the weights layer by layer. The total length has been checked, so none is cut short.
struct Layers<'a, I> {
    entries: I,
    rest: &'a [f16],
}

impl<'a, I: Iterator<Item = Entry>> Layers<'a, I> {
    fn next_conv(&mut self) -> Parameters<'a> {
        let (weights, bias) = self.entries.next().map_or((0, 0), |entry| (entry.weights_len(), entry.bias_len()));
        Parameters { weights: self.take(weights), bias: self.take(bias) }
    }

    fn next_block(&mut self) -> rcab::Parameters<'a> {
        let convs = [self.next_conv(), self.next_conv()];
        let [squeeze, excite] = [self.next_conv(), self.next_conv()];
        let attention = channel_attention::Parameters {
            squeeze: squeeze.weights,
            squeeze_bias: squeeze.bias,
            excite: excite.weights,
            excite_bias: excite.bias,
        };
        rcab::Parameters { convs, attention }
    }

    fn take(&mut self, len: usize) -> &'a [f16] {
        let (taken, rest) = self.rest.split_at(len.min(self.rest.len()));
        self.rest = rest;
        taken
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use crate::naive::{self, Noise, Tensor, wide};
    use std::vec;
    use std::vec::Vec;

    const SHAPE: blob::Rcan = blob::Rcan { width: 8, groups: 2, blocks: 2, reduction: 4 };
    const OBJECT: blob::Size = blob::Size { rows: 14, cols: 20 };

    /// About 20 roundings to half in a row, each 2^-12 r.m.s. of the features; the slope of the sigmoid is at most 1/4.
    const TOLERANCE: f64 = 1.0e-3;

    fn run(simd: Simd, band: usize, weights: &[f16], input: &[f16]) -> Vec<f16> {
        run_region(simd, band, weights, input, Region::whole(14, 20))
    }

    fn run_region(simd: Simd, band: usize, weights: &[f16], input: &[f16], region: Region) -> Vec<f16> {
        let plan = Rcan::new(SHAPE, 3, OBJECT);
        let mut arena = vec![f16::NAN; plan.arena_len()];
        let start = arena.len() - plan.input_len();
        arena[start..].copy_from_slice(input);
        let mut output = vec![f16::NAN; region.pixels()];
        let mut scratch = vec![f32::NAN; plan.scratch_len(band)];
        let plane = PlaneMut::new(&mut output, region.rows.into(), region.cols.into()).unwrap();
        plan.process(simd, weights, &mut arena, region, plane, &mut scratch).unwrap();
        output
    }

    #[test]
    fn agrees_with_the_definition_whatever_the_band() {
        let mut noise = Noise(10);
        let weights = noise.halves(weights_len(&SHAPE, 3), 0.15);
        let input = noise.halves(3 * 280, 1.0);
        let expected = naive::rcan(&Tensor::new([3, 14, 20], wide(&input)), [2, 2, 8, 2], &wide(&weights));
        let spread = expected.data.iter().fold((1.0_f64, 0.0_f64), |(low, high), &x| (low.min(x), high.max(x)));
        assert!(spread.1 - spread.0 > 0.1, "a network that does nothing would pass: {spread:?}");
        let found = run(Simd::detect(), 1, &weights, &input);
        let error = naive::error(&found, &expected.data);
        assert!(error < TOLERANCE, "{error:e}");
        for band in [2, 3, 7, 100] {
            assert_eq!(run(Simd::PORTABLE, band, &weights, &input), found, "bands of {band} rows");
        }
    }

    #[test]
    fn every_region_is_a_cut_of_the_whole() {
        let mut noise = Noise(11);
        let weights = noise.halves(weights_len(&SHAPE, 3), 0.15);
        let input = noise.halves(3 * 280, 1.0);
        let whole = run(Simd::detect(), 2, &weights, &input);
        for row in 0..14_u16 {
            for rows in 1..=14 - row {
                for (col, cols) in [(0, 20), (0, 1), (19, 1), (7, 4), (8, 5), (1, 18)] {
                    let region = Region { row, col, rows, cols };
                    let cut = |r: u16| &whole[usize::from(r) * 20 + usize::from(col)..][..usize::from(cols)];
                    let expected: Vec<f16> = (row..row + rows).flat_map(cut).copied().collect();
                    assert_eq!(run_region(Simd::detect(), 3, &weights, &input, region), expected, "{region}");
                }
            }
        }
    }

    #[test]
    fn the_reference_network_has_its_published_size() {
        let shape = blob::Rcan { width: 32, groups: 2, blocks: 3, reduction: 16 };
        assert_eq!(layout(&shape, 9).count(), 1 + 2 * (3 * 4 + 1) + 3);
        // Xue et al.: "approximately 0.18 million parameters".
        assert_eq!(weights_len(&shape, 9), 187_373);
        let first: Vec<_> = layout(&shape, 9).take(5).collect();
        assert_eq!((first[0].layer, first[0].weights_len(), first[0].bias_len()), (Layer::Head, 36 * 32 * 9, 32));
        assert_eq!(first[2].layer, Layer::BlockConv { group: 0, block: 0, conv: 1 });
        assert_eq!((first[3].outputs, first[3].inputs, first[3].kernel), (2, 32, 1));
        assert_eq!((first[4].outputs, first[4].inputs, first[4].kernel), (32, 2, 1));
    }
}
