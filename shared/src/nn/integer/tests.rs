//! Integer networks against their definition, bit for bit.

extern crate std;

use super::*;
use crate::blob::{self, BlobError, FeatureBits, Section};
use crate::image::{Chw, ChwMut, PlaneMut, Region};
use crate::naive::{self, Noise, wide};
use crate::nn::activation::Activation;
use crate::nn::channel_attention::Scales;
use crate::nn::conv::{Conv3x3, Store, Tensors};
use crate::nn::error::NnError;
use crate::nn::rcan::{Parameters, Rcan, attention_count, hidden};
use crate::num::simd::Simd;
use crate::num::{f16, narrow, sigmoid};
use proptest::prelude::*;
use std::vec;
use std::vec::Vec;

/// A tensor of integers that cannot overflow.
#[derive(Clone, Debug, PartialEq)]
struct Wide {
    shape: [usize; 3],
    data: Vec<i128>,
}

impl Wide {
    fn new(shape: [usize; 3], data: impl IntoIterator<Item = i128>) -> Self {
        let data: Vec<i128> = data.into_iter().collect();
        assert_eq!(data.len(), shape.iter().product::<usize>());
        Self { shape, data }
    }

    fn at(&self, k: usize, r: isize, c: isize) -> i128 {
        let [_, rows, cols] = self.shape;
        let inside = (0..rows as isize).contains(&r) && (0..cols as isize).contains(&c);
        if inside { self.data[(k * rows + r as usize) * cols + c as usize] } else { 0 }
    }

    fn build(shape: [usize; 3], f: impl Fn(usize, isize, isize) -> i128) -> Self {
        let [channels, rows, cols] = shape.map(|n| n as isize);
        let f = &f;
        let each = (0..channels).flat_map(|k| (0..rows).flat_map(move |r| (0..cols).map(move |c| f(k as usize, r, c))));
        Self::new(shape, each)
    }

    fn plus(&self, other: &Self, most: i128) -> Self {
        Self::new(self.shape, self.data.iter().zip(&other.data).map(|(a, b)| saturated(a + b, most)))
    }

    fn numbers<F: TryFrom<i128, Error: core::fmt::Debug>>(&self) -> Vec<F> {
        self.data.iter().map(|&x| x.try_into().unwrap()).collect()
    }
}

/// `most`: the largest feature, 32,767 or 127.
fn saturated(x: i128, most: i128) -> i128 {
    x.clamp(-most - 1, most)
}

/// Nearest integer, halves up.
fn nearest(numerator: i128, denominator: i128) -> i128 {
    (2 * numerator + denominator).div_euclid(2 * denominator)
}

/// The sums of a convolution.
fn sums(x: &Wide, conv: Convolution<'_>) -> Wide {
    let [inputs, rows, cols] = x.shape;
    Wide::build([conv.channels.len(), rows, cols], |o, r, c| {
        let products = (0..inputs * 9).map(|i| {
            let tap = (i % 9) as isize;
            i128::from(conv.weights[o * inputs * 9 + i]) * x.at(i / 9, r + tap / 3 - 1, c + tap % 3 - 1)
        });
        let sum = i128::from(conv.channels[o].bias) + products.sum::<i128>();
        assert!(sum.abs() <= i128::from(MAX_SUM));
        sum
    })
}

/// Rescaled, not saturated.
fn convolved(x: &Wide, conv: Convolution<'_>) -> Wide {
    let mut sums = sums(x, conv);
    let pixels = sums.shape[1] * sums.shape[2];
    for (i, sum) in sums.data.iter_mut().enumerate() {
        *sum = nearest(*sum * i128::from(conv.channels[i / pixels].multiplier), 1 << 32);
    }
    sums
}

fn stored(x: Wide, most: i128) -> Wide {
    Wide { data: x.data.iter().map(|&x| saturated(x, most)).collect(), ..x }
}

fn relu(x: Wide) -> Wide {
    Wide { data: x.data.iter().map(|&x| x.max(0)).collect(), ..x }
}

/// Random weights of a network of a shape.
pub(in crate::nn) struct Net {
    shape: blob::Rcan,
    filters: u8,
    scales: blob::Integers,
    weights: Vec<u16>,
    channels: Vec<Channel>,
    attention: Vec<f16>,
}

