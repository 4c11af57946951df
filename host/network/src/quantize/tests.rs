#![allow(clippy::unwrap_used)]
use super::*;
use crate::methods::{FloatNetwork, Reconstruct};
use crate::network_file::NetworkFile;
use crate::train::network::values;
use crate::train::ops::fourier::Fourier;
use crate::train::weights::{self, FILTERS};
use crate::train::{
    Body, Checkpoint, FeatureSteps, FilterMask, Lenses, Mode, Network, NetworkConfig, NetworkInput, Preset, normalised,
};
use ndarray::Array2;
use ommatidia_model::metrics::Case;
use ommatidia_physics::noise::NoiseModel;
use ommatidia_physics::sensor::SensorMaps;
use ommatidia_session::artifact::Tensors;
use ommatidia_session::rng;
use rand::RngExt;
use std::path::Path;

const FRAME: [usize; 2] = [44, 40];
const OBJECT: [usize; 2] = [16, 20];

/// Whole codes of a few smooth spots.
fn frame(seed: u64) -> Array2<f32> {
    let mut rng = rng::stream(seed, "frame", 0);
    let spots: Vec<[f32; 3]> = (0..12)
        .map(|_| [rng.random::<f32>() * 44.0, rng.random::<f32>() * 40.0, 200.0 + 2000.0 * rng.random::<f32>()])
        .collect();
    let light = |r: usize, c: usize| -> f32 {
        spots.iter().map(|[y, x, a]| a * (-0.2 * ((r as f32 - y).powi(2) + (c as f32 - x).powi(2))).exp()).sum()
    };
    Array2::from_shape_fn((FRAME[0], FRAME[1]), |(r, c)| (64.0 + light(r, c)).round())
}

fn file(made: &Quantized) -> NetworkFile {
    NetworkFile::from_bytes(Path::new("made"), &made.bytes).unwrap()
}

/// An untrained network with maps of the sensor.
fn checkpoint() -> Checkpoint {
    let network = NetworkConfig {
        channels: 3,
        width: 8,
        reduction: 4,
        groups: 2,
        blocks: 2,
        ..Preset::Nano.network(FRAME, OBJECT)
    };
    let weights = weights::random(&network, 5);
    let pattern =
        |a: f32, b: f32| Array2::from_shape_fn((FRAME[0], FRAME[1]), |(r, c)| a + b * ((r * 7 + c * 3) % 16) as f32);
    let maps = SensorMaps {
        offset_dn: Some(pattern(-2.0, 0.25)),
        inverse_response: Some(pattern(0.9375, 0.0078125)),
        unusable: None,
    };
    let truth = Array2::from_shape_fn((OBJECT[0], OBJECT[1]), |(r, c)| ((r + c) % 5) as f32);
    let cases = (0..2).map(|i| Case { frame_dn: frame(i), truth: truth.clone() }).collect();
    let untrained = Checkpoint::untrained(network, NoiseModel::nominal(), Preset::Nano.training(1e4, 1), weights);
    Checkpoint { maps, cases, ..untrained }
}

fn difference(a: &dyn Reconstruct, b: &dyn Reconstruct, frame: &Array2<f32>) -> f32 {
    let [a, b] = [a, b].map(|m| m.reconstruct(frame.view()).unwrap());
    (&a - &b).iter().fold(0.0, |max, d| max.max(d.abs()))
}

/// Float network and network file are independent definitions of the same network. An untrained network is the most
/// sensitive test: its outputs spread over (0, 1) and nothing is 0. Halves have 11 bits and there are 15 layers.
#[test]
fn the_file_computes_what_the_float_network_does() {
    let checkpoint = checkpoint();
    let made = quantize(
        &checkpoint,
        &"0123456789abcdef".repeat(4),
        &QuantizeConfig { name: "test".into(), ..Default::default() },
    )
    .unwrap();
    let (float, blob) = (FloatNetwork::new(&checkpoint).unwrap(), file(&made));
    let found = float.reconstruct(frame(9).view()).unwrap();
    let spread = found.iter().fold(0.0f32, |m, v| m.max(*v)) - found.iter().fold(1.0f32, |m, v| m.min(*v));
    assert!(spread > 0.1, "{spread}");
    assert!(difference(&float, &blob, &frame(9)) < 0.01);
    assert_eq!(blob.header().unwrap().checkpoint.as_str(), "0123456789abcdef");
    assert!(made.report.loss_db.abs() < 0.1, "{:?}", made.report);
    assert_eq!(made.report.energy_kept, 1.0);
}

