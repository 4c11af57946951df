//! The two ways in which the network's convolutions are computed: in halves and in integers.

use super::conv::{self, Conv3x3, Tensors};
use super::error::NnError;
use super::integer::{self, Channel, Convolution, Convolutions, Feature, Last, rescale};
use super::layout::Entry;
use super::means::means;
use super::upscale::Upscale;
use crate::image::{Chw, PlaneMut};
use crate::num::simd::Simd;
use crate::num::{f16, fused};
use bytemuck::Pod;
use core::marker::PhantomData;

/// The weights of the layers that have not been reached.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rest<'a> {
    /// Halves.
    pub halves: &'a [f16],
    /// Integers.
    pub weights: &'a [i8],
    /// Their output channels.
    pub channels: &'a [Channel],
}

impl<'a> Rest<'a> {
    /// The weights and biases of a layer in halves, as many as there are.
    pub fn halves(&mut self, entry: &Entry) -> conv::Parameters<'a> {
        let mut take = |len: usize| {
            let len = len.min(self.halves.len());
            self.halves.split_off(..len).unwrap_or_default()
        };
        conv::Parameters { weights: take(entry.weights_len()), bias: take(entry.bias_len()) }
    }
}

/// How convolutions are computed and features are stored.
pub(super) trait Arithmetic: Copy {
    /// A stored feature, no larger than a half.
    type Number: Pod;
    /// The weights of a 3x3 convolution.
    type Conv<'a>: Copy;

    /// Takes the weights of a 3x3 convolution.
    fn take<'a>(rest: &mut Rest<'a>, entry: &Entry) -> Self::Conv<'a>;

    /// Length of scratch of [`Self::conv`] for bands of `band` rows, numbers.
    fn conv_scratch_len(conv: &Conv3x3, band: usize) -> usize;

    /// A convolution.
    fn conv(
        self,
        conv: &Conv3x3,
        weights: Self::Conv<'_>,
        tensors: Tensors<'_, Self::Number>,
        scratch: &mut [f32],
    ) -> Result<(), NnError>;

    /// The mean of each channel.
    fn means(self, input: Chw<'_, Self::Number>, mean: &mut [f32]);

    /// `g = g + scale t`.
    fn add_scaled(self, scale: f32, t: &[Self::Number], g: &mut [Self::Number]);

    /// Length of scratch of [`Self::upscale`] for bands of `band` rows, numbers.
    fn upscale_scratch_len(plan: &Upscale, band: usize) -> usize;

    /// The end of the network.
    fn upscale(
        self,
        plan: &Upscale,
        weights: [Self::Conv<'_>; 2],
        input: Chw<'_, Self::Number>,
        origin: [usize; 2],
        output: PlaneMut<'_, f16>,
        scratch: &mut [f32],
    ) -> Result<(), NnError>;
}

/// Features and weights in halves, sums in binary32.
#[derive(Clone, Copy, Debug)]
pub(super) struct Halves(pub Simd);

impl Arithmetic for Halves {
    type Number = f16;
    type Conv<'a> = conv::Parameters<'a>;

    fn take<'a>(rest: &mut Rest<'a>, entry: &Entry) -> Self::Conv<'a> {
        rest.halves(entry)
    }

    fn conv_scratch_len(conv: &Conv3x3, band: usize) -> usize {
        conv.scratch_len(band)
    }

    fn conv(
        self,
        conv: &Conv3x3,
        weights: Self::Conv<'_>,
        tensors: Tensors<'_, f16>,
        scratch: &mut [f32],
    ) -> Result<(), NnError> {
        conv.process(self.0, weights, tensors, scratch)
    }

    fn means(self, input: Chw<'_, f16>, mean: &mut [f32]) {
        means(self.0, input, mean);
    }

    fn add_scaled(self, scale: f32, t: &[f16], g: &mut [f16]) {
        self.0.run(AddScaled { scale, t, g });
    }

    fn upscale_scratch_len(plan: &Upscale, band: usize) -> usize {
        plan.scratch_len(band)
    }

    fn upscale(
        self,
        plan: &Upscale,
        weights: [Self::Conv<'_>; 2],
        input: Chw<'_, f16>,
        origin: [usize; 2],
        output: PlaneMut<'_, f16>,
        scratch: &mut [f32],
    ) -> Result<(), NnError> {
        plan.process(self.0, weights, input, origin, output, scratch)
    }
}

struct AddScaled<'a> {
    scale: f32,
    t: &'a [f16],
    g: &'a mut [f16],
}

impl crate::num::simd::Kernel for AddScaled<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: crate::num::simd::Vector>(self) {
        fused::add_scaled(self.scale, self.t, self.g);
    }
}

/// Features in integers, weights of 8 bits, sums of 32.
#[derive(Clone, Copy, Debug)]
pub(super) struct Integers<F> {
    /// How features are stored.
    pub features: PhantomData<F>,
    /// Instruction set.
    pub simd: Simd,
    /// Integers in 1 of the network's input.
    pub input_scale: f32,
    /// What a unit of a feature is worth.
    pub feature: f32,
    /// Argument of the logistic function for a last sum of 1.
    pub output: f32,
}

impl<F: Feature> Arithmetic for Integers<F> {
    type Number = F;
    type Conv<'a> = Convolution<'a>;

    fn take<'a>(rest: &mut Rest<'a>, entry: &Entry) -> Self::Conv<'a> {
        Convolutions::next(&mut rest.weights, &mut rest.channels, entry)
    }

    fn conv_scratch_len(conv: &Conv3x3, band: usize) -> usize {
        integer::scratch_len(conv, band)
    }

    fn conv(
        self,
        conv: &Conv3x3,
        weights: Self::Conv<'_>,
        tensors: Tensors<'_, F>,
        scratch: &mut [f32],
    ) -> Result<(), NnError> {
        integer::process(conv, self.simd, weights, self.input_scale, tensors, scratch)
    }

    fn means(self, input: Chw<'_, F>, mean: &mut [f32]) {
        let [_, rows, cols] = input.shape();
        for (channel, mean) in mean.iter_mut().enumerate() {
            // A row of at most 2^15 numbers fits 32 bits.
            let row = |row| i64::from(rescale::sum(input.row(channel, row)));
            let sum: i64 = (0..rows).map(row).sum();
            *mean = sum as f32 / (rows * cols) as f32 * self.feature;
        }
    }

    fn add_scaled(self, scale: f32, t: &[F], g: &mut [F]) {
        rescale::add_scaled(rescale::of_scale(scale), t, g);
    }

    fn upscale_scratch_len(plan: &Upscale, band: usize) -> usize {
        integer::upscale_scratch_len(plan, band)
    }

    fn upscale(
        self,
        plan: &Upscale,
        convolutions: [Self::Conv<'_>; 2],
        input: Chw<'_, F>,
        origin: [usize; 2],
        output: PlaneMut<'_, f16>,
        scratch: &mut [f32],
    ) -> Result<(), NnError> {
        integer::upscale(plan, self.simd, Last { convolutions, unit: self.output }, input, origin, output, scratch)
    }
}