impl Net {
    /// `gain`: about how much a layer multiplies its input by.
    fn new(shape: blob::Rcan, filters: u8, gain: f32, seed: u32) -> Self {
        Self::with(shape, filters, gain, seed, FeatureBits::Sixteen)
    }

    fn with(shape: blob::Rcan, filters: u8, gain: f32, seed: u32, features: FeatureBits) -> Self {
        let mut noise = Noise(seed);
        let (weights, outputs) = counts(&shape, filters);
        let fan = (9.0 * f32::from(shape.width)).sqrt() * 73.0;
        let mut channel = || Channel {
            bias: (noise.next() * 3.0e5) as i32,
            multiplier: (4_294_967_296.0 / fan * gain * (1.0 + 0.5 * noise.next())) as i32,
        };
        let mut channels: Vec<Channel> = (0..outputs).map(|_| channel()).collect();
        let byte = |noise: &mut Noise| (noise.next() * 128.0).floor() as i8;
        let weights: Vec<u16> = (0..weights.div_ceil(2))
            .map(|_| u16::from_le_bytes([byte(&mut noise), byte(&mut noise)].map(|b| b as u8)))
            .collect();
        let attention = noise.halves(attention_count(&shape, filters) as usize, 0.4);
        let mut scales = blob::Integers { input_log2: 12, feature_log2: 11, output: 1.0e-6, features };
        if features == FeatureBits::Eight {
            scales = blob::Integers { feature_log2: 4, output: 1.0e-4, ..scales };
            // The input of the first layer has 16 bits.
            channels.iter_mut().for_each(|channel| channel.bias >>= 7);
            channels[..shape.width.into()].iter_mut().for_each(|channel| channel.multiplier >>= 7);
        }
        Self { shape, filters, scales, weights, channels, attention }
    }

    fn convolutions(&self) -> Convolutions<'_> {
        Convolutions { weights: &self.weights, channels: &self.channels }
    }

    fn plan(&self, object: blob::Size) -> Rcan {
        Rcan::new(self.shape, Some(self.scales), self.filters, object).unwrap()
    }

    /// The largest feature.
    fn most(&self) -> i128 {
        match self.scales.features {
            FeatureBits::Sixteen => i16::MAX.into(),
            FeatureBits::Eight => i8::MAX.into(),
        }
    }

    /// The network by its definition, with these scales of the attentions; and the features t of each block.
    fn expected(&self, input: &[f16], rows: usize, cols: usize, scales: &[f32]) -> (Vec<f16>, Vec<Wide>) {
        let (mut weights, mut channels) = (self.convolutions().bytes(), self.channels.as_slice());
        let (width, most) = (usize::from(self.shape.width), self.most());
        let mut next = |inputs: usize, outputs: usize| {
            let (taken, rest) = weights.split_at(inputs * outputs * 9);
            let (own, others) = channels.split_at(outputs);
            (weights, channels) = (rest, others);
            Convolution { weights: taken, channels: own }
        };
        let shape = [usize::from(self.filters), 2 * rows, 2 * cols];
        let integers = Wide::new(
            shape,
            input.iter().map(|x| {
                let exact = (x.to_f64() * f64::from(1 << 24)) as i128;
                saturated(nearest(exact << self.scales.input_log2, 1 << 24), 32767)
            }),
        );
        let unshuffled = Wide::build([4 * shape[0], rows, cols], |k, r, c| {
            integers.at(k / 4, 2 * r + (k as isize / 2) % 2, 2 * c + k as isize % 2)
        });
        let head = stored(convolved(&unshuffled, next(4 * shape[0], width)), most);
        let (mut y, mut blocks, mut scales) = (head.clone(), Vec::new(), scales.iter());
        for _ in 0..self.shape.groups {
            let mut g = y.clone();
            for _ in 0..self.shape.blocks {
                let inner = stored(relu(convolved(&g, next(width, width))), most);
                let t = stored(convolved(&inner, next(width, width)), most);
                let k: Vec<i128> = (0..width)
                    .map(|_| ((f64::from(*scales.next().unwrap()) * 32768.0 + 0.5).floor() as i128).min(32767))
                    .collect();
                g = g.plus(&Wide::build(t.shape, |o, r, c| nearest(t.at(o, r, c) * k[o], 1 << 15)), most);
                blocks.push(t);
            }
            y = y.plus(&convolved(&g, next(width, width)), most);
        }
        y = head.plus(&convolved(&y, next(width, width)), most);
        let up = stored(convolved(&y, next(width, 4 * width)), most);
        let fine = Wide::build([width, 2 * rows, 2 * cols], |k, r, c| {
            up.at(4 * k + 2 * (r as usize % 2) + c as usize % 2, r / 2, c / 2)
        });
        let last = sums(&fine, next(width, 1));
        let output = last.data.iter().map(|&sum| narrow(sigmoid(sum as i32 as f32 * self.scales.output))).collect();
        (output, blocks)
    }

    fn run(&self, plan: &Rcan, simd: Simd, band: usize, scales: Scales<'_>, input: &[f16], region: Region) -> Vec<f16> {
        let held = matches!(scales, Scales::Held(_));
        let [rows, cols] = plan.input(region, held).ranges();
        let (object_rows, object_cols) = (plan.input(Region::whole(4096, 4096), false).ranges()).into();
        let row = |k: usize, r: usize| &input[(k * object_rows.end + r) * object_cols.end..][cols.clone()];
        let input: Vec<f16> =
            (0..usize::from(self.filters)).flat_map(|k| rows.clone().flat_map(move |r| row(k, r))).copied().collect();
        let mut arena = vec![f16::NAN; plan.arena_len()];
        let start = arena.len() - input.len();
        arena[start..].copy_from_slice(&input);
        let mut output = vec![f16::NAN; region.pixels()];
        let len = plan.scratch_len(band);
        let mut scratch = vec![f32::NAN; len + 4];
        let plane = PlaneMut::new(&mut output, region.rows.into(), region.cols.into()).unwrap();
        let parameters = Parameters { weights: &self.attention, convolutions: Some(self.convolutions()), scales };
        plan.process(simd, parameters, &mut arena, region, plane, &mut scratch[..len]).unwrap();
        assert!(scratch[len..].iter().all(|x| x.is_nan()), "wrote behind the scratch");
        output
    }
}

