//! Round trips, and bytes that are no network.

#![allow(clippy::unwrap_used)]

extern crate std;

use super::*;
use crate::nn::integer::{Channel, Convolutions};
use crate::watch::Statistic;
use half::f16;
use proptest::prelude::*;
use std::vec::Vec;

/// Bytes that begin at a multiple of [`ALIGN`].
pub(super) struct Aligned {
    words: Vec<u128>,
    len: usize,
}

impl Aligned {
    pub(super) fn new(bytes: &[u8]) -> Self {
        let mut words = std::vec![0u128; bytes.len().div_ceil(ALIGN) + 1];
        bytemuck::cast_slice_mut(&mut words)[..bytes.len()].copy_from_slice(bytes);
        Self { words, len: bytes.len() }
    }

    pub(super) fn bytes(&self) -> &[u8] {
        &bytemuck::cast_slice(&self.words)[..self.len]
    }
}

/// The weights of a network, owned.
#[derive(Clone, Debug, Default)]
pub(super) struct Owned {
    sections: [Vec<f16>; 4],
    index: Vec<u16>,
    integers: Vec<u16>,
    channels: Vec<Channel>,
    predictor: Vec<f16>,
    maps: Vec<i16>,
    pub(super) statistics: Vec<Statistic>,
}

impl Owned {
    /// Finite halves of every size, from a seed.
    pub(super) fn new(header: &Header, seed: u32) -> Self {
        let lens = header.section_lens().unwrap();
        let mut state = seed;
        let mut draw = |len: u64| -> Vec<f16> {
            (0..len)
                .map(|_| {
                    state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    let half = f16::from_bits((state >> 16) as u16);
                    if half.is_finite() { half } else { f16::ONE }
                })
                .collect()
        };
        let sections = [lens.filters, lens.rcan, lens.offset_dn, lens.inverse_gain].map(&mut draw);
        // At most 108 weights a channel: 108 * 2^7 * 2^15 + 2^30 is below 2^31.
        let channel = |i: u64| Channel { bias: (i * 7_919) as i32 - (1 << 20), multiplier: (i * 104_729) as i32 };
        Self {
            sections,
            index: (0..lens.index).map(|i| (i * 977) as u16).collect(),
            integers: (0..lens.integers).map(|i| (i * 40_503) as u16).collect(),
            channels: (0..lens.channels / 4).map(channel).collect(),
            // Small enough for any model.
            predictor: (0..lens.predictor).map(|i| f16::from_f32((i % 5) as f32 / 4096.0)).collect(),
            maps: (0..lens.watch).map(|i| (i * 40_503) as i16).collect(),
            statistics: (0..lens.statistics / 8)
                .map(|i| Statistic { scale: 0.5, shot: i as f32, reading: 0.0, specimens: 0.25 })
                .collect(),
        }
    }

    pub(super) fn weights(&self, sensor: &Sensor) -> Weights<'_> {
        let [filters, rcan, offset, gain] = &self.sections;
        Weights {
            filters,
            index: &self.index,
            rcan,
            offset_dn: sensor.has_offset_map.then_some(offset.as_slice()),
            inverse_gain: sensor.has_gain_map.then_some(gain.as_slice()),
            convolutions: (!self.channels.is_empty())
                .then_some(Convolutions { weights: &self.integers, channels: &self.channels }),
            predictor: &self.predictor,
            watch: WatchWeights { maps: &self.maps, statistics: &self.statistics },
        }
    }
}

pub(super) fn file(header: &Header, weights: &Owned) -> Vec<u8> {
    let mut bytes = std::vec![0xa5; encoded_len(header).unwrap()];
    let len = encode(header, &weights.weights(&header.sensor), &mut bytes).unwrap();
    assert_eq!(len, bytes.len());
    bytes
}

pub(super) fn small() -> Header {
    Header {
        name: "small".try_into().unwrap(),
        checkpoint: "0123456789abcdef".try_into().unwrap(),
        frame: Size { rows: 6, cols: 5 },
        object: Size { rows: 4, cols: 2 },
        sensor: Sensor { black_level_dn: 64.0, saturation_dn: 4095, has_offset_map: true, has_gain_map: false },
        bank: Bank {
            tile: 4,
            step: 2,
            channels: 1,
            taps: [Tap { channel: 0, dy: 0, dx: 0 }, Tap { channel: 0, dy: 0, dx: 1 }].into_iter().collect(),
            blocks: None,
        },
        rcan: Rcan { width: 1, groups: 0, blocks: 0, reduction: 1 },
        memory: MemoryPlan { fast_bytes: 100, bulk_bytes: 2000 },
        integers: None,
        passes: None,
        watch: None,
    }
}

