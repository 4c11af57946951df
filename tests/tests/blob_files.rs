//! Network files: the golden file still decodes, and no header, however strange, makes the runtime panic.
#![allow(clippy::unwrap_used)]

mod networks;

use half::f16;
use ommatidia_network::network_file::NetworkFile;
use ommatidia_shared::blob::{
    Bank, Blocks, Corner, FeatureBits, Header, Integers, MemoryPlan, Passes, Rcan, Sensor, Size, Tap, VERSION,
    WatchWeights, Watching, Weights,
};
use ommatidia_shared::nn::integer::{Channel, Convolutions};
use ommatidia_shared::pipeline::{Memory, Pipeline};
use ommatidia_shared::watch::Statistic;
use proptest::prelude::*;
use std::path::Path;

/// Files of versions 1 to 5 that are never rewritten, and one of version 6.
const GOLDEN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/golden/network-v2.omm");
const GOLDEN_1: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/golden/network-v1.omm");
const GOLDEN_3: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/golden/network-v3.omm");
const GOLDEN_4: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/golden/network-v4.omm");
const GOLDEN_5: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/golden/network-v5.omm");
const GOLDEN_6: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/golden/network-v6.omm");

/// Index of the blocks of the golden file: two kernels of 4 x 4 blocks.
const GOLDEN_INDEX: [u16; 14] = [0, 0, 2, 3, 3, 3, 4, 4, 5, 1, 3, 0, 2, 3];

fn golden_header() -> Header {
    let mut header = Header {
        name: "golden".try_into().unwrap(),
        checkpoint: "0123456789abcdef".try_into().unwrap(),
        frame: Size { rows: 10, cols: 12 },
        object: Size { rows: 8, cols: 6 },
        sensor: Sensor { black_level_dn: 64.5, saturation_dn: 4095, has_offset_map: true, has_gain_map: true },
        bank: Bank {
            tile: 16,
            step: 16,
            channels: 2,
            taps: (0..2).map(|channel| Tap { channel, dy: 0, dx: 0 }).collect(),
            blocks: Some(Blocks { side: 4, count: 5 }),
        },
        rcan: Rcan { width: 2, groups: 1, blocks: 1, reduction: 2 },
        memory: MemoryPlan { fast_bytes: 0, bulk_bytes: 0 },
        integers: None,
        passes: None,
        watch: None,
    };
    header.memory = Pipeline::plan(&header).unwrap();
    header
}

/// Multiples of 1/16 from -1 to 1; neighbours differ.
fn golden_weight(section: usize, i: usize) -> f16 {
    f16::from_f32(((i * 7 + section * 5) % 33) as f32 / 16.0 - 1.0)
}

#[test]
fn the_golden_file_of_version_2_still_decodes() {
    assert_eq!(VERSION, 6, "keep these files readable or refused by name, and add a golden file of the new version");
    let file = NetworkFile::read(Path::new(GOLDEN)).unwrap();
    let network = file.network().unwrap();
    assert_eq!(network.header(), &golden_header());
    let weights = network.weights();
    // 5 blocks of 4 x 4 lags; conv 8->2, 2 x 2->2, attention 2->1->2, 2->2, 2->2, 2->8, 2->1; 10 x 12 pixels.
    let rcan = 146 + 2 * 38 + 7 + 38 + 38 + 152 + 19;
    let sections = [weights.filters, weights.rcan, weights.offset_dn.unwrap(), weights.inverse_gain.unwrap()];
    assert_eq!(sections.map(<[f16]>::len), [5 * 16, rcan, 120, 120]);
    for (section, halves) in sections.iter().enumerate() {
        for (i, half) in halves.iter().enumerate() {
            assert_eq!(half.to_bits(), golden_weight(section, i).to_bits(), "section {section}, half {i}");
        }
    }
    assert_eq!(weights.index, GOLDEN_INDEX);
    Pipeline::new(&network).unwrap();
}

#[test]
fn a_file_of_version_1_is_refused_by_name() {
    let error = NetworkFile::read(Path::new(GOLDEN_1)).unwrap_err().to_string();
    assert!(error.contains("version 6, found 1") && error.contains("quantize"), "{error}");
}

