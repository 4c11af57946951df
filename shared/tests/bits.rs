//! The bits of four reconstructions. `cargo verify` runs this test on every target that it can run programs for: with
//! vectors and without, with 32 and 64 bits, with a floating-point unit and without.
#![allow(clippy::unwrap_used)]

use ommatidia_shared::blob::{
    Bank, FeatureBits, Header, Integers, MemoryPlan, Network, Rcan, Sensor, Size, Tap, Weights,
};
use ommatidia_shared::nn::integer::{Channel, Convolutions};
use ommatidia_shared::nn::rcan::weights_len;
use ommatidia_shared::num::f16;
use ommatidia_shared::pipeline::{Memory, Pipeline};

/// FNV-1a.
fn digest(halves: &[f16]) -> u64 {
    let bytes = halves.iter().flat_map(|half| half.to_bits().to_le_bytes());
    bytes.fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3))
}

fn reconstruct(network: &Network<'_>) -> u64 {
    let pipeline = Pipeline::new(network).unwrap();
    let frame: Vec<u16> = (0..pipeline.frame_len()).map(|i| (i * 7919 % 4096) as u16).collect();
    let (mut fast, mut bulk) = (vec![0.0; pipeline.fast_len()], vec![f16::ZERO; pipeline.bulk_len()]);
    let mut object = vec![f16::NAN; pipeline.output_len()];
    pipeline.run(&frame, Memory { fast: &mut fast, bulk: &mut bulk }, &mut object).unwrap();
    let differing = object.iter().filter(|half| **half != object[0]).count();
    assert!(differing > object.len() / 4, "all alike");
    digest(&object)
}

/// The next number of a linear congruential generator, from -1 to 1.
fn next(state: &mut u32) -> f32 {
    *state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
    (*state >> 8) as f32 / 8_388_608.0 - 1.0
}

fn halves(state: &mut u32, len: usize, spread: f32) -> Vec<f16> {
    (0..len).map(|_| f16::from_f32(spread * next(state))).collect()
}

/// Taps on several tiles, six features.
fn header(integers: Option<Integers>) -> Header {
    let taps = (0..2).flat_map(|channel| [(-1, 0), (0, 0), (1, 1)].map(|(dy, dx)| Tap { channel, dy, dx })).collect();
    let mut header = Header {
        name: "bits".try_into().unwrap(),
        checkpoint: "".try_into().unwrap(),
        frame: Size { rows: 50, cols: 44 },
        object: Size { rows: 38, cols: 30 },
        sensor: Sensor { black_level_dn: 64.0, saturation_dn: 4095, has_offset_map: false, has_gain_map: false },
        bank: Bank { tile: 32, step: 16, channels: 2, taps, blocks: None },
        rcan: Rcan { width: 6, groups: 1, blocks: 2, reduction: 2 },
        memory: MemoryPlan { fast_bytes: 0, bulk_bytes: 0 },
        integers,
        passes: None,
        watch: None,
    };
    header.memory = Pipeline::plan(&header).unwrap();
    header
}

/// Random weights; layers that multiply by `gain`.
fn made(gain: f32) -> u64 {
    let (mut state, header) = (11, header(None));
    let filters = halves(&mut state, 6 * 2 * 32 * 17, 1.0);
    let mut rcan = halves(&mut state, weights_len(&header.rcan, 2), 0.2 * gain);
    let last = rcan.len() - 55;
    rcan[last..].iter_mut().for_each(|w| *w = f16::from_f32(w.to_f32() / (gain * gain)));
    let (index, convolutions) = (&[], None);
    let (offset_dn, inverse_gain, predictor) = (None, None, &[]);
    let watch = Default::default();
    let weights =
        Weights { filters: &filters, index, rcan: &rcan, offset_dn, inverse_gain, convolutions, predictor, watch };
    reconstruct(&Network::new(header, weights).unwrap())
}

/// The same shape with convolutions in integers.
fn made_in_integers() -> u64 {
    let header =
        header(Some(Integers { input_log2: 13, feature_log2: 11, output: 1.0e-6, features: FeatureBits::Sixteen }));
    let (mut state, lens) = (12, header.section_lens().unwrap());
    let filters = halves(&mut state, 6 * 2 * 32 * 17, 1.0);
    let rcan = halves(&mut state, lens.rcan as usize, 0.3);
    let integers: Vec<u16> = (0..lens.integers).map(|_| (32_768.0 * (1.0 + next(&mut state))) as u16).collect();
    let channels: Vec<Channel> = (0..lens.channels / 4)
        .map(|_| Channel {
            bias: (300_000.0 * next(&mut state)) as i32,
            multiplier: (8.0e6 * (1.0 + 0.5 * next(&mut state))) as i32,
        })
        .collect();
    let convolutions = Some(Convolutions { weights: &integers, channels: &channels });
    let index = &[];
    let (offset_dn, inverse_gain, predictor) = (None, None, &[]);
    let watch = Default::default();
    let weights =
        Weights { filters: &filters, index, rcan: &rcan, offset_dn, inverse_gain, convolutions, predictor, watch };
    reconstruct(&Network::new(header, weights).unwrap())
}

#[test]
fn the_golden_network_has_its_bits() {
    let file = include_bytes!("../../tests/golden/network-v2.omm");
    let mut words = vec![0_u128; file.len().div_ceil(16)];
    let aligned = &mut bytemuck::cast_slice_mut::<_, u8>(&mut words)[..file.len()];
    aligned.copy_from_slice(file);
    assert_eq!(format!("{:016x}", reconstruct(&Network::decode(aligned).unwrap())), "0645ec5d0500f006");
}

#[test]
fn a_network_of_taps_has_its_bits() {
    assert_eq!(format!("{:016x}", made(1.0)), "7419fd608c4257ca");
}

#[test]
fn a_network_whose_features_are_cut_off_has_its_bits() {
    assert_eq!(format!("{:016x}", made(100.0)), "742876d9c4329a3b");
}

#[test]
fn a_network_in_integers_has_its_bits() {
    assert_eq!(format!("{:016x}", made_in_integers()), "66aa211ff4e36948");
}