pub(super) fn small_in_integers() -> Header {
    Header {
        integers: Some(Integers { input_log2: 12, feature_log2: 10, output: 1.0e-6, features: FeatureBits::Sixteen }),
        ..small()
    }
}

fn small_with_passes() -> Header {
    let corners = [Corner { row: -1, col: 0 }, Corner { row: 1, col: 2 }].into_iter().collect();
    Header { passes: Some(Passes { later: 1, terms: 2, window: 3, node_step: 2, corners }), ..small() }
}

pub(super) fn small_with_watch() -> Header {
    Header {
        watch: Some(Watching { lenses: 3, block: 4, black_dn: 64, least_light_dn: 100.0, log_odds: 18.0 }),
        ..small()
    }
}

prop_compose! {
    fn headers()(
        name in "[a-z]{0,12}", tile in 1u32..5, step in 1u16..3, channels in 1u8..4, taps in 1usize..5,
        rows in 1u16..9, cols in 1u16..9, black in 0.0f32..200.0, maps: (bool, bool),
        rcan in (1u8..5, 0u8..3, 0u8..3), memory: (u32, u32), blocks in prop::option::of((0u32..2, 0u16..5)),
        scales in prop::option::of((0i8..25, -16i8..25)),
        passes in prop::option::of(
            (1u8..4, 1u8..3, 0u16..3, 0u32..4, prop::collection::vec(any::<(i16, i16)>(), 1..10))
        ),
        watch in prop::option::of((3u8..5, 1u8..6, any::<u16>())),
    ) -> Header {
        let tap = |i: usize| Tap { channel: 0, dy: -1, dx: i as i8 };
        Header {
            name: name.as_str().try_into().unwrap(),
            checkpoint: "".try_into().unwrap(),
            frame: Size { rows, cols },
            object: Size { rows: 2 * rows, cols: 2 * cols },
            sensor: Sensor { black_level_dn: black, saturation_dn: 1023, has_offset_map: maps.0, has_gain_map: maps.1 },
            bank: Bank { tile: 1 << tile, step, channels, taps: (0..taps).map(tap).collect(),
                blocks: blocks.map(|(side, count)| Blocks { side: 1 << side, count }),
            },
            rcan: Rcan { width: rcan.0, groups: rcan.1, blocks: rcan.2, reduction: 1 },
            memory: MemoryPlan { fast_bytes: memory.0, bulk_bytes: memory.1 },
            passes: passes.filter(|_| scales.is_none()).map(|(later, terms, half, step, corners)| Passes {
                later, terms, window: 2 * half + 1, node_step: 1 << step,
                corners: corners.into_iter().map(|(row, col)| Corner { row, col }).collect(),
            }),
            watch: watch.map(|(lenses, block, black_dn)| Watching {
                lenses, block, black_dn, least_light_dn: 9.0, log_odds: 18.0,
            }),
            integers: scales.map(|(input_log2, feature_log2)| Integers {
                input_log2, feature_log2, output: 1.0e-7, features: FeatureBits::Sixteen,
            }),
        }
    }
}

fn bits(halves: &[f16]) -> &[u16] {
    bytemuck::cast_slice(halves)
}

/// Replaces bytes of a good file and makes its CRC right again.
pub(super) fn forge(mut bytes: Vec<u8>, at: usize, with: &[u8]) -> Vec<u8> {
    bytes[at..at + with.len()].copy_from_slice(with);
    let end = bytes.len() - layout::CRC_LEN;
    let crc = CRC.checksum(&bytes[..end]);
    bytes[end..].copy_from_slice(&crc.to_le_bytes());
    bytes
}