/// With a new version of the format: `OMMATIDIA_WRITE_GOLDEN=1` writes the file that this test then compares with.
#[test]
fn the_golden_file_of_two_passes_and_a_watch_is_what_this_version_writes() {
    let mut header = golden_header();
    let corners = [Corner { row: -1, col: 2 }, Corner { row: 3, col: 300 }].into_iter().collect();
    header.passes = Some(Passes { later: 1, terms: 2, window: 3, node_step: 4, corners });
    header.watch = Some(Watching { lenses: 3, block: 5, black_dn: 64, least_light_dn: 1000.0, log_odds: 17.8 });
    header.memory = Pipeline::plan(&header).unwrap();
    let lens = header.section_lens().unwrap();
    // Two by three blocks of three lenses.
    assert_eq!((lens.watch, lens.statistics), (6 * 3 * 7, 9 * 8));
    let maps: Vec<i16> = (0..lens.watch).map(|i| (i * 40_503) as i16).collect();
    let statistic = |i: u64| Statistic { scale: i as f32 / 8.0, shot: 2.5, reading: 100.0, specimens: 0.125 };
    let statistics: Vec<Statistic> = (0..9).map(statistic).collect();
    // A pass more: conv 12->2 in place of 8->2. Two terms of 3 x 3 nodes and 3 x 3 lags a lens.
    assert_eq!((lens.rcan, lens.predictor), (2 * 476 + 72, 2 * 2 * (9 + 9)));
    let lens = [lens.filters, lens.rcan, lens.offset_dn, lens.inverse_gain, lens.predictor];
    let sections: Vec<Vec<f16>> =
        lens.iter().enumerate().map(|(s, len)| (0..*len as usize).map(|i| golden_weight(s, i)).collect()).collect();
    let weights = Weights {
        filters: &sections[0],
        index: &GOLDEN_INDEX,
        rcan: &sections[1],
        offset_dn: Some(&sections[2]),
        inverse_gain: Some(&sections[3]),
        convolutions: None,
        predictor: &sections[4],
        watch: WatchWeights { maps: &maps, statistics: &statistics },
    };
    let file = NetworkFile::new(&header, &weights).unwrap();
    if std::env::var_os("OMMATIDIA_WRITE_GOLDEN").is_some() {
        file.write(Path::new(GOLDEN_6)).unwrap();
    }
    assert!(file.bytes() == std::fs::read(GOLDEN_6).unwrap(), "{GOLDEN_6} differs from what is written today");
    let read = NetworkFile::read(Path::new(GOLDEN_6)).unwrap();
    let network = read.network().unwrap();
    assert_eq!(network.header(), &header);
    assert_eq!(network.weights().predictor, &sections[4][..]);
    assert_eq!(network.weights().watch, weights.watch);
    assert_eq!(Pipeline::new(&network).unwrap().passes(), 2);
    // Version 5 is the same network without the watch.
    let read = NetworkFile::read(Path::new(GOLDEN_5)).unwrap();
    header.watch = None;
    let network = read.network().unwrap();
    assert_eq!(network.header(), &header);
    assert!(network.watch().is_none() && network.weights().predictor == &sections[4][..]);
}

