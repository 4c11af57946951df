//! The network against its definition; regions; scales held from another frame.

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
    let parameters = Parameters { weights, convolutions: None, scales: Scales::Measured(None) };
    run_on(&Rcan::new(SHAPE, None, 3, OBJECT).unwrap(), simd, band, parameters, input, region)
}

/// `input` is what the plan takes for the region, or all of it, from which that is cut.
fn run_on(plan: &Rcan, simd: Simd, band: usize, parameters: Parameters<'_>, input: &[f16], region: Region) -> Vec<f16> {
    let part = plan.input(region, matches!(parameters.scales, Scales::Held(_)));
    let [rows, cols] = part.ranges();
    let row = |k: usize, r: usize| &input[(k * 2 * plan.rows + r) * 2 * plan.cols..][cols.clone()];
    let input: Vec<f16> = (0..plan.filters).flat_map(|k| rows.clone().flat_map(move |r| row(k, r))).copied().collect();
    let mut arena = vec![f16::NAN; plan.arena_len()];
    let start = arena.len() - input.len();
    arena[start..].copy_from_slice(&input);
    let mut output = vec![f16::NAN; region.pixels()];
    let mut scratch = vec![f32::NAN; plan.scratch_len(band)];
    let plane = PlaneMut::new(&mut output, region.rows.into(), region.cols.into()).unwrap();
    plan.process(simd, parameters, &mut arena, region, plane, &mut scratch).unwrap();
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

/// A network whose windows are smaller than the frame from the first convolution on.
fn shallow() -> (Rcan, [usize; 4], Vec<f16>, [Vec<f16>; 2]) {
    let shape = blob::Rcan { width: 6, groups: 2, blocks: 1, reduction: 3 };
    let mut noise = Noise(13);
    let weights = noise.halves(weights_len(&shape, 2), 0.2);
    // Scales follow from means, so the frames have different ones.
    let inputs = [6.0, 0.0].map(|mean| {
        let noise = noise.halves(2 * 60 * 64, 1.0);
        noise.iter().map(|x| f16::from_f32(x.to_f32() + mean)).collect()
    });
    (Rcan::new(shape, None, 2, blob::Size { rows: 60, cols: 64 }).unwrap(), [2, 1, 6, 2], weights, inputs)
}

const REGIONS: [[u16; 4]; 7] =
    [[0, 0, 60, 64], [30, 31, 1, 1], [22, 24, 16, 16], [0, 40, 9, 5], [59, 63, 1, 1], [41, 0, 19, 3], [23, 17, 7, 30]];

#[test]
fn scales_that_are_held_from_the_same_frame_change_no_bit() {
    let (plan, _, weights, [input, _]) = shallow();
    for [row, col, rows, cols] in REGIONS {
        let region = Region { row, col, rows, cols };
        let mut scales = vec![f32::NAN; plan.scales_len()];
        let measured =
            Parameters { weights: &weights, convolutions: None, scales: Scales::Measured(Some(&mut scales)) };
        let exact = run_on(&plan, Simd::detect(), 3, measured, &input, region);
        let held = Parameters { weights: &weights, convolutions: None, scales: Scales::Held(&scales) };
        assert_eq!(run_on(&plan, Simd::PORTABLE, 2, held, &input, region), exact, "{region}");
    }
}

#[test]
fn scales_that_are_held_from_another_frame_weigh_as_by_the_definition() {
    let (plan, shape, weights, [before, now]) = shallow();
    let mut scales = vec![f32::NAN; plan.scales_len()];
    let measured = Parameters { weights: &weights, convolutions: None, scales: Scales::Measured(Some(&mut scales)) };
    run_on(&plan, Simd::detect(), 3, measured, &before, Region { row: 5, col: 6, rows: 7, cols: 8 });
    let (mut written, wide_weights) = (Vec::new(), wide(&weights));
    let [before, input] = [&before, &now].map(|input| Tensor::new([2, 60, 64], wide(input)));
    naive::rcan_with(&before, shape, &wide_weights, &mut |own| {
        written.extend(own.iter().copied());
        own
    });
    assert!(scales.iter().zip(&written).all(|(scale, expected)| (f64::from(*scale) - expected).abs() < TOLERANCE));
    let mut blocks = written.chunks(6);
    let expected = naive::rcan_with(&input, shape, &wide_weights, &mut |_| blocks.next().unwrap().to_vec());
    let own = naive::rcan(&input, shape, &wide_weights);
    let apart = expected.data.iter().zip(&own.data).fold(0.0, |max: f64, (a, b)| max.max((a - b).abs()));
    assert!(apart > 2.0 * TOLERANCE, "scales that do nothing would pass: {apart:e}");
    for [row, col, rows, cols] in REGIONS {
        let region = Region { row, col, rows, cols };
        let held = Parameters { weights: &weights, convolutions: None, scales: Scales::Held(&scales) };
        let found = run_on(&plan, Simd::detect(), 1, held, &now, region);
        let [rows, cols] = region.ranges();
        let cut: Vec<f64> = rows.flat_map(|r| &expected.data[r * 64..][cols.clone()]).copied().collect();
        assert!(naive::error(&found, &cut) < TOLERANCE, "{region}: {:e}", naive::error(&found, &cut));
    }
}

#[test]
fn another_number_of_scales_is_refused() {
    let (plan, _, weights, [input, _]) = shallow();
    let region = Region::whole(60, 64);
    let (mut arena, mut scratch) = (vec![f16::ZERO; plan.arena_len()], vec![0.0; plan.scratch_len(1)]);
    let mut output = vec![f16::ZERO; region.pixels()];
    arena[..input.len()].copy_from_slice(&input);
    let mut attempt = |scales: Scales<'_>| {
        let plane = PlaneMut::new(&mut output, 60, 64).unwrap();
        plan.process(
            Simd::detect(),
            Parameters { weights: &weights, convolutions: None, scales },
            &mut arena,
            region,
            plane,
            &mut scratch,
        )
    };
    assert_eq!(attempt(Scales::Held(&[0.5; 11])), Err(NnError::Weights { expected: 12, found: 11 }));
    assert_eq!(attempt(Scales::Measured(Some(&mut [0.5; 13]))), Err(NnError::Weights { expected: 12, found: 13 }));
}
