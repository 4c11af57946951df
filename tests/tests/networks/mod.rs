//! Networks with random weights, and frames for them.
#![allow(clippy::unwrap_used, dead_code)]

use half::f16;
use ommatidia_network::network_file::NetworkFile;
use ommatidia_session::rng;
use ommatidia_shared::blob::{
    Bank, Blocks, Corner, FeatureBits, Header, Integers, MemoryPlan, Passes, Rcan, Sensor, Size, Tap, WatchWeights,
    Watching, Weights,
};
use ommatidia_shared::image::Region;
use ommatidia_shared::nn::integer::{Channel, Convolutions};
use ommatidia_shared::pipeline::Pipeline;
use ommatidia_shared::watch::Statistic;
use rand::RngExt;
use rand::seq::SliceRandom;

/// Shape of a network.
#[derive(Clone, Copy, Debug)]
pub struct Shape {
    pub frame: [u16; 2],
    pub object: [u16; 2],
    pub tile: u16,
    pub step: u16,
    pub channels: u8,
    /// Offsets of the taps of each channel, in steps.
    pub taps: &'static [(i8, i8)],
    pub width: u8,
    pub groups: u8,
    pub blocks: u8,
    pub maps: bool,
    /// Kernels in space: side and number of blocks.
    pub kernels: Option<(u16, u16)>,
}

/// The paper's form: one tap a channel, one tile that holds the whole frame.
pub const DENSE: Shape = Shape {
    frame: [40, 52],
    object: [24, 36],
    tile: 64,
    step: 64,
    channels: 3,
    taps: &[(0, 0)],
    width: 8,
    groups: 2,
    blocks: 1,
    maps: true,
    kernels: None,
};

/// The sparse form: foci on several tiles, an object that no tile divides.
pub const TAPPED: Shape = Shape {
    frame: [50, 44],
    object: [38, 30],
    tile: 32,
    step: 16,
    channels: 2,
    taps: &[(-1, 0), (0, -1), (0, 0), (1, 1)],
    width: 6,
    groups: 1,
    blocks: 2,
    maps: false,
    kernels: None,
};

/// The pruned form: the dense one's kernels in space, a few blocks of lags each.
pub const PRUNED: Shape = Shape { kernels: Some((4, 90)), ..DENSE };

/// A network as thin as can be on a single column of tiles.
pub const THIN: Shape = Shape {
    frame: [61, 17],
    object: [60, 2],
    tile: 16,
    step: 8,
    channels: 1,
    taps: &[(0, 0)],
    width: 1,
    groups: 0,
    blocks: 0,
    maps: false,
    kernels: None,
};

/// The header of a network of this shape, its memory plan filled in.
pub fn header(shape: &Shape) -> Header {
    let tap = |channel: u8| shape.taps.iter().map(move |&(dy, dx)| Tap { channel, dy, dx });
    let mut header = Header {
        name: "random".try_into().unwrap(),
        checkpoint: "".try_into().unwrap(),
        frame: Size { rows: shape.frame[0], cols: shape.frame[1] },
        object: Size { rows: shape.object[0], cols: shape.object[1] },
        sensor: Sensor {
            black_level_dn: 64.0,
            saturation_dn: 4095,
            has_offset_map: shape.maps,
            has_gain_map: shape.maps,
        },
        bank: Bank {
            tile: shape.tile,
            step: shape.step,
            channels: shape.channels,
            taps: (0..shape.channels).flat_map(tap).collect(),
            blocks: shape.kernels.map(|(side, count)| Blocks { side, count }),
        },
        rcan: Rcan {
            width: shape.width,
            groups: shape.groups,
            blocks: shape.blocks,
            reduction: if shape.width.is_multiple_of(2) { 2 } else { shape.width },
        },
        memory: MemoryPlan { fast_bytes: 0, bulk_bytes: 0 },
        integers: None,
        passes: None,
        watch: None,
    };
    header.memory = Pipeline::plan(&header).unwrap();
    header
}