#[test]
fn the_golden_files_in_integers_still_decode() {
    let mut header = golden_header();
    header.integers = Some(Integers { input_log2: 13, feature_log2: 11, output: 2.0e-6, features: FeatureBits::Eight });
    header.memory = Pipeline::plan(&header).unwrap();
    let lens = header.section_lens().unwrap();
    // The attention 2->1->2; conv 8->2, 4 x 2->2, 2->8, 2->1.
    assert_eq!((lens.rcan, lens.integers, lens.channels), (7, (144 + 4 * 36 + 144 + 18) / 2, 4 * (5 * 2 + 8 + 1)));
    let (words, channels) = (lens.integers, lens.channels / 4);
    let lens = [lens.filters, lens.rcan, lens.offset_dn, lens.inverse_gain];
    let sections: Vec<Vec<f16>> =
        lens.iter().enumerate().map(|(s, len)| (0..*len as usize).map(|i| golden_weight(s, i)).collect()).collect();
    let integers: Vec<u16> = (0..words).map(|i| (i * 40_503) as u16).collect();
    let channel = |i: u64| Channel { bias: (i * 7_919) as i32 - 50_000, multiplier: 1 << 23 };
    let channels: Vec<Channel> = (0..channels).map(channel).collect();
    let weights = Weights {
        filters: &sections[0],
        index: &GOLDEN_INDEX,
        rcan: &sections[1],
        offset_dn: Some(&sections[2]),
        inverse_gain: Some(&sections[3]),
        convolutions: Some(Convolutions { weights: &integers, channels: &channels }),
        predictor: &[],
        watch: Default::default(),
    };
    let file = NetworkFile::new(&header, &weights).unwrap();
    let read = NetworkFile::read(Path::new(GOLDEN_4)).unwrap();
    assert_eq!(read.header().unwrap(), header);
    // Behind the header the same bytes, but for the checksum.
    let weights = |file: &NetworkFile| file.bytes()[112..file.bytes().len() - 4].to_vec();
    assert!(weights(&read) == weights(&file), "{GOLDEN_4} holds other weights");
    // Version 3 is the same network with features of 16 bits.
    header.integers =
        Some(Integers { input_log2: 13, feature_log2: 11, output: 2.0e-6, features: FeatureBits::Sixteen });
    header.memory = Pipeline::plan(&header).unwrap();
    let read = NetworkFile::read(Path::new(GOLDEN_3)).unwrap();
    assert_eq!(read.header().unwrap(), header);
    let words = |file: &NetworkFile| file.network().unwrap().weights().convolutions.unwrap().weights.to_vec();
    assert_eq!(words(&read), integers);
    Pipeline::new(&read.network().unwrap()).unwrap();
}

/// Mostly a value that a network may have, sometimes any value.
fn mostly<T: std::fmt::Debug>(
    sound: impl Strategy<Value = T>,
    strange: impl Strategy<Value = T>,
) -> impl Strategy<Value = T> {
    prop_oneof![24 => sound, 1 => strange]
}

fn side() -> impl Strategy<Value = u16> {
    mostly((1u16..20).prop_map(|n| 2 * n), any::<u16>())
}