proptest! {
    #[test]
    fn what_is_written_is_read(header in headers(), seed: u32) {
        let owned = Owned::new(&header, seed);
        let aligned = Aligned::new(&file(&header, &owned));
        let network = Network::decode(aligned.bytes()).unwrap();
        let expected = owned.weights(&header.sensor);
        prop_assert_eq!(network.header(), &header);
        prop_assert_eq!(bits(network.weights().filters), bits(expected.filters));
        prop_assert_eq!(network.weights().index, expected.index);
        prop_assert_eq!(bits(network.weights().rcan), bits(expected.rcan));
        prop_assert_eq!(network.weights().offset_dn.map(bits), expected.offset_dn.map(bits));
        prop_assert_eq!(network.weights().inverse_gain.map(bits), expected.inverse_gain.map(bits));
        let integers = |weights: Weights<'_>| weights.convolutions.map(|c| (c.weights.to_vec(), c.channels.to_vec()));
        prop_assert_eq!(integers(network.weights()), integers(expected));
        prop_assert_eq!(bits(network.weights().predictor), bits(expected.predictor));
        prop_assert_eq!(network.weights().watch, expected.watch);
    }

    #[test]
    fn random_bytes_are_refused(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        prop_assert!(Network::decode(Aligned::new(&bytes).bytes()).is_err());
    }

    /// A forger who makes the CRC right may change any word: the file is refused or stays a network in bounds.
    #[test]
    fn forged_bytes_never_panic(
        at in 0usize..900, with in prop::collection::vec(any::<u8>(), 1..5), cut in 0usize..40, kind in 0usize..4,
    ) {
        let header = [small, small_in_integers, small_with_passes, small_with_watch][kind]();
        let mut bytes = file(&header, &Owned::new(&header, 7));
        bytes.truncate(bytes.len() - cut);
        let at = at.min(bytes.len() - 9);
        let len = with.len().min(bytes.len() - 4 - at);
        let mut bytes = forge(bytes, at, &with[..len]);
        let file_len = (bytes.len() as u32).to_le_bytes();
        if cut % 2 == 1 {
            bytes = forge(bytes, layout::FILE_LEN_AT, &file_len);
        }
        if let Ok(network) = Network::decode(Aligned::new(&bytes).bytes()) {
            let lens = network.header().section_lens().unwrap();
            prop_assert_eq!(network.weights().filters.len() as u64, lens.filters);
            prop_assert_eq!(network.weights().rcan.len() as u64, lens.rcan);
            prop_assert_eq!(network.weights().predictor.len() as u64, lens.predictor);
            if let Some(maps) = network.watch() {
                prop_assert_eq!(maps.weights.len() as u64, lens.watch);
                let pixels = usize::from(maps.frame.rows) * usize::from(maps.frame.cols);
                maps.project(&std::vec![9; pixels.min(1 << 16)]);
            }
            if let Some(convolutions) = network.weights().convolutions {
                prop_assert_eq!(convolutions.weights.len() as u64, lens.integers);
                prop_assert!(convolutions.check(&network.header().rcan, network.header().bank.channels).is_ok());
            }
        }
    }
}

#[test]
fn every_flipped_bit_is_refused() {
    [small_in_integers(), small_with_passes(), small_with_watch()].into_iter().for_each(flipped_bits_are_refused);
}

fn flipped_bits_are_refused(header: Header) {
    let mut aligned = Aligned::new(&file(&header, &Owned::new(&header, 1)));
    let len = aligned.len;
    for bit in 0..8 * len {
        bytemuck::cast_slice_mut::<_, u8>(&mut aligned.words)[bit / 8] ^= 1 << (bit % 8);
        assert!(Network::decode(aligned.bytes()).is_err(), "bit {bit}");
        bytemuck::cast_slice_mut::<_, u8>(&mut aligned.words)[bit / 8] ^= 1 << (bit % 8);
    }
    assert!(Network::decode(aligned.bytes()).is_ok());
}

#[test]
fn every_shorter_or_longer_file_is_refused() {
    let header = small();
    let bytes = file(&header, &Owned::new(&header, 1));
    let aligned = Aligned::new(&bytes);
    for len in 0..bytes.len() {
        let error = Network::decode(&aligned.bytes()[..len]).unwrap_err();
        assert!(matches!(error, BlobError::TooShort { found, .. } if found == len as u64), "{len}: {error}");
    }
    let longer: Vec<u8> = bytes.iter().copied().chain([0]).collect();
    let error = Network::decode(Aligned::new(&longer).bytes()).unwrap_err();
    assert_eq!(error, BlobError::TooLong { expected: bytes.len() as u64, found: longer.len() as u64 });
}

#[test]
fn each_refusal_names_its_reason() {
    let header = small();
    let good = file(&header, &Owned::new(&header, 1));
    let refusal = |at: usize, with: &[u8]| {
        Network::decode(Aligned::new(&forge(good.clone(), at, with)).bytes()).map(Network::into_header).unwrap_err()
    };
    assert_eq!(refusal(0, b"GIF89a\0\0"), BlobError::Magic { expected: MAGIC, found: *b"GIF89a\0\0" });
    assert_eq!(refusal(layout::VERSION_AT, &9u16.to_le_bytes()), BlobError::Version { expected: VERSION, found: 9 });
    assert_eq!(refusal(layout::SCHEMA_AT, &1u64.to_le_bytes()), BlobError::Schema { expected: SCHEMA_KEY, found: 1 });
    assert_eq!(
        refusal(layout::HEADER_LEN_AT, &u32::MAX.to_le_bytes()),
        BlobError::Header { field: HeaderField::Encoding }
    );
    let (at, _) = sections(&header)[2];
    assert_eq!(refusal(at + 6, &f16::NAN.to_le_bytes()), BlobError::NonFinite { section: Section::Rcan, index: 3 });
    let mut damaged = good.clone();
    damaged[at] ^= 1;
    assert!(matches!(Network::decode(Aligned::new(&damaged).bytes()), Err(BlobError::Crc { .. })));
}

