//! Networks of several passes against f64; their regions, memory and refusals.

extern crate std;

use std::string::ToString;
use std::vec;
use std::vec::Vec;

use super::tests::{Case, run_with};
use super::*;
use crate::blob::{Bank, Corner, FeatureBits, Header, Integers, Passes};
use crate::image::Region;
use crate::naive::{self, Noise, Tensor, wide};
use crate::nn::rcan::weights_len;
use crate::num::f16;

/// Roundings of the prediction, of its filters and of two networks together, twice over.
const TOLERANCE: f64 = 3.0e-3;
const LENSES: [Corner; 4] =
    [Corner { row: 0, col: 1 }, Corner { row: 1, col: 17 }, Corner { row: 13, col: -1 }, Corner { row: 14, col: 18 }];

/// The small network with so many passes.
fn case(passes: u8) -> Case {
    let mut case = Case::new();
    let mut noise = Noise(77);
    let (object, rcan) = (case.header.object, case.header.rcan);
    let passes = Passes { later: passes - 1, terms: 2, window: 5, node_step: 4, corners: LENSES.into_iter().collect() };
    let nodes = passes.nodes(object);
    for term in 0..LENSES.len() * 2 {
        // A positive first term, and a second one that varies over the field.
        let first = term % 2 == 0;
        let node = |_| if first { 0.75 + 0.25 * noise.next() } else { noise.next() };
        case.predictor.extend((0..nodes[0] * nodes[1]).map(node).map(f16::from_f32));
        let lag = |_| if first { 0.5 + 0.5 * noise.next() } else { 0.3 * noise.next() };
        case.predictor.extend((0..25).map(lag).map(|lag| f16::from_f32(lag * 32.0 / 32.0)));
    }
    for _ in 0..passes.later {
        case.rcan.extend(noise.halves(weights_len(&rcan, 3), 0.2));
    }
    case.header.passes = Some(passes);
    case.header.memory = Pipeline::plan(&case.header).unwrap();
    case
}

/// The reconstruction in f64.
fn expected(case: &Case) -> Vec<f64> {
    let passes = case.header.passes.as_ref().unwrap();
    let (frame, object) = (case.header.frame, case.header.object);
    let most = |x: &[f64]| x.iter().fold(0.0_f64, |most, x| most.max(*x));
    let x = case.corrected();
    let frame_max = most(&x);
    let seen = case.filtered(&x.iter().map(|x| x / frame_max).collect::<Vec<_>>());
    let filter_max = most(&seen);
    let seen: Vec<f64> = seen.iter().map(|f| f / filter_max).collect();
    let logits = |input: &[f64], channels: usize, weights: &[f64]| -> Vec<f64> {
        let out = naive::rcan(&Tensor::new([channels, 14, 12], input.to_vec()), [2, 2, 8, 2], weights);
        out.data.iter().map(|x| (x / (1.0 - x)).ln()).collect()
    };
    let weights = wide(&case.rcan);
    let (first, mut rest) = weights.split_at(weights_len(&case.header.rcan, 2));
    let mut sum = logits(&seen, 2, first);
    for _ in 0..passes.later {
        let (next, later) = rest.split_at(weights_len(&case.header.rcan, 3));
        rest = later;
        let x: Vec<f64> = sum.iter().map(|l| naive::sigmoid(*l)).collect();
        let shape = (passes.nodes(object), passes.tile(object).unwrap());
        let predicted = naive::predict(passes, shape, [frame, object], &wide(&case.predictor), &x);
        let largest = predicted.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
        let predicted = case.filtered(&predicted.iter().map(|x| x / largest).collect::<Vec<_>>());
        let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let scale = product(&seen, &predicted) / product(&predicted, &predicted);
        let mut input: Vec<f64> = seen.iter().zip(&predicted).map(|(f, p)| 4.0 * (f - scale * p)).collect();
        assert!(input.iter().any(|d| d.abs() > 0.1), "a prediction that is perfect would hide a lot");
        input.extend(x);
        sum = sum.iter().zip(logits(&input, 3, next)).map(|(l, change)| l + change).collect();
    }
    sum.into_iter().map(naive::sigmoid).collect()
}