/// A network of more than one pass, its later passes not yet silent, with the PSFs of an array.
fn checkpoint_of(passes: usize, terms: usize) -> Checkpoint {
    let lenses = Lenses::of(&ommatidia_model::testing::square_array(3, FRAME, OBJECT)).unwrap();
    let mut checkpoint = checkpoint();
    let network = lenses.with_feedback(checkpoint.body.network.clone(), [passes, 0], terms);
    let mut weights = weights::random(&network, 5);
    let later = weights.iter_mut().filter(|(name, _)| name.starts_with("pass"));
    later.for_each(|(_, t)| t.iter_mut().enumerate().for_each(|(i, v)| *v += ((i * 7) % 5) as f32 / 50.0 - 0.04));
    weights.extend(lenses.feedback(network.feedback.as_ref().unwrap()));
    (checkpoint.body.network, checkpoint.weights) = (network, weights);
    checkpoint
}

#[test]
fn passes_compute_what_the_float_network_does() {
    let one = FloatNetwork::new(&checkpoint()).unwrap().reconstruct(frame(9).view()).unwrap();
    for (passes, prune) in [(2, None), (3, None), (2, Some(0.9))] {
        let checkpoint = checkpoint_of(passes, 2);
        let made = quantize(&checkpoint, "", &QuantizeConfig { prune, ..QuantizeConfig::default() }).unwrap();
        let (float, blob) = (FloatNetwork::new(&checkpoint).unwrap(), file(&made));
        let found = float.reconstruct(frame(9).view()).unwrap();
        let changed = (&found - &one).iter().fold(0.0f32, |most, d| most.max(d.abs()));
        assert!(changed > 0.05, "the passes change something: {changed}");
        let error = difference(&float, &blob, &frame(9));
        println!("{passes} passes, {prune:?}: {error}");
        assert!(prune.is_some() || error < 0.01, "{passes}: {error}");
        // Pruning itself changes much; after it the file computes what the pruned float network does.
        let [before, file] = [2, 1].map(|back| made.report.steps[made.report.steps.len() - back].quality.psnr_db);
        assert!((before - file).abs() < 0.1, "{:?}", made.report);
        let header = blob.header().unwrap();
        let shape = header.passes.unwrap();
        assert_eq!((usize::from(shape.later) + 1, shape.corners.len()), (passes, 9));
        assert_eq!((made.report.passes, made.report.predictor_bytes > 0), (passes, true));
    }
}

#[test]
fn passes_that_devices_do_not_run_are_refused_in_words() {
    let mut checkpoint = checkpoint_of(2, 2);
    let refused = |checkpoint: &Checkpoint, numbers| {
        quantize(checkpoint, "", &QuantizeConfig { numbers, ..QuantizeConfig::default() }).unwrap_err().to_string()
    };
    assert!(refused(&checkpoint, Numbers::Integers).contains("leave --weights"));
    assert!(refused(&checkpoint, Numbers::Bytes).contains("found 2 passes"));
    checkpoint.body.network.feedback.as_mut().unwrap().iterations = 4;
    assert!(refused(&checkpoint, Numbers::Halves).contains("--richardson-lucy 0"));
}

/// Weights of 8 bits have a step of 1/127 of the largest of their channel; features of 16 bits are finer than halves.
#[test]
fn integers_compute_about_what_the_float_network_does() {
    let checkpoint = checkpoint();
    let config = QuantizeConfig { numbers: Numbers::Integers, ..Default::default() };
    let made = quantize(&checkpoint, "", &config).unwrap();
    let halves = quantize(&checkpoint, "", &QuantizeConfig::default()).unwrap();
    let (float, integers) = (FloatNetwork::new(&checkpoint).unwrap(), file(&made));
    let error = difference(&float, &integers, &frame(9));
    assert!(error > difference(&float, &file(&halves), &frame(9)) && error < 0.1, "{error}");
    assert!(integers.header().unwrap().integers.is_some() && file(&halves).header().unwrap().integers.is_none());
    let steps: Vec<&str> = made.report.steps.iter().map(|step| step.step).collect();
    assert_eq!(steps, ["float", "halves", "file"]);
    let psnr = |step: usize| made.report.steps[step].quality.psnr_db;
    assert_eq!(made.report.loss_to_halves_db, Some(psnr(1) - psnr(2)));
    assert!(made.report.loss_db.abs() < 0.3, "{:?}", made.report);
    // Half the bytes for a weight; ten more for an output channel, and the attentions as before.
    assert!(made.report.rcan_bytes * 10 < halves.report.rcan_bytes * 7, "{:?}", made.report);
}