/// Shapes whose channels fill no group, whose rows begin at odd places, and whose features saturate.
const CASES: [(blob::Rcan, u8, [u16; 2], f32); 4] = [
    (blob::Rcan { width: 8, groups: 2, blocks: 2, reduction: 4 }, 3, [14, 20], 1.0),
    (blob::Rcan { width: 5, groups: 1, blocks: 1, reduction: 5 }, 1, [10, 38], 1.0),
    (blob::Rcan { width: 1, groups: 1, blocks: 1, reduction: 1 }, 2, [2, 2], 1.0),
    (blob::Rcan { width: 6, groups: 2, blocks: 1, reduction: 2 }, 2, [16, 34], 30.0),
];

#[test]
fn networks_agree_with_the_definition_whatever_band_and_region() {
    let kinds = [FeatureBits::Sixteen, FeatureBits::Eight];
    let cases = kinds.into_iter().flat_map(|kind| CASES.into_iter().enumerate().map(move |case| (kind, case)));
    for (kind, (i, (shape, filters, [rows, cols], gain))) in cases {
        let net = Net::with(shape, filters, gain, 40 + i as u32, kind);
        net.convolutions().check(&shape, filters).unwrap();
        let plan = net.plan(blob::Size { rows, cols });
        let input = Noise(50).halves(usize::from(filters) * usize::from(rows) * usize::from(cols), 1.0);
        let mut noise = Noise(60);
        let scales: Vec<f32> = (0..plan.scales_len()).map(|_| 0.5 + 0.5 * noise.next()).collect();
        let (half_rows, half_cols) = (usize::from(rows) / 2, usize::from(cols) / 2);
        let (expected, blocks) = net.expected(&input, half_rows, half_cols, &scales);
        let whole = Region::whole(rows, cols);
        for band in [1, 2, 3, 100] {
            let found = net.run(&plan, Simd::PORTABLE, band, Scales::Held(&scales), &input, whole);
            assert_eq!(found, expected, "{shape:?}, bands of {band}");
            assert_eq!(net.run(&plan, Simd::detect(), band, Scales::Held(&scales), &input, whole), expected);
        }
        let saturated = blocks.iter().flat_map(|t| &t.data).any(|&x| x == net.most());
        assert_eq!(saturated, gain > 1.0, "{shape:?} {kind:?}");
        let distinct = expected.iter().any(|x| x.to_bits().abs_diff(expected[0].to_bits()) > 8);
        assert!(distinct || expected.len() < 9, "a network that gives one value would pass: {shape:?} {kind:?}");
        let part = Region { row: rows / 3, col: cols / 4, rows: 1 + rows / 3, cols: 1 + cols / 3 };
        let [part_rows, part_cols] = part.ranges();
        let cut: Vec<f16> =
            part_rows.flat_map(|r| &expected[r * usize::from(cols)..][part_cols.clone()]).copied().collect();
        assert_eq!(net.run(&plan, Simd::detect(), 2, Scales::Held(&scales), &input, part), cut, "{part}");
    }
}