#[test]
fn passes_agree_with_f64() {
    let one = Case::new().run(0, 0).0;
    for passes in [2, 3, 8] {
        let case = case(passes);
        let (output, stats) = case.run(0, 0);
        let error = naive::error(&output, &expected(&case));
        assert!(error < TOLERANCE * f64::from(passes) / 2.0, "{passes}: {error:e}");
        assert!(naive::error(&output, &wide(&one)) > 0.05, "the passes change something");
        assert!(stats.filter_finite && case.pipeline().passes() == usize::from(passes));
    }
}

#[test]
fn more_memory_does_not_change_a_bit() {
    for passes in [2, 4] {
        let case = case(passes);
        let reference = case.run(0, 0);
        let best = case.pipeline().fast_len_best();
        for (more_fast, more_bulk) in [(1, 1), (100, 0), (best, 5000)] {
            assert_eq!(case.run(more_fast, more_bulk), reference, "{more_fast} {more_bulk}");
        }
    }
}

#[test]
fn a_region_is_cut_from_the_whole() {
    for passes in [2, 3] {
        let case = case(passes);
        let (all, stats) = case.run(0, 0);
        for [row, col, rows, cols] in [[0, 0, 14, 12], [0, 0, 1, 1], [13, 11, 1, 1], [3, 5, 6, 4], [0, 7, 14, 3]] {
            let region = Region { row, col, rows, cols };
            let (part, seen) = run_with(&case, &case.frame, region, Field::Measured(None)).unwrap();
            let [rows, cols] = region.ranges();
            let cut: Vec<f16> = rows.flat_map(|row| &all[row * 12..][cols.clone()]).copied().collect();
            assert_eq!((part, seen), (cut, stats), "{region}");
        }
    }
}

#[test]
fn what_a_pass_cannot_do_is_refused() {
    let case = case(2);
    let pipeline = case.pipeline();
    assert_eq!(pipeline.scales_len(), 0);
    let whole = pipeline.whole();
    let run = |field| run_with(&case, &case.frame, whole, field).map(|_| ());
    let (_, stats) = case.run(0, 0);
    assert_eq!(run(Field::Measured(Some(&mut []))), Err(PipelineError::Hold));
    assert_eq!(run(Field::Held(stats, &[])), Err(PipelineError::Hold));
    assert!(PipelineError::Hold.to_string().contains("hold of 0"));
    let (mut fast, mut bulk) = (vec![f32::NAN; pipeline.fast_len()], vec![f16::NAN; pipeline.bulk_len()]);
    let mut held = |hold| {
        let mut output = vec![f16::NAN; pipeline.output_len()];
        let memory = Memory { fast: &mut fast, bulk: &mut bulk };
        Holder::default().run(&pipeline, &case.frame, HeldRegion { region: whole, hold }, memory, &mut output)
    };
    assert_eq!(held(0), Ok((stats, 0)));
    assert_eq!(held(1), Err(PipelineError::Hold));
    let plan = |change: fn(&mut Header)| {
        let mut header = case.header.clone();
        change(&mut header);
        Pipeline::plan(&header).unwrap_err().to_string()
    };
    let no_transform = plan(|header| header.passes.as_mut().unwrap().window = 2001);
    assert!(no_transform.starts_with("passes"), "{no_transform}");
    const INTEGERS: Integers = Integers { input_log2: 9, feature_log2: 9, output: 1.0, features: FeatureBits::Sixteen };
    assert!(plan(|header| header.integers = Some(INTEGERS)).starts_with("passes"));
    let channels = plan(|header| {
        let taps = (0..63).map(|channel| crate::blob::Tap { channel, dy: 0, dx: 0 }).collect();
        header.bank = Bank { channels: 63, taps, ..header.bank.clone() };
    });
    assert!(channels.contains("62 channels"), "{channels}");
}

/// Frames without light, predictions without light, and filters that overflow: every number stays finite.
#[test]
fn darkness_and_overflow_give_finite_numbers() {
    let finite = |case: &Case| case.run(0, 0).0.iter().all(|x| x.is_finite());
    let mut dark = case(3);
    dark.frame.fill(10);
    assert!(finite(&dark));
    let mut blind = case(3);
    blind.predictor.fill(f16::ZERO);
    assert!(finite(&blind));
    let mut off = case(2);
    off.header.passes.as_mut().unwrap().corners.iter_mut().for_each(|corner| corner.row = i16::MIN);
    assert!(finite(&off));
    let mut large = case(3);
    large.rcan.iter_mut().for_each(|weight| *weight = f16::from_f32(weight.to_f32() * 3.0e4));
    assert!(finite(&large));
}
