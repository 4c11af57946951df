//! The memory plan of any shape is that of exact arithmetic, or the shape is refused. It holds on a 32-bit machine too,
//! where `usize` would wrap: `cargo verify` runs these tests as a 32-bit program.
#![allow(clippy::unwrap_used)]

use ommatidia_shared::blob::{Bank, Blocks, Corner, Header, MemoryPlan, Network, Passes, Rcan, Sensor, Size, Tap};
use ommatidia_shared::blob::{BlobError, Section, Weights, encode, encoded_len};
use ommatidia_shared::filter::{FilterBank, FilterError};
use ommatidia_shared::nn::rcan::{self, weights_count, weights_len};
use ommatidia_shared::num::f16;
use ommatidia_shared::pipeline::{Pipeline, PipelineError};
use proptest::prelude::*;

fn header(bank: Bank, frame: Size, object: Size, rcan: Rcan) -> Header {
    Header {
        name: "any".try_into().unwrap(),
        checkpoint: "0123456789abcdef".try_into().unwrap(),
        frame,
        object,
        sensor: Sensor { black_level_dn: 64.0, saturation_dn: 1023, has_offset_map: false, has_gain_map: false },
        bank,
        rcan,
        memory: MemoryPlan { fast_bytes: 0, bulk_bytes: 0 },
        integers: None,
        passes: None,
        watch: None,
    }
}

/// A shape whose spectra have 2^32 + 134,144 halves: in 32 bits its plan wraps to 276,752 bytes.
fn wrapping() -> Header {
    let taps = [-35, 34].map(|dy| Tap { channel: 0, dy, dx: 0 }).into_iter().collect();
    header(
        Bank { tile: 256, step: 2, channels: 1, taps, blocks: None },
        Size { rows: 20, cols: 2000 },
        Size { rows: 2, cols: 1858 },
        Rcan { width: 1, groups: 1, blocks: 1, reduction: 1 },
    )
}

#[test]
fn a_plan_that_wraps_in_32_bits_is_refused() {
    let mut header = wrapping();
    // Window spectra, one half-transformed tile of two rows.
    let needed = 2 * (70 * 929 * 66_048 + 2 * 129 * 2);
    let refused = PipelineError::Filter(FilterError::TooLarge { needed });
    assert_eq!(Pipeline::plan(&header), Err(refused));
    assert!(refused.to_string().contains("8590203912 bytes"), "{refused}");
    // The file with the wrapped plan is whole and has the right checksum, and is refused all the same.
    header.memory = MemoryPlan { fast_bytes: 8_000, bulk_bytes: 276_752 };
    let (filters, rcan) = (vec![f16::ZERO; 2 * 66_048], vec![f16::ZERO; weights_len(&header.rcan, 1)]);
    let weights = Weights {
        filters: &filters,
        index: &[],
        rcan: &rcan,
        offset_dn: None,
        inverse_gain: None,
        convolutions: None,
        predictor: &[],
        watch: Default::default(),
    };
    let mut words = vec![0_u128; encoded_len(&header).unwrap().div_ceil(16)];
    let buffer = bytemuck::cast_slice_mut(&mut words);
    let len = encode(&header, &weights, buffer).unwrap();
    let network = Network::decode(&buffer[..len]).unwrap();
    assert_eq!(Pipeline::new(&network).map(|_| ()), Err(refused));
}

/// The number of weights of this one is above 2^32, and in 32 bits it was a few hundred million.
#[test]
fn weights_that_wrap_in_32_bits_are_counted() {
    let mut header = wrapping();
    header.rcan = Rcan { width: 63, groups: 255, blocks: 255, reduction: 63 };
    let conv = |inputs: u64, outputs: u64| 9 * inputs * outputs + outputs;
    let block = 2 * conv(63, 63) + (63 + 1) + (63 + 63);
    let rest = conv(4, 63) + 255 * conv(63, 63) + conv(63, 63) + conv(63, 252) + conv(63, 1);
    assert_eq!(weights_count(&header.rcan, 1), 255 * 255 * block + rest);
    assert!(weights_count(&header.rcan, 1) > 1 << 32);
    assert_eq!(header.section_lens().unwrap().rcan, weights_count(&header.rcan, 1));
    let section = BlobError::SectionLength {
        section: Section::Rcan,
        expected: weights_count(&header.rcan, 1),
        found: u64::from(u32::MAX / 2),
    };
    assert_eq!(encoded_len(&header), Err(section));
}