/// Features of 8 bits are coarser than those of 16 and take half the arena.
#[test]
fn features_of_8_bits_are_coarser_and_smaller() {
    let checkpoint = checkpoint();
    let [integers, bytes] = [Numbers::Integers, Numbers::Bytes]
        .map(|numbers| quantize(&checkpoint, "", &QuantizeConfig { numbers, ..Default::default() }).unwrap());
    let float = FloatNetwork::new(&checkpoint).unwrap();
    let [fine, coarse] = [&integers, &bytes].map(|made| difference(&float, &file(made), &frame(9)));
    // How much is lost depends on the network: that the integers are the right ones is tested bit for bit elsewhere.
    assert!(coarse > fine, "{fine} {coarse}");
    assert_eq!(bytes.report.rcan_bytes, integers.report.rcan_bytes);
    assert!(bytes.report.bulk_bytes <= integers.report.bulk_bytes);
}

/// Root of the mean square of the differences.
fn distance(a: &[f32], b: &[f32]) -> f32 {
    (a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f32>() / a.len() as f32).sqrt()
}

/// What a training with roundings computes is what the file made of it computes: the two are independent definitions
/// of the same roundings. Their inputs differ by the halves of the filters, so some features are rounded to the other
/// neighbour, and each layer adds to that: the network is shallow. Roundings to other steps are further away, and so is
/// the network without roundings.
#[test]
fn a_training_with_roundings_computes_what_the_file_does() {
    let deep = checkpoint();
    let network = NetworkConfig { groups: 1, blocks: 1, ..deep.body.network.clone() };
    let weights = weights::random(&network, 5);
    let mut checkpoint = Checkpoint { body: Body { network, ..deep.body }, weights, ..deep };
    // Weights so small in one channel, and so large in another, that one step for all would leave little of either.
    let head = checkpoint.weights.get_mut(&format!("{}.weight", weights::name::HEAD)).unwrap();
    head.index_axis_mut(ndarray::Axis(0), 1).mapv_inplace(|v| v / 64.0);
    head.index_axis_mut(ndarray::Axis(0), 2).mapv_inplace(|v| v * 4.0);
    let steps = ranges::feature_steps(&checkpoint).unwrap();
    checkpoint.body.feature_steps = Some(steps.clone());
    let made = quantize(&checkpoint, "", &QuantizeConfig { numbers: Numbers::Bytes, ..Default::default() }).unwrap();
    let found: Vec<f32> = file(&made).reconstruct(frame(9).view()).unwrap().iter().copied().collect();
    let network = &checkpoint.body.network;
    let plan = std::sync::Arc::new(Fourier::new(network.fourier()));
    let input = || {
        let x = normalised(&checkpoint.frame_input().unwrap(), frame(9).view()).unwrap();
        vec![NetworkInput::of(network, &plan, &x)]
    };
    let graph = |steps: Option<&FeatureSteps>| {
        let graph = Network::new(network, &plan, &checkpoint.weights, Mode::Infer).unwrap();
        let graph = match steps {
            Some(steps) => graph.rounded(steps).unwrap(),
            None => graph,
        };
        values(graph.forward(input()).logits).into_iter().map(|z| 1.0 / (1.0 + (-z).exp())).collect::<Vec<f32>>()
    };
    let mut others = steps.clone();
    let all = others.inner.iter_mut().chain([&mut others.sums, &mut others.fine]);
    all.flatten().for_each(|step| *step *= 1.07);
    let [rounded, other, plain] = [Some(&steps), Some(&others), None].map(|steps| distance(&graph(steps), &found));
    // With the steps of another channel or layer in the file it would not compute this network at all.
    assert!(plain > 1e-3 && plain < 0.04, "{plain}");
    assert!(rounded < 0.75 * plain && rounded < 0.75 * other, "{rounded} {plain} {other}");
}