/// The same network with so many passes in all: four lenses, of which three reach beyond the frame, with maps that
/// vary.
pub fn with_passes(shape: &Shape, passes: u8, terms: u8) -> Header {
    let mut header = header(shape);
    let [rows, cols] = [0, 1].map(|axis| (shape.frame[axis] - shape.object[axis]) as i16);
    let corners = [[rows / 2, cols / 2], [-4, 3], [rows + 5, cols - 2], [rows / 2 - 3, cols + 7]];
    let corners = corners.into_iter().map(|[row, col]| Corner { row, col }).collect();
    header.passes = Some(Passes { later: passes - 1, terms, window: 5, node_step: 4, corners });
    header.memory = Pipeline::plan(&header).unwrap();
    header
}

/// The same network with a watch on three lenses, in blocks of this side.
#[allow(dead_code, reason = "not every test has such networks")]
pub fn with_watch(shape: &Shape, block: u8) -> Header {
    let watch = Watching { lenses: 3, block, black_dn: 64, least_light_dn: 1000.0, log_odds: 18.0 };
    Header { watch: Some(watch), ..header(shape) }
}

/// The same network with its convolutions in integers.
pub fn in_integers(shape: &Shape) -> Header {
    let mut header = header(shape);
    header.integers =
        Some(Integers { input_log2: 14, feature_log2: 11, output: 1.0e-6, features: FeatureBits::Sixteen });
    header.memory = Pipeline::plan(&header).unwrap();
    header
}

/// The same network with features of 8 bits.
#[allow(dead_code, reason = "not every test has such networks")]
pub fn in_bytes(shape: &Shape) -> Header {
    let mut header = header(shape);
    let features = FeatureBits::Eight;
    header.integers = Some(Integers { input_log2: 14, feature_log2: 5, output: 1.0e-4, features });
    header.memory = Pipeline::plan(&header).unwrap();
    header
}

/// A network file with weights drawn under `seed`: spectra like those of a narrow filter, layers that keep their scale.
pub fn network(shape: &Shape, seed: u64) -> NetworkFile {
    network_of(&header(shape), seed)
}

/// The same for a header of one's own.
pub fn network_of(header: &Header, seed: u64) -> NetworkFile {
    scaled(header, seed, [1.0; 3])
}

/// The same with the filters, all layers but the last, and the last layer times a factor each.
pub fn scaled(header: &Header, seed: u64, factors: [f32; 3]) -> NetworkFile {
    let lens = header.section_lens().unwrap();
    let draw = |what: &str, len: u64, centre: f32, spread: f32| -> Vec<f16> {
        let mut rng = rng::stream(seed, what, 0);
        (0..len).map(|_| f16::from_f32(centre + spread * rng.random_range(-1.0..1.0f32))).collect()
    };
    let layer = (3.0 / (9.0 * f32::from(header.rcan.width))).sqrt();
    let filters = draw("filters", lens.filters, 0.1 * factors[0], factors[0]);
    let index = index(&header.bank, &mut rng::stream(seed, "index", 0));
    let mut rcan = draw("rcan", lens.rcan, 0.0, layer * factors[1]);
    let last = rcan.len().saturating_sub(9 * usize::from(header.rcan.width) + 1);
    if header.integers.is_none() {
        rcan[last..].iter_mut().for_each(|w| *w = f16::from_f32(w.to_f32() / factors[1] * factors[2]));
    }
    let predictor = predictor(header, seed);
    let (maps, statistics) = watch(header, seed);
    let (integers, channels) = integers(header, seed, layer / 127.0 * factors[1]);
    let offset = draw("offset", lens.offset_dn, 0.0, 8.0);
    let gain = draw("gain", lens.inverse_gain, 1.0, 0.1);
    let weights = Weights {
        filters: &filters,
        index: &index,
        rcan: &rcan,
        offset_dn: header.sensor.has_offset_map.then_some(&offset),
        inverse_gain: header.sensor.has_gain_map.then_some(&gain),
        convolutions: header.integers.map(|_| Convolutions { weights: &integers, channels: &channels }),
        predictor: &predictor,
        watch: WatchWeights { maps: &maps, statistics: &statistics },
    };
    NetworkFile::new(header, &weights).unwrap()
}