#[test]
fn features_that_wrap_in_32_bits_are_refused() {
    let shape = Rcan { width: 255, groups: 1, blocks: 1, reduction: 1 };
    assert!(rcan::Rcan::new(shape, None, 255, Size { rows: 65_534, cols: 65_534 }).is_err());
    assert!(rcan::Rcan::new(shape, None, 255, Size { rows: 400, cols: 400 }).is_ok());
}

/// Bulk memory by exact arithmetic, bytes.
fn bulk(header: &Header) -> u128 {
    let wide = |n: u16| u128::from(n);
    let Header { bank, frame: _, object, rcan, .. } = header;
    let [rows, cols] = [object.rows, object.cols].map(wide);
    let (tile, step) = (wide(bank.tile), wide(bank.step));
    let span = |offset: fn(&Tap) -> i8| {
        let offsets = || bank.taps.iter().map(offset).map(i128::from);
        (offsets().max().unwrap() - offsets().min().unwrap() + 1) as u128
    };
    let row = 2 * (tile / 2 + 1);
    let windows = cols.div_ceil(step) + span(|tap| tap.dx) - 1;
    let kernel = if bank.blocks.is_some() { tile * row } else { 0 };
    let cache = span(|tap| tap.dy) * windows * tile * row;
    let filter = cache + step.min(rows) * row + kernel;
    let (feature, input) = (u128::from(rcan.width) * rows * cols / 4, u128::from(bank.channels) * rows * cols);
    let first = (4 * feature).max(feature + input).max(filter + input);
    let Some(passes) = &header.passes else { return 2 * first };
    // Kept: the filter outputs of the frame, and one or two planes of logits. Of a pass: the predicted frame, and
    // either the reconstruction with the spectra of up to two terms and an image, or the input with those of the
    // filters. Where the filters transform the whole frame, it lies in their place and before it.
    let (pixels, frame) = (rows * cols, wide(header.frame.rows) * wide(header.frame.cols));
    let more = input + pixels;
    let planes = if passes.later > 1 { 2 } else { 1 };
    let side = (object.rows.max(object.cols) + passes.window - 1).next_power_of_two().max(8);
    let row = 2 * (wide(side) / 2 + 1);
    let predictor = 2 * u128::from(passes.terms.min(2)) * row * wide(side) + row * (rows + wide(passes.window) - 1);
    let whole = |len: u16, object: u16| tile >= wide(len) && step >= wide(object);
    let single = bank.taps.iter().all(|tap| (tap.dy, tap.dx) == (0, 0));
    let whole = single && whole(header.frame.rows, object.rows) && whole(header.frame.cols, object.cols);
    let pass = if whole {
        pixels + (frame + predictor.max(cache)).max(filter + input)
    } else {
        frame + (pixels + predictor).max(more + filter)
    };
    let work = first.max(4 * feature).max(feature + more).max(pass);
    2 * (input + planes * pixels + work)
}

fn banks() -> impl Strategy<Value = Bank> {
    let taps = prop::collection::btree_set((0_u8..3, any::<i8>(), any::<i8>()), 1..20);
    let blocks =
        prop::option::of((0_u32..11, any::<u16>()).prop_map(|(side, count)| Blocks { side: 1 << side, count }));
    (3_u32..11, 1_u16..1025, 1_u8..64, taps, blocks, any::<bool>()).prop_map(
        |(tile, step, channels, taps, blocks, dense)| {
            let tap = |(channel, dy, dx)| Tap { channel, dy, dx };
            let (channels, taps) = if dense {
                (channels, (0..channels).map(|channel| tap((channel, 0, 0))).collect())
            } else {
                // Channels without a gap, whatever was drawn.
                let drawn: Vec<u8> = taps.iter().map(|tap| tap.0).collect();
                let rank = |c: u8| (0..c).filter(|before| drawn.contains(before)).count() as u8;
                let taps: heapless::Vec<Tap, 128> = taps.iter().map(|t| tap((rank(t.0), t.1, t.2))).collect();
                (taps.last().unwrap().channel + 1, taps)
            };
            Bank { tile: 1 << tile, step: step.min(1 << tile), channels, taps, blocks: blocks.filter(|_| dense) }
        },
    )
}