prop_compose! {
    fn strange_headers()(
        frame in (side(), side()), object in (side(), side()), black in mostly(0.0f32..400.0, prop::num::f32::ANY),
        saturation in mostly(500u16.., any::<u16>()), maps: (bool, bool),
        tile in mostly((3u32..7).prop_map(|n| 1 << n), any::<u16>()), step in mostly(1u16..8, any::<u16>()),
        channels in mostly(2u8..4, any::<u8>()),
        taps in prop::collection::vec((0u8..2, -2i8..2, mostly(-2i8..2, any::<i8>())), 2..6),
        rcan in (mostly(1u8..8, any::<u8>()), 0u8..3, 0u8..3, mostly(Just(1), any::<u8>())),
        kernels in mostly(Just(None), (mostly((0u32..4).prop_map(|n| 1 << n), any::<u16>()), 0u16..9).prop_map(Some)),
        integers in mostly(Just(None), (mostly(0i8..25, any::<i8>()), mostly(-16i8..25, any::<i8>())).prop_map(Some)),
        passes in prop::option::of((
            mostly(1u8..4, any::<u8>()), mostly(1u8..7, any::<u8>()),
            mostly((0u16..5).prop_map(|n| 2 * n + 1), any::<u16>()),
            mostly((0u32..5).prop_map(|n| 1 << n), any::<u16>()),
            prop::collection::vec(mostly((-30i16..30, -30i16..30), any::<(i16, i16)>()), 1..6),
        )),
        watch in prop::option::of((mostly(3u8..5, any::<u8>()), mostly(1u8..33, any::<u8>()), any::<u16>())),
        memory: (u32, u32), planned in mostly(Just(true), Just(false)),
    ) -> Header {
        let mut taps = taps;
        taps.sort_unstable();
        taps.dedup();
        let mut header = Header {
            name: "strange".try_into().unwrap(),
            checkpoint: "".try_into().unwrap(),
            frame: Size { rows: frame.0, cols: frame.1 },
            object: Size { rows: object.0, cols: object.1 },
            sensor: Sensor {
                black_level_dn: black, saturation_dn: saturation, has_offset_map: maps.0, has_gain_map: maps.1
            },
            bank: Bank {
                tile, step, channels,
                taps: taps.into_iter().map(|(channel, dy, dx)| Tap { channel, dy, dx }).collect(),
                blocks: kernels.map(|(side, count)| Blocks { side, count }),
            },
            rcan: Rcan { width: rcan.0, groups: rcan.1, blocks: rcan.2, reduction: rcan.3 },
            memory: MemoryPlan { fast_bytes: memory.0, bulk_bytes: memory.1 },
            passes: passes.map(|(later, terms, window, node_step, corners)| Passes {
                later, terms, window, node_step,
                corners: corners.into_iter().map(|(row, col)| Corner { row, col }).collect(),
            }),
            watch: watch.map(|(lenses, block, black_dn)| Watching {
                lenses, block, black_dn, least_light_dn: 10.0, log_odds: 18.0,
            }),
            integers: integers.map(|(input_log2, feature_log2)| Integers {
                input_log2, feature_log2, output: 1.0e-6,
                features: if input_log2 % 2 == 0 { FeatureBits::Eight } else { FeatureBits::Sixteen },
            }),
        };
        if let Ok(plan) = Pipeline::plan(&header) && planned {
            header.memory = plan;
        }
        header
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]
    /// Either the header is refused, or the network runs in the memory of its plan.
    #[test]
    fn strange_headers_are_refused_or_run(header in strange_headers()) {
        let small = |len: u64| len < 1 << 20;
        let Ok(lens) = header.section_lens() else { return Ok(()) };
        let index = vec![0; lens.index.min(1 << 16) as usize];
        let (words, channels) = (lens.integers, lens.channels / 4);
        let (maps, statistics) = (lens.watch, lens.statistics / 8);
        let lens = [lens.filters, lens.rcan, lens.offset_dn, lens.inverse_gain, lens.predictor];
        if header.check().is_err() || !lens.into_iter().chain([words, channels, maps]).all(small) {
            return Ok(());
        }
        // Weights of 2: even 18,000 in a channel stay within 32 bits.
        let integers = vec![0x0202; words as usize];
        let channels = vec![Channel { bias: 1000, multiplier: 1 << 28 }; channels as usize];
        let convolutions = header.integers.map(|_| Convolutions { weights: &integers, channels: &channels });
        let maps = vec![i16::MIN; maps as usize];
        let statistics = vec![Statistic { scale: -3.0, shot: 1.0, reading: 1.0, specimens: 0.0 }; statistics as usize];
        let mut sections = lens.map(|len| vec![f16::from_f32(0.25); len as usize]);
        sections[4].fill(f16::from_f32(1.0 / 2048.0));
        let weights = Weights {
            filters: &sections[0],
            index: &index,
            rcan: &sections[1],
            offset_dn: header.sensor.has_offset_map.then_some(&sections[2]),
            inverse_gain: header.sensor.has_gain_map.then_some(&sections[3]),
            convolutions,
            predictor: &sections[4],
            watch: WatchWeights { maps: &maps, statistics: &statistics },
        };
        let file = NetworkFile::new(&header, &weights).unwrap();
        let network = file.network().unwrap();
        let Ok(pipeline) = Pipeline::new(&network) else { return Ok(()) };
        let mut fast = vec![0.0; pipeline.fast_len()];
        let mut bulk = vec![f16::ZERO; pipeline.bulk_len()];
        let mut object = vec![f16::NAN; pipeline.output_len()];
        let frame = vec![500; pipeline.frame_len()];
        pipeline.run(&frame, Memory { fast: &mut fast, bulk: &mut bulk }, &mut object).unwrap();
        prop_assert!(object.iter().all(|half| half.is_finite()));
        if let Some(maps) = network.watch() {
            prop_assert!(maps.project(&frame).light_dn == frame.len() as i64 * (500 - i64::from(maps.black_dn)));
        }
    }
}
