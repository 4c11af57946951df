//! Against the definition; and that neither bands nor what lay in the scratch change a bit.

extern crate std;

use std::vec;
use std::vec::Vec;

use super::*;
use crate::naive::{self, Noise, Tensor, wide};
use proptest::prelude::*;

/// One rounding to half of a sum whose own error is far smaller: half an ulp of a half, 2^-11, and a little.
const TOLERANCE: f64 = 5.0e-4;

struct Case {
    conv: Conv3x3,
    weights: Vec<f16>,
    bias: Vec<f16>,
    input: Vec<f16>,
    old: Vec<f16>,
}

impl Case {
    fn new(inputs: usize, outputs: usize, rows: usize, cols: usize, seed: u32) -> Self {
        let mut noise = Noise(seed);
        Self {
            conv: Conv3x3 { inputs, outputs, rows, cols, activation: Activation::Linear, store: Store::Replace },
            weights: noise.halves(inputs * outputs * 9, 0.5),
            bias: noise.halves(outputs, 1.0),
            input: noise.halves(inputs * rows * cols, 2.0),
            old: noise.halves(outputs * rows * cols, 3.0),
        }
    }

    fn parameters(&self) -> Parameters<'_> {
        Parameters { weights: &self.weights, bias: &self.bias }
    }

    /// Runs on scratch for bands of `band` rows, full of NaN, with a guard behind it.
    fn run(&self, simd: Simd, band: usize, unshuffled: bool) -> Vec<f16> {
        let Conv3x3 { inputs, outputs, rows, cols, .. } = self.conv;
        let mut output = self.old.clone();
        let len = self.conv.scratch_len(band);
        let mut scratch = vec![f32::NAN; len + 8];
        scratch[len..].fill(7.0);
        let output_tensor = ChwMut::new(&mut output, outputs, rows, cols).unwrap();
        let tensors = if unshuffled {
            let input = Chw::new(&self.input, inputs / 4, 2 * rows, 2 * cols).unwrap();
            Tensors::Unshuffled { input, output: output_tensor }
        } else {
            Tensors::Apart { input: Chw::new(&self.input, inputs, rows, cols).unwrap(), output: output_tensor }
        };
        self.conv.process(simd, self.parameters(), tensors, &mut scratch[..len]).unwrap();
        assert!(scratch[len..].iter().all(|&x| x == 7.0), "wrote behind the scratch");
        output
    }

    fn expected(&self, input: &Tensor) -> Tensor {
        naive::conv3x3(input, &wide(&self.weights), &wide(&self.bias))
    }

    fn direct(&self) -> Tensor {
        Tensor::new([self.conv.inputs, self.conv.rows, self.conv.cols], wide(&self.input))
    }
}

#[test]
fn a_centre_tap_of_one_is_the_identity() {
    let mut case = Case::new(3, 3, 5, 7, 1);
    case.bias.fill(f16::ZERO);
    case.weights.fill(f16::ZERO);
    for k in 0..3 {
        case.weights[(k * 3 + k) * 9 + 4] = f16::ONE;
    }
    assert_eq!(case.run(Simd::PORTABLE, 2, false), case.input);
}

#[test]
fn a_side_tap_shifts_and_pads_with_zeros() {
    let mut case = Case::new(1, 1, 2, 3, 1);
    case.bias.fill(f16::ZERO);
    case.weights.fill(f16::ZERO);
    case.weights[5] = f16::ONE; // ky = 1, kx = 2: the right-hand neighbour
    let x = case.input.clone();
    let expected = [x[1], x[2], f16::ZERO, x[4], x[5], f16::ZERO];
    assert_eq!(case.run(Simd::PORTABLE, 1, false), expected);
}

#[test]
fn shapes_agree_with_the_definition() {
    for (inputs, outputs, rows, cols) in
        [(1, 1, 1, 1), (3, 5, 4, 6), (4, 4, 9, 16), (8, 1, 6, 33), (16, 16, 12, 48), (2, 9, 3, 17)]
    {
        let case = Case::new(inputs, outputs, rows, cols, 9);
        let found = case.run(Simd::detect(), 3, false);
        let error = naive::error(&found, &case.expected(&case.direct()).data);
        assert!(error < TOLERANCE, "{inputs} -> {outputs}, {rows} x {cols}: {error:e}");
    }
}

#[test]
fn relu_and_accumulate_come_in_this_order() {
    let mut case = Case::new(4, 6, 5, 9, 3);
    case.conv.activation = Activation::Relu;
    case.conv.store = Store::Accumulate;
    let old = Tensor::new([6, 5, 9], wide(&case.old));
    let expected = case.expected(&case.direct()).map(naive::relu).plus(&old);
    assert!(naive::error(&case.run(Simd::detect(), 1, false), &expected.data) < TOLERANCE);
}

#[test]
fn unshuffled_input_is_read_through_the_shuffle() {
    let case = Case::new(8, 4, 5, 6, 4);
    let expected = case.expected(&naive::unshuffle(&Tensor::new([2, 10, 12], wide(&case.input))));
    assert!(naive::error(&case.run(Simd::detect(), 2, true), &expected.data) < TOLERANCE);
}

proptest! {
    #[test]
    fn bands_vectors_and_place_do_not_change_a_bit(
        channels in 1_usize..10, rows in 1_usize..12, cols in 1_usize..40, band in 1_usize..14, seed: u32,
    ) {
        let case = Case::new(channels, channels, rows, cols, seed);
        let reference = case.run(Simd::PORTABLE, 1, false);
        prop_assert_eq!(&case.run(Simd::PORTABLE, band, false), &reference);
        prop_assert_eq!(&case.run(Simd::detect(), band, false), &reference);
        let mut in_place = case.input.clone();
        let mut scratch = vec![f32::NAN; case.conv.scratch_len(band)];
        let tensor = ChwMut::new(&mut in_place, channels, rows, cols).unwrap();
        case.conv.process(Simd::detect(), case.parameters(), Tensors::InPlace(tensor), &mut scratch).unwrap();
        prop_assert_eq!(&in_place, &reference);
    }
}

#[test]
fn misfits_are_refused_and_nothing_is_written() {
    let case = Case::new(2, 3, 4, 4, 5);
    let mut output = case.old.clone();
    let mut scratch = vec![0.0; case.conv.scratch_len(1)];
    let input = Chw::new(&case.input, 2, 4, 4).unwrap();
    let mut attempt = |parameters: Parameters<'_>, input, scratch: &mut [f32]| {
        let tensors = Tensors::Apart { input, output: ChwMut::new(&mut output, 3, 4, 4).unwrap() };
        case.conv.process(Simd::PORTABLE, parameters, tensors, scratch).unwrap_err()
    };
    let short = Parameters { weights: &case.weights[1..], bias: &case.bias };
    assert_eq!(attempt(short, input, &mut scratch), NnError::Weights { expected: 54, found: 53 });
    let turned = Chw::new(&case.input, 4, 2, 4).unwrap();
    let error = NnError::Shape { expected: [2, 4, 4], found: [4, 2, 4] };
    assert_eq!(attempt(case.parameters(), turned, &mut scratch), error);
    let len = scratch.len();
    let error = NnError::Scratch { expected: len, found: len - 1 };
    assert_eq!(attempt(case.parameters(), input, &mut scratch[1..]), error);
    assert_eq!(output, case.old);
}