fn headers() -> impl Strategy<Value = Header> {
    // Small sides, and sides up to the largest, in equal parts.
    let side = || prop_oneof![1_u16..2049, 1_u16..40];
    let network = (1_u8..64, any::<u8>(), any::<u8>(), any::<bool>());
    let passes = prop::option::of((1_u8..8, 1_u8..9, 0_u16..20, 0_u32..8));
    (banks(), [side(), side()], [side(), side()], network, passes).prop_map(|(bank, frame, object, network, passes)| {
        let (width, groups, blocks, narrow) = network;
        let rcan = Rcan { width, groups, blocks, reduction: if narrow { width } else { 1 } };
        let [frame, object] = [frame, object].map(|[rows, cols]| Size { rows: 2 * rows, cols: 2 * cols });
        let mut header = header(bank, frame, object, rcan);
        header.passes = passes.map(|(later, terms, half, step)| Passes {
            later,
            terms,
            window: 2 * half + 1,
            node_step: 1 << step,
            corners: [Corner { row: 0, col: 0 }].into_iter().collect(),
        });
        header
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    /// Every shape that passes the other checks.
    #[test]
    fn every_plan_is_exact_or_refused(header in headers()) {
        let needed = bulk(&header);
        match Pipeline::plan(&header) {
            Ok(plan) => {
                prop_assert_eq!(u128::from(plan.bulk_bytes), needed);
                prop_assert!(u128::from(plan.fast_bytes) >= 24 * u128::from(header.bank.tile));
                let filter = FilterBank::new(&header.bank, header.frame, header.object).unwrap();
                prop_assert!(2 * filter.arena_len() as u128 <= needed);
            }
            Err(PipelineError::TooLarge { bulk, .. }) => {
                prop_assert_eq!(u128::from(bulk), needed);
                prop_assert!(needed > u128::from(u32::MAX));
            }
            Err(PipelineError::Filter(FilterError::TooLarge { needed: filter })) => {
                prop_assert!(filter > u64::from(u32::MAX) && u128::from(filter) <= needed);
            }
            Err(PipelineError::Network(_)) => prop_assert!(needed > u128::from(u32::MAX)),
            Err(PipelineError::Field { field: "passes", .. }) => prop_assert!(header.check().is_err()),
            Err(PipelineError::Field { field: "bank.channels", .. }) => prop_assert_eq!(header.bank.channels, 63),
            Err(PipelineError::Filter(FilterError::Kernels)) => prop_assert!(header.bank.blocks.is_some()),
            Err(other) => prop_assert!(false, "{other}"),
        }
    }

    /// Any numbers at all: refused or planned, without an overflow, which a build with overflow checks reports.
    #[test]
    fn no_header_overflows(
        tile: u16, step: u16, channels: u8, taps in prop::collection::vec(any::<(u8, i8, i8)>(), 0..9),
        blocks: Option<(u16, u16)>, sizes: [u16; 4], rcan: [u8; 4], maps: bool,
        passes: Option<(u8, u8, u16, u16, i16)>,
    ) {
        let bank = Bank {
            tile, step, channels,
            taps: taps.into_iter().map(|(channel, dy, dx)| Tap { channel, dy, dx }).collect(),
            blocks: blocks.map(|(side, count)| Blocks { side, count }),
        };
        let [width, groups, blocks, reduction] = rcan;
        let [frame, object] = [[sizes[0], sizes[1]], [sizes[2], sizes[3]]].map(|[rows, cols]| Size { rows, cols });
        let mut header = header(bank, frame, object, Rcan { width, groups, blocks, reduction });
        header.sensor.has_offset_map = maps;
        header.passes = passes.map(|(later, terms, window, node_step, corner)| Passes {
            later, terms, window, node_step, corners: [Corner { row: corner, col: corner }].into_iter().collect(),
        });
        let _ = (header.check(), header.section_lens(), encoded_len(&header), Pipeline::plan(&header));
    }
}