/// Maps of random weights; statistics that a change of the light of half a frame takes far beyond their noise.
fn watch(header: &Header, seed: u64) -> (Vec<i16>, Vec<Statistic>) {
    let lens = header.section_lens().unwrap();
    let mut rng = rng::stream(seed, "watch", 0);
    let maps = (0..lens.watch).map(|_| rng.random_range(-32_768..=32_767_i16)).collect();
    let statistic = |_| Statistic { scale: rng.random_range(2e-5..4e-5f32), shot: 1.0, reading: 50.0, specimens: 1e-3 };
    let statistics = (0..lens.statistics / 8).map(statistic).collect();
    (maps, statistics)
}

/// The model of the PSFs of a network with several passes: coefficients of either sign, and light that adds up to 1.
fn predictor(header: &Header, seed: u64) -> Vec<f16> {
    let Some(passes) = &header.passes else { return Vec::new() };
    let maps: usize = passes.nodes(header.object).iter().product();
    let term = passes.term_len(header.object) as usize;
    let lags = f32::from(passes.window).powi(2) * f32::from(passes.terms);
    let most = f32::from(passes.tile(header.object).unwrap()) / lags;
    let mut rng = rng::stream(seed, "predictor", 0);
    let number = |i: usize| {
        if i % term < maps { rng.random_range(-0.5..1.0f32) } else { most * rng.random_range(-0.2..1.0f32) }
    };
    (0..header.section_lens().unwrap().predictor as usize).map(number).map(f16::from_f32).collect()
}

/// Integer weights of every size and channels whose weights are worth about `scale` each; biases of up to a few units
/// of the features. Empty where the convolutions of the header are halves.
fn integers(header: &Header, seed: u64, scale: f32) -> (Vec<u16>, Vec<Channel>) {
    let lens = header.section_lens().unwrap();
    let mut rng = rng::stream(seed, "integers", 0);
    let byte = |rng: &mut _| RngExt::random_range(rng, -128..=127_i8) as u8;
    let weights = (0..lens.integers).map(|_| u16::from_le_bytes([byte(&mut rng), byte(&mut rng)])).collect();
    let channel = |_| {
        let multiplier = (f64::from(scale * rng.random_range(0.5..1.5f32)) * 2f64.powi(32)).min(f64::from(i32::MAX));
        Channel { bias: rng.random_range(-2_000_000..=2_000_000), multiplier: multiplier as i32 }
    };
    let mut channels: Vec<Channel> = (0..lens.channels / 4).map(channel).collect();
    if header.integers.is_some_and(|integers| integers.features == FeatureBits::Eight) {
        // Sums of the first layer, whose input has 16 bits, are 2^9 units of a feature times those of the others.
        for (i, channel) in channels.iter_mut().enumerate() {
            channel.bias >>= 8;
            channel.multiplier >>= if i < usize::from(header.rcan.width) { 9 } else { 0 };
        }
    }
    (weights, channels)
}

/// Where the blocks of a bank lie: drawn from all places alike.
fn index(bank: &Bank, rng: &mut impl rand::Rng) -> Vec<u16> {
    let Some(blocks) = bank.blocks else { return Vec::new() };
    let across = blocks.across(bank.tile);
    let mut places: Vec<usize> = (0..usize::from(bank.channels) * across * across).collect();
    places.shuffle(rng);
    places.truncate(blocks.count.into());
    places.sort_unstable();
    let before = |row: usize| places.partition_point(|place| place / across < row) as u16;
    let starts = (0..=usize::from(bank.channels) * across).map(before);
    starts.chain(places.iter().map(|place| (place % across) as u16)).collect()
}

/// Raw frames, 12-bit codes.
pub fn frames(shape: &Shape, count: u64, seed: u64) -> Vec<Vec<u16>> {
    let pixels = usize::from(shape.frame[0]) * usize::from(shape.frame[1]);
    let frame = |i| {
        let mut rng = rng::stream(seed, "frame", i);
        (0..pixels).map(|_| rng.random_range(40..=4095u16)).collect()
    };
    (0..count).map(frame).collect()
}

/// A region of an object.
pub fn cut(object: &[f16], shape: &Shape, region: Region) -> Vec<f16> {
    let [first, len, cols] = [region.col, region.cols, shape.object[1]].map(usize::from);
    let rows = (region.row..region.row + region.rows).map(usize::from);
    rows.flat_map(|row| &object[row * cols + first..][..len]).copied().collect()
}