/// A channel's step follows the channel: features that are a power of two larger have a step that is as much larger.
#[test]
fn each_channel_has_the_step_that_suits_it() {
    let mut checkpoint = checkpoint();
    let before = ranges::feature_steps(&checkpoint).unwrap();
    assert!(before.fits(&checkpoint.body.network));
    for part in ["weight", "bias"] {
        let upscale = checkpoint.weights.get_mut(&format!("{}.{part}", weights::name::UPSCALE)).unwrap();
        // The four channels behind which the shuffle puts channel 3.
        (12..16).for_each(|o| upscale.index_axis_mut(ndarray::Axis(0), o).mapv_inplace(|v| 8.0 * v));
    }
    let after = ranges::feature_steps(&checkpoint).unwrap();
    assert_eq!((&after.sums, &after.inner), (&before.sums, &before.inner));
    for (channel, (after, before)) in after.fine.iter().zip(&before.fine).enumerate() {
        assert_eq!(*after, if channel == 3 { 8.0 * before } else { *before }, "channel {channel}");
    }
}

#[test]
fn integers_need_frames() {
    let checkpoint = Checkpoint { cases: Vec::new(), ..checkpoint() };
    let config = QuantizeConfig { numbers: Numbers::Integers, ..Default::default() };
    assert!(matches!(quantize(&checkpoint, "", &config), Err(QuantizeError::NoFrames)));
}

/// Filters whose kernels are a few compact spots fit into taps without loss.
#[test]
fn taps_of_compact_kernels_are_the_whole_filter() {
    let mut checkpoint = checkpoint();
    let t = checkpoint.body.network.filter_size;
    compact(&mut checkpoint.weights, t);
    let config = QuantizeConfig { tile: Some(16), energy: Some(0.999_999_9), ..Default::default() };
    let made = quantize(&checkpoint, "", &config).unwrap();
    assert!(made.report.taps > 3 && made.report.taps < 40, "{}", made.report.taps);
    assert!(made.report.energy_kept >= 0.999_999_9);
    let (float, blob) = (FloatNetwork::new(&checkpoint).unwrap(), file(&made));
    assert!(difference(&float, &blob, &frame(9)) < 0.01);
}

/// A channel that is much weaker than the others still needs a tap.
#[test]
fn a_faint_channel_keeps_a_tap() {
    let mut checkpoint = checkpoint();
    for name in FILTERS {
        checkpoint.weights.get_mut(name).unwrap().index_axis_mut(ndarray::Axis(0), 1).mapv_inplace(|v| 1e-3 * v);
    }
    let config = QuantizeConfig { tile: Some(32), energy: Some(0.2), ..Default::default() };
    let made = quantize(&checkpoint, "", &config).unwrap();
    let header = file(&made).header().unwrap();
    assert!((0..3).all(|c| header.bank.taps.iter().any(|tap| tap.channel == c)));
}

/// Replaces each filter by three spots at lags of at most 12 pixels: sums of complex exponentials under a Gaussian.
fn compact(weights: &mut Tensors, t: usize) {
    let value = |c: usize, kr: usize, kc: usize| {
        let (mut re, mut im) = (0.0f32, 0.0f32);
        let k = |k: usize| if k > t / 2 { k as f32 - t as f32 } else { k as f32 } / t as f32;
        for spot in 0..3 {
            let (y, x) = ((c as f32 - 1.0) * 4.0 + spot as f32 * 6.0 - 7.0, 9.0 - 8.0 * spot as f32);
            let angle = -std::f32::consts::TAU * (k(kr) * y + k(kc) * x);
            let size = (-30.0 * (k(kr).powi(2) + k(kc).powi(2))).exp();
            (re, im) = (re + size * angle.cos(), im + size * angle.sin());
        }
        [re, im]
    };
    for (part, name) in FILTERS.into_iter().enumerate() {
        let filters = weights.get_mut(name).unwrap();
        filters.indexed_iter_mut().for_each(|(at, v)| *v = value(at[0], at[1], at[2])[part]);
    }
}