#[test]
fn attention_is_that_of_the_means() {
    let (shape, filters, [rows, cols], gain) = CASES[0];
    let net = Net::new(shape, filters, gain, 7);
    let plan = net.plan(blob::Size { rows, cols });
    let input = Noise(51).halves(3 * 280, 1.0);
    let whole = Region::whole(rows, cols);
    let mut scales = vec![f32::NAN; plan.scales_len()];
    let measured = net.run(&plan, Simd::detect(), 2, Scales::Measured(Some(&mut scales)), &input, whole);
    assert_eq!(net.run(&plan, Simd::detect(), 1, Scales::Held(&scales), &input, whole), measured);
    let (expected, blocks) = net.expected(&input, 7, 10, &scales);
    assert_eq!(measured, expected);
    let (width, hidden) = (usize::from(shape.width), hidden(&shape));
    let attention = wide(&net.attention);
    let mut weights = naive::Cursor(&attention);
    for (t, found) in blocks.iter().zip(scales.chunks(width)) {
        let t = t.data.iter().map(|&x| x as f64 / f64::from(1 << net.scales.feature_log2)).collect();
        let squeeze = [weights.take(width * hidden), weights.take(hidden)];
        let excite = [weights.take(width * hidden), weights.take(width)];
        let expected = naive::attention(&naive::Tensor::new([width, 7, 10], t), squeeze, excite);
        // The error of the logistic function.
        assert!(found.iter().zip(&expected).all(|(f, e)| (f64::from(*f) - e).abs() < 2.0e-4), "{found:?} {expected:?}");
    }
    let spread = scales.iter().fold((1.0_f32, 0.0_f32), |(low, high), &s| (low.min(s), high.max(s)));
    assert!(spread.1 - spread.0 > 0.05, "an attention that does nothing would pass");
}

proptest! {
    #[test]
    fn a_convolution_agrees_with_its_definition(
        inputs in 1_usize..20, outputs in 1_usize..7, rows in 1_usize..7, cols in 1_usize..40, band in 1_usize..9,
        relu_last: bool, accumulate: bool, seed: u32,
    ) {
        let mut noise = Noise(seed);
        let weights: Vec<i8> = (0..inputs * outputs * 9).map(|_| (noise.next() * 128.0).floor() as i8).collect();
        let channels: Vec<Channel> = (0..outputs)
            .map(|_| Channel { bias: (noise.next() * 1.0e8) as i32, multiplier: ((noise.next() + 1.0) * 3.0e5) as i32 })
            .collect();
        let conv = Conv3x3 {
            inputs, outputs, rows, cols,
            activation: if relu_last { Activation::Relu } else { Activation::Linear },
            store: if accumulate { Store::Accumulate } else { Store::Replace },
        };
        let own = Convolution { weights: &weights, channels: &channels };
        check_convolution::<i16>(&conv, own, band, &mut noise, 32768.0)?;
        check_convolution::<i8>(&conv, own, band, &mut noise, 128.0)?;
    }
}