#[test]
fn what_was_verified_opens_again_and_nothing_else_does() {
    let header = small();
    let aligned = Aligned::new(&file(&header, &Owned::new(&header, 1)));
    let verified = Verified::check(aligned.bytes()).unwrap();
    assert_eq!(verified.open(aligned.bytes()).unwrap().header(), &header);
    let other = Aligned::new(&file(&header, &Owned::new(&header, 2)));
    assert!(matches!(verified.open(other.bytes()), Err(BlobError::Crc { .. })), "another file of the same length");
    let named = Header { name: "longer".try_into().unwrap(), ..header.clone() };
    let longer = Aligned::new(&file(&named, &Owned::new(&named, 1)));
    assert!(verified.open(longer.bytes()).is_err(), "a file of another length");
    let (at, _) = sections(&header)[2];
    let poisoned = forge(aligned.bytes().to_vec(), at + 6, &f16::NAN.to_le_bytes());
    assert!(verified.open(Aligned::new(&poisoned).bytes()).is_err(), "a file with a NaN and a checksum that is right");
}

fn sections(header: &Header) -> [(usize, usize); layout::SECTIONS] {
    let mut buffer = [0; layout::MAX_HEADER_LEN];
    let len = postcard::to_slice(header, &mut buffer).unwrap().len();
    layout::Layout::new(len, &header.section_lens().unwrap()).unwrap().sections
}

#[test]
fn a_misaligned_buffer_is_named() {
    let header = small();
    let bytes = file(&header, &Owned::new(&header, 1));
    let shifted: Vec<u8> = [0; 2].into_iter().chain(bytes).collect();
    let aligned = Aligned::new(&shifted);
    assert_eq!(
        Network::decode(&aligned.bytes()[2..]).map(Network::into_header),
        Err(BlobError::Misaligned { expected: ALIGN as u32, found: 2 })
    );
}

#[test]
fn sections_are_aligned_and_apart() {
    for header in [small_in_integers(), small_with_passes()] {
        let mut end = 0;
        for (at, len) in sections(&header) {
            assert!(at % ALIGN == 0 || len == 0);
            assert!(at >= end);
            end = at + len;
        }
    }
}

#[test]
fn the_encoder_refuses_what_it_could_not_read() {
    let header = small();
    let owned = Owned::new(&header, 1);
    let weights = owned.weights(&header.sensor);
    let mut out = std::vec![0; encoded_len(&header).unwrap()];
    let filters = &weights.filters[1..];
    assert_eq!(
        encode(&header, &Weights { filters, ..weights }, &mut out),
        Err(BlobError::SectionLength { section: Section::Filters, expected: 48, found: 47 })
    );
    let len = out.len();
    assert_eq!(
        encode(&header, &weights, &mut out[1..]),
        Err(BlobError::NoRoom { expected: len as u64, found: len as u64 - 1 })
    );
    let odd = Header { object: Size { rows: 3, cols: 2 }, ..header };
    assert_eq!(encoded_len(&odd), Err(BlobError::Header { field: HeaderField::Object }));
}

#[test]
fn weights_are_counted() {
    // conv 12->4: 436; group: 1 x (2 conv 4->4: 296; attention 4->2->4: 22) + conv 4->4: 148; conv 4->4: 148;
    // conv 4->16: 592; conv 4->1: 37.
    let rcan = Rcan { width: 4, groups: 1, blocks: 1, reduction: 2 };
    let header = Header { rcan, bank: Bank { channels: 3, ..small().bank }, ..small() };
    assert_eq!(header.section_lens().unwrap().rcan, 436 + 296 + 22 + 148 + 148 + 592 + 37);
    let bank = |side, count| Bank { blocks: Some(Blocks { side, count }), ..small().bank };
    let blocks = Header { bank: Bank { tile: 16, channels: 2, ..bank(4, 7) }, ..small() };
    let lens = blocks.section_lens().unwrap();
    assert_eq!((lens.filters, lens.index), (7 * 16, 2 * 4 + 1 + 7));
    for side in [0, 3, 8] {
        let wrong = Header { bank: bank(side, 7), ..small() };
        assert_eq!(wrong.check(), Err(BlobError::Header { field: HeaderField::Blocks }), "{side}");
    }
    let none = Header { rcan: Rcan { reduction: 0, ..rcan }, ..header };
    assert_eq!(none.check(), Err(BlobError::Header { field: HeaderField::Rcan }));
}