/// The device transforms the kernels that the pruned file holds to the spectra that the dense one holds.
#[test]
fn blocks_of_compact_kernels_are_the_whole_filter() {
    let mut checkpoint = checkpoint();
    let t = checkpoint.body.network.filter_size;
    compact(&mut checkpoint.weights, t);
    let config = QuantizeConfig { prune: Some(0.5), ..Default::default() };
    let made = quantize(&checkpoint, "", &config).unwrap();
    let report = &made.report;
    assert!(report.energy_kept >= 0.999_999, "{report:?}");
    assert!(report.filter_bytes <= report.dense_filter_bytes / 2, "{report:?}");
    assert!(report.filter_bytes + 34 > report.dense_filter_bytes / 2, "room for one block more: {report:?}");
    assert_eq!(report.steps.iter().map(|s| s.step).collect::<Vec<_>>(), ["float", "blocks", "file"]);
    let (float, blob) = (FloatNetwork::new(&checkpoint).unwrap(), file(&made));
    assert!(difference(&float, &blob, &frame(9)) < 0.01);
}

/// A file that would not fit is pruned to as many blocks as fit.
#[test]
fn what_does_not_fit_into_the_flash_is_pruned() {
    let checkpoint = checkpoint();
    let whole = quantize(&checkpoint, "", &QuantizeConfig::default()).unwrap().report;
    for less in [1, 100, 5000, whole.filter_bytes * 9 / 10] {
        let flash = (whole.file_bytes - less) as u64;
        let config = QuantizeConfig { flash_bytes: Some(flash), ..Default::default() };
        let made = quantize(&checkpoint, "", &config).unwrap();
        let found = made.bytes.len() as u64;
        assert!(found <= flash && found + 200 > flash, "{found} of {flash}");
        assert!(made.report.blocks > 0 && made.report.energy_kept < 1.0);
        file(&made);
    }
}

/// Filters that were trained with a mask of blocks keep these blocks, even if others are stronger.
#[test]
fn blocks_of_a_training_are_kept() {
    let mut checkpoint = checkpoint();
    let blocks = vec![(0, 3, 4), (1, 0, 0), (2, 15, 15)];
    checkpoint.body.filter_mask = Some(FilterMask::Blocks { side: 4, blocks });
    let plan = Fourier::new(checkpoint.body.network.fourier());
    checkpoint.body.filter_mask.as_ref().unwrap().project(&plan, &mut checkpoint.weights);
    let made = quantize(&checkpoint, "", &QuantizeConfig::default()).unwrap();
    assert_eq!((made.report.blocks, made.report.block_side), (3, 4));
    assert!(made.report.energy_kept > 0.999_999);
    let (float, blob) = (FloatNetwork::new(&checkpoint).unwrap(), file(&made));
    assert!(difference(&float, &blob, &frame(9)) < 0.02);
}

#[test]
fn the_error_of_a_small_device_names_how_much_is_missing() {
    let checkpoint = checkpoint();
    let error = |config| quantize(&checkpoint, "", &config).unwrap_err();
    let flash = error(QuantizeConfig { flash_bytes: Some(20_000), ..Default::default() });
    let QuantizeError::Budget { what: "flash", expected: 20_000, found, missing } = flash else { panic!("{flash}") };
    assert_eq!(found - 20_000, missing);
    let ram = error(QuantizeConfig { ram_bytes: Some(1000), ..Default::default() });
    assert!(matches!(ram, QuantizeError::Budget { what: "RAM", .. }), "{ram}");
    let tile = error(QuantizeConfig { tile: Some(48), ..Default::default() });
    assert!(matches!(tile, QuantizeError::Size { field: "tile", found: 48, .. }), "{tile}");
    let energy = error(QuantizeConfig { tile: Some(8), energy: Some(1.0), ..Default::default() });
    assert!(matches!(energy, QuantizeError::Energy { tile: 8, .. }), "{energy}");
}

#[test]
fn weights_that_do_not_fit_a_half_are_refused_by_name() {
    let name = format!("{}.weight", weights::name::BODY);
    for (value, range) in [(f32::NAN, false), (1e5, true)] {
        let mut checkpoint = checkpoint();
        checkpoint.weights.get_mut(&name).unwrap()[[0, 0, 1, 2]] = value;
        let error = quantize(&checkpoint, "", &QuantizeConfig::default()).unwrap_err();
        match error {
            QuantizeError::NotFinite { name: found, index: 5, .. } if !range => assert_eq!(found, name),
            QuantizeError::Range { name: found, index: 5, .. } if range => assert_eq!(found, name),
            other => panic!("{other}"),
        }
    }
}