/// Compares a convolution of random features with its definition.
fn check_convolution<F: Feature + TryFrom<i128, Error: core::fmt::Debug> + core::fmt::Debug + PartialEq>(
    conv: &Conv3x3,
    own: Convolution<'_>,
    band: usize,
    noise: &mut Noise,
    range: f32,
) -> Result<(), TestCaseError> {
    let Conv3x3 { inputs, outputs, rows, cols, .. } = *conv;
    let mut number = || F::saturate((noise.next() * range).floor() as i32);
    let input: Vec<F> = (0..inputs * rows * cols).map(|_| number()).collect();
    let old: Vec<F> = (0..outputs * rows * cols).map(|_| number()).collect();
    let wide = |shape, data: &[F]| Wide::new(shape, data.iter().map(|&x| i128::from(x.into())));
    let (x, before) = (wide([inputs, rows, cols], &input), wide([outputs, rows, cols], &old));
    let most = i128::from(F::saturate(i32::MAX).into());
    let mut expected = convolved(&x, own);
    if conv.activation == Activation::Relu {
        expected = relu(expected);
    }
    let expected = if conv.store == Store::Accumulate { before.plus(&expected, most) } else { stored(expected, most) };
    for simd in [Simd::PORTABLE, Simd::detect()] {
        let mut output = old.clone();
        let tensors = Tensors::Apart {
            input: Chw::new(&input, inputs, rows, cols).unwrap(),
            output: ChwMut::new(&mut output, outputs, rows, cols).unwrap(),
        };
        let mut scratch = vec![f32::NAN; scratch_len(conv, band)];
        process(conv, simd, own, 1.0, tensors, &mut scratch).unwrap();
        prop_assert_eq!(output, expected.numbers::<F>());
    }
    Ok(())
}

#[test]
fn the_bound_is_that_of_the_worst_frame() {
    let shape = blob::Rcan { width: 1, groups: 1, blocks: 1, reduction: 1 };
    let mut net = Net::new(shape, 1, 1.0, 3);
    net.convolutions().check(&shape, 1).unwrap();
    let taps = &net.convolutions().bytes()[36..45];
    let sum: i64 = taps.iter().map(|&w| i64::from(w).abs()).sum();
    // The worst frame: every feature is -2^15, or the largest, by the sign of its weight.
    net.channels[1].bias = (MAX_SUM - 32768 * sum) as i32;
    net.convolutions().check(&shape, 1).unwrap();
    net.channels[1].bias += 1;
    let error = BlobError::Channel { section: Section::Channels, index: 1 };
    assert_eq!(net.convolutions().check(&shape, 1), Err(error));
    net.channels[1].bias = i32::MIN;
    assert_eq!(net.convolutions().check(&shape, 1), Err(error));
    net.channels[1] = Channel { bias: 0, multiplier: -1 };
    assert_eq!(net.convolutions().check(&shape, 1), Err(error));
}

#[test]
fn misfits_are_refused() {
    let conv =
        Conv3x3 { inputs: 2, outputs: 1, rows: 2, cols: 2, activation: Activation::Sigmoid, store: Store::Replace };
    let (weights, channels) = ([0; 18], [Channel::default()]);
    let mut scratch = vec![0.0; scratch_len(&conv, 1)];
    let attempt = |conv: Conv3x3, weights: &[i8], scratch: &mut [f32]| {
        let mut output = [7_i16; 4];
        let tensors = Tensors::Apart {
            input: Chw::new(&[0_i16; 8], 2, 2, 2).unwrap(),
            output: ChwMut::new(&mut output, 1, 2, 2).unwrap(),
        };
        let own = Convolution { weights, channels: &channels };
        process(&conv, Simd::PORTABLE, own, 1.0, tensors, scratch).unwrap_err()
    };
    assert_eq!(attempt(conv, &weights, &mut scratch), NnError::Activation);
    let conv = Conv3x3 { activation: Activation::Linear, ..conv };
    assert_eq!(attempt(conv, &weights[1..], &mut scratch), NnError::Weights { expected: 18, found: 17 });
    let len = scratch.len();
    assert_eq!(attempt(conv, &weights, &mut scratch[1..]), NnError::Scratch { expected: len, found: len - 1 });
    assert_eq!(
        attempt(Conv3x3 { rows: 1, ..conv }, &weights, &mut scratch),
        NnError::Shape { expected: [2, 1, 2], found: [2, 2, 2] }
    );
}