#[test]
fn integers_are_counted() {
    // Four convolutions: 4->1, 1->1, 1->4, 1->1; 36 + 9 + 36 + 9 weights of 8 bits, 7 channels; no attention.
    let lens = small_in_integers().section_lens().unwrap();
    assert_eq!((lens.rcan, lens.integers, lens.channels), (0, 45, 4 * 7));
}

#[test]
fn integers_that_could_overflow_are_refused() {
    let header = small_in_integers();
    let good = file(&header, &Owned::new(&header, 1));
    let refusal = |at: usize, with: &[u8]| {
        Network::decode(Aligned::new(&forge(good.clone(), at, with)).bytes()).map(Network::into_header).unwrap_err()
    };
    let (at, _) = sections(&header)[6];
    let error = BlobError::Channel { section: Section::Channels, index: 2 };
    assert_eq!(refusal(at + 16, &i32::MAX.to_le_bytes()), error);
    assert_eq!(refusal(at + 20, &(-1_i32).to_le_bytes()), error);
    let impossible = BlobError::Header { field: HeaderField::Integers };
    let scales = Integers { input_log2: 12, feature_log2: 10, output: 1.0e-6, features: FeatureBits::Sixteen };
    for wrong in [
        Integers { input_log2: 25, ..scales },
        Integers { input_log2: -1, ..scales },
        Integers { feature_log2: -17, ..scales },
        Integers { output: 0.0, ..scales },
        Integers { output: f32::NAN, ..scales },
        Integers { output: 1.0e-40, ..scales },
    ] {
        assert_eq!(Header { integers: Some(wrong), ..header.clone() }.check(), Err(impossible), "{wrong:?}");
    }
}

/// Each number of the passes that no network can have, and weights that could overflow.
#[test]
fn impossible_passes_are_refused_by_name() {
    let good = small_with_passes();
    assert_eq!(good.check(), Ok(()));
    let refused = |change: fn(&mut Passes)| {
        let mut header = small_with_passes();
        change(header.passes.as_mut().unwrap());
        assert_eq!(header.check(), Err(BlobError::Header { field: HeaderField::Passes }), "{header:?}");
        assert!(encoded_len(&header).is_err());
    };
    refused(|passes| passes.later = 0);
    refused(|passes| passes.later = MAX_LATER + 1);
    refused(|passes| passes.terms = 0);
    refused(|passes| passes.window = 4);
    refused(|passes| passes.window = 1025);
    refused(|passes| passes.node_step = 0);
    refused(|passes| passes.node_step = 3);
    refused(|passes| passes.corners.clear());
    let integers = Header { integers: small_in_integers().integers, ..good.clone() };
    assert_eq!(integers.check(), Err(BlobError::Header { field: HeaderField::Passes }));
    // Two terms of 3 x 2 nodes and 3 x 3 lags a lens; transforms of 8 x 8.
    assert_eq!(good.section_lens().unwrap().predictor, 2 * 2 * (3 * 2 + 9));
    let owned = Owned::new(&good, 1);
    let with = |at: usize, value: f32| {
        let mut owned = owned.clone();
        owned.predictor[at] = f16::from_f32(value);
        let mut out = std::vec![0; encoded_len(&good).unwrap()];
        encode(&good, &owned.weights(&good.sensor), &mut out)
    };
    assert!(with(0, -1.0).is_ok() && with(6, 7.5).is_ok());
    assert_eq!(with(30, 1.01), Err(BlobError::Lens { index: 1 }));
    assert_eq!(with(6, -8.1), Err(BlobError::Lens { index: 0 }));
    assert_eq!(with(7, f32::NAN), Err(BlobError::NonFinite { section: Section::Predictor, index: 7 }));
}

#[test]
fn missing_memory_is_counted() {
    let needed = MemoryPlan { fast_bytes: 10, bulk_bytes: 20 };
    assert_eq!(needed.fits(needed), Ok(()));
    let available = MemoryPlan { fast_bytes: 10, bulk_bytes: 13 };
    let error = needed.fits(available).unwrap_err();
    assert_eq!(error, BlobError::Memory { needed, available });
    assert!(std::format!("{error}").ends_with("0 and 7 missing"));
}
