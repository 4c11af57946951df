//! Runs each operator once between two markers, for the instruction counter of the host (`ommatidia device bench`).
//!
//! Prints a line a region: its name, how much work it is, and the unit of the work. Data are pseudo-random; the counts
//! do not depend on them.
#![no_std]
#![no_main]

use core::convert::Infallible;
use core::fmt::Arguments;
use core::hint::black_box;
use cortex_m_semihosting::hprintln;
use half::f16;
use ommatidia_firmware::app::{region_begins, region_ends};
use ommatidia_firmware::board::this as board;
use ommatidia_shared::blob::{
    Bank, Blocks, Corner, FeatureBits, Header, Integers, MemoryPlan, Network, Passes, Rcan, Sensor, Size, Tap, Weights,
};
use ommatidia_shared::fft::{Fft, Fft2, ProductSource, RowSource};
use ommatidia_shared::image::{Chw, ChwMut, PlaneMut, Region};
use ommatidia_shared::nn::activation::Activation;
use ommatidia_shared::nn::channel_attention::{self, ChannelAttention};
use ommatidia_shared::nn::conv::{self, Conv3x3, Store, Tensors};
use ommatidia_shared::nn::integer::{self, Channel, Convolution, Convolutions, Feature, Last};
use ommatidia_shared::nn::upscale::Upscale;
use ommatidia_shared::num::pairs::add_products;
use ommatidia_shared::num::simd::Simd;
use ommatidia_shared::num::{fused, narrow, narrow_slice, widen_slice};
use ommatidia_shared::pipeline::{Field, Memory, Pipeline};
use ommatidia_shared::predict::Predictor;
use ommatidia_shared::watch::{self, Maps, Statistic, Watch};

/// Why the program ends without counts.
type Failure = &'static str;

/// The convolution that reads through the pixel unshuffle.
const UNSHUFFLED: &str = " of the unshuffled";

/// Memory of the operators.
struct Bench {
    fast: &'static mut [f32],
    bulk: &'static mut [f16],
    weights: &'static mut [f16],
    frame: &'static mut [u16],
    object: &'static mut [f16],
}

#[cortex_m_rt::entry]
fn main() -> ! {
    let Some(parts) = board::take() else { board::fail(&"the board is taken") };
    let mut bench = Bench {
        fast: parts.arenas.fast,
        bulk: parts.arenas.bulk,
        weights: bytemuck::cast_slice_mut(parts.flash.into_memory()),
        frame: parts.source.into_memory(),
        object: parts.object,
    };
    fill(bench.bulk, 1, 1.0);
    fill(bench.weights, 2, 0.1);
    for (i, code) in bench.frame.iter_mut().enumerate() {
        *code = 64 + (i * 7919 % 4000) as u16;
    }
    match bench.run() {
        Ok(()) => board::exit(),
        Err(error) => board::fail(&error),
    }
}

/// Fills a slice with pseudo-random halves from -`scale` to `scale`.
fn fill(halves: &mut [f16], seed: u32, scale: f32) {
    let mut state = seed;
    for half in halves {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        *half = narrow(((state >> 8) as f32 / 8_388_608.0 - 1.0) * scale);
    }
}

/// Marks the beginning and the end of `work` for the instruction counter.
fn region<T, E>(
    name: Arguments<'_>,
    amount: usize,
    unit: &str,
    work: impl FnOnce() -> Result<T, E>,
) -> Result<(), Failure> {
    hprintln!("{}\t{}\t{}", name, amount, unit);
    region_begins();
    let result = black_box(work());
    region_ends();
    result.map(|_| ()).map_err(|_| "an operator refused its input")
}

/// Rows of a plane of halves.
struct Rows<'a>(&'a [f16]);

impl RowSource for Rows<'_> {
    fn load(&self, row: usize, to: &mut [f32]) {
        widen_slice(&self.0[row * to.len()..][..to.len()], to);
    }
}

/// A spectrum times a filter.
struct Product<'a>(&'a [f16], &'a [f16]);

impl ProductSource for Product<'_> {
    fn count(&self) -> usize {
        1
    }

    fn product(&self, _: usize) -> Option<[&[f16]; 2]> {
        Some([self.0, self.1])
    }
}

impl Bench {
    fn run(&mut self) -> Result<(), Failure> {
        for side in [64, 128, 256] {
            self.transform(side)?;
        }
        for len in [64, 256] {
            self.butterflies(len)?;
        }
        self.product(256)?;
        let (linear, relu, replace, add) = (Activation::Linear, Activation::Relu, Store::Replace, Store::Accumulate);
        for channels in [16, 32] {
            self.convolve("", [channels, channels], (linear, replace))?;
            self.convolve(" and ReLU", [channels, channels], (relu, replace))?;
            self.convolve(" and skip", [channels, channels], (linear, add))?;
            self.attend(channels)?;
            self.tail(channels)?;
        }
        for channels in [16, 32] {
            self.convolve_integers::<i16>("in integers", channels, replace)?;
            self.convolve_integers::<i16>("in integers", channels, add)?;
            self.tail_integers::<i16>("in integers", channels)?;
            self.convolve_integers::<i8>("in bytes", channels, replace)?;
            self.convolve_integers::<i8>("in bytes", channels, add)?;
            self.tail_integers::<i8>("in bytes", channels)?;
        }
        self.convolve(UNSHUFFLED, [24, 16], (linear, replace))?;
        self.convert()?;
        self.fused()?;
        self.predict()?;
        self.watch()?;
        self.reconstruct()
    }

    /// Forward, and forward + filter + inverse, of a plane of side T.
    fn transform(&mut self, side: usize) -> Result<(), Failure> {
        let fft = Fft2::new(side).map_err(|_| "no transform of that side")?;
        let (plane, rest) = self.bulk.split_at_mut(side * side);
        let (spectrum, rest) = rest.split_at_mut(fft.spectrum_len(side));
        let (halfway, out) = rest.split_at_mut(fft.spectrum_len(side));
        let filter = &self.weights[..fft.spectrum_len(side)];
        let (simd, scratch) = (Simd::detect(), &mut *self.fast);
        let pixels = side * side;
        region(format_args!("2-D real FFT {side}x{side}, forward"), pixels, "px", || {
            fft.forward(simd, &Rows(plane), 0..side, spectrum, scratch)
        })?;
        region(format_args!("2-D real FFT {side}x{side}, filter, inverse"), pixels, "px", || {
            fft.forward(simd, &Rows(plane), 0..side, spectrum, scratch)?;
            fft.inverse(simd, &Product(spectrum, filter), 0..side, halfway, scratch, &mut |row, values| {
                narrow_slice(values, &mut out[row * side..][..side]);
            })
        })
    }

    /// The transform of a single column, in fast memory: `len / 4` butterflies of four numbers a pass.
    fn butterflies(&mut self, len: usize) -> Result<(), Failure> {
        let fft = Fft::new(len).map_err(|_| "no transform of that length")?;
        let data = self.fast[..2 * len].as_chunks_mut::<1>().0.as_chunks_mut::<2>().0;
        let count = len / 4 * (len.trailing_zeros() / 2) as usize;
        region(format_args!("complex FFT {len}, in place"), count, "radix-4 butterflies", || {
            fft.process(data);
            Ok::<_, Infallible>(())
        })
    }

    /// A column of the spectrum times one of a filter, added to a sum.
    fn product(&mut self, len: usize) -> Result<(), Failure> {
        let stride = 2 * (len / 2 + 1);
        let (k, x) = (&self.weights[..len * stride], &self.bulk[..len * stride]);
        let sums = self.fast[..2 * len].as_chunks_mut::<2>().0;
        region(format_args!("filter times spectrum, a column of {len}"), 4 * len, "MAC", || {
            add_products(k, x, stride, sums);
            Ok::<_, Infallible>(())
        })
    }

    /// 3x3, on the 48 x 48 features of a 96 x 96 object.
    fn convolve(
        &mut self,
        what: &str,
        [inputs, outputs]: [usize; 2],
        (activation, store): (Activation, Store),
    ) -> Result<(), Failure> {
        let (rows, cols) = (48, 48);
        let conv = Conv3x3 { inputs, outputs, rows, cols, activation, store };
        let (weights, rest) = self.weights.split_at(conv.weights_len());
        let parameters = conv::Parameters { weights, bias: &rest[..outputs] };
        let (input, rest) = self.bulk.split_at_mut(inputs * rows * cols);
        let output = ChwMut::new(&mut rest[..outputs * rows * cols], outputs, rows, cols);
        let output = output.map_err(|_| "a shape is wrong")?;
        let tensors = if what == UNSHUFFLED {
            let input = Chw::new(input, inputs / 4, 2 * rows, 2 * cols).map_err(|_| "a shape is wrong")?;
            Tensors::Unshuffled { input, output }
        } else {
            Tensors::Apart { input: Chw::new(input, inputs, rows, cols).map_err(|_| "a shape is wrong")?, output }
        };
        let scratch = &mut *self.fast;
        let products = 9 * inputs * outputs * rows * cols;
        region(format_args!("3x3 convolution {inputs}->{outputs}{what}, {rows}x{cols}"), products, "MAC", || {
            conv.process(Simd::detect(), parameters, tensors, scratch)
        })
    }

    /// The same with weights of 8 bits and features in integers.
    fn convolve_integers<F: Feature>(&mut self, kind: &str, channels: usize, store: Store) -> Result<(), Failure> {
        let (rows, cols) = (48, 48);
        let (inputs, outputs, activation) = (channels, channels, Activation::Linear);
        let conv = Conv3x3 { inputs, outputs, rows, cols, activation, store };
        let bytes: &[i8] = bytemuck::cast_slice(self.weights);
        let own = Convolution { weights: &bytes[..conv.weights_len()], channels: &CHANNELS[..outputs] };
        let (input, rest) = bytemuck::cast_slice_mut::<_, F>(self.bulk).split_at_mut(inputs * rows * cols);
        let output = ChwMut::new(&mut rest[..outputs * rows * cols], outputs, rows, cols);
        let input = Chw::new(&*input, inputs, rows, cols).map_err(|_| "a shape is wrong")?;
        let tensors = Tensors::Apart { input, output: output.map_err(|_| "a shape is wrong")? };
        let scratch = &mut *self.fast;
        let what = if store == Store::Accumulate { " and skip" } else { "" };
        let products = 9 * inputs * outputs * rows * cols;
        let name = format_args!("3x3 convolution {inputs}->{outputs}{what} {kind}, {rows}x{cols}");
        region(name, products, "MAC", || integer::process(&conv, Simd::detect(), own, 1.0, tensors, scratch))
    }

    /// The tail with weights of 8 bits and features in integers.
    fn tail_integers<F: Feature>(&mut self, kind: &str, channels: usize) -> Result<(), Failure> {
        let (rows, cols) = (48, 48);
        let plan = Upscale { channels, rows, cols, end: Activation::Sigmoid };
        let bytes: &[i8] = bytemuck::cast_slice(self.weights);
        let (weights, rest) = bytes.split_at(36 * channels * channels);
        let convolutions = [
            Convolution { weights, channels: &CHANNELS[..4 * channels] },
            Convolution { weights: &rest[..9 * channels], channels: &CHANNELS[..1] },
        ];
        let input = bytemuck::cast_slice::<_, F>(self.bulk);
        let input = Chw::new(&input[..channels * rows * cols], channels, rows, cols);
        let input = input.map_err(|_| "a shape is wrong")?;
        let output = PlaneMut::new(&mut self.object[..4 * rows * cols], 2 * rows, 2 * cols);
        let output = output.map_err(|_| "a shape is wrong")?;
        let scratch = &mut *self.fast;
        let products = (36 * channels * channels + 36 * channels) * rows * cols;
        let last = Last { convolutions, unit: 1.0e-9 };
        let size = 2 * rows;
        let name = format_args!("pixel shuffle {channels}->1 with its convolutions {kind}, to {size}x{size}");
        region(name, products, "MAC", || integer::upscale(&plan, Simd::detect(), last, input, [0, 0], output, scratch))
    }

    /// Convolution to 4 W channels, pixel shuffle, convolution to one channel, sigmoid.
    fn tail(&mut self, channels: usize) -> Result<(), Failure> {
        let (rows, cols) = (48, 48);
        let plan = Upscale { channels, rows, cols, end: Activation::Sigmoid };
        let (weights, rest) = self.weights.split_at(36 * channels * channels);
        let (weights2, rest) = rest.split_at(9 * channels);
        let parameters = [
            conv::Parameters { weights, bias: &rest[..4 * channels] },
            conv::Parameters { weights: weights2, bias: &rest[..1] },
        ];
        let input = Chw::new(&self.bulk[..channels * rows * cols], channels, rows, cols);
        let input = input.map_err(|_| "a shape is wrong")?;
        let output = PlaneMut::new(&mut self.object[..4 * rows * cols], 2 * rows, 2 * cols);
        let output = output.map_err(|_| "a shape is wrong")?;
        let scratch = &mut *self.fast;
        let products = (36 * channels * channels + 36 * channels) * rows * cols;
        region(
            format_args!("pixel shuffle {channels}->1 with its convolutions, to {}x{}", 2 * rows, 2 * cols),
            products,
            "MAC",
            || plan.process(Simd::detect(), parameters, input, [0, 0], output, scratch),
        )
    }

    /// Channel attention with a bottleneck of C / 8.
    fn attend(&mut self, channels: usize) -> Result<(), Failure> {
        let (rows, cols, hidden) = (48, 48, channels / 8);
        let attention = ChannelAttention { channels, hidden, rows, cols };
        let (squeeze, rest) = self.weights.split_at(channels * hidden);
        let (excite, rest) = rest.split_at(channels * hidden);
        let parameters = channel_attention::Parameters {
            squeeze,
            excite,
            squeeze_bias: &rest[..hidden],
            excite_bias: &rest[hidden..hidden + channels],
        };
        let input =
            Chw::new(&self.bulk[..channels * rows * cols], channels, rows, cols).map_err(|_| "a shape is wrong")?;
        let (scale, scratch) = self.fast.split_at_mut(channels);
        let halves = channels * rows * cols;
        region(format_args!("channel attention, {channels} channels, {rows}x{cols}"), halves, "halves", || {
            attention.process(Simd::detect(), parameters, input, scale, scratch)
        })
    }

    fn convert(&mut self) -> Result<(), Failure> {
        const LEN: usize = 1024;
        let (halves, floats) = (&mut self.bulk[..LEN], &mut self.fast[..LEN]);
        region(format_args!("f16 to f32, {LEN}"), LEN, "halves", || {
            widen_slice(black_box(halves), floats);
            Ok::<_, Infallible>(())
        })?;
        region(format_args!("f32 to f16, {LEN}"), LEN, "halves", || {
            narrow_slice(black_box(floats), halves);
            Ok::<_, Infallible>(())
        })
    }

    /// Loops that convert while they load or store.
    fn fused(&mut self) -> Result<(), Failure> {
        const LEN: usize = 1024;
        let (t, g) = self.bulk[..2 * LEN].split_at_mut(LEN);
        let (sums, rest) = self.fast.split_at_mut(LEN);
        let sums = &*sums;
        let count = |name: &str, work: &mut dyn FnMut()| {
            region(format_args!("{name}, {LEN}"), LEN, "numbers", || {
                work();
                Ok::<_, Infallible>(())
            })
        };
        count("ReLU at the store", &mut || fused::narrow_relu(sums, g))?;
        count("skip at the store", &mut || fused::accumulate(sums, g))?;
        count("attention times features and skip", &mut || fused::add_scaled(0.7, t, g))?;
        count("pixel unshuffle at the load", &mut || fused::widen_alternate(&t[..LEN], 1, &mut rest[..LEN / 2]))?;
        count("pixel shuffle at the store", &mut || {
            fused::round_interleaved(&sums[..LEN / 2], &sums[LEN / 2..], &mut rest[..LEN]);
        })
    }

    /// The presets of the host's `train`, on a 214 x 214 sensor with its maps and a 96 x 96 object; of the first one
    /// regions too.
    fn reconstruct(&mut self) -> Result<(), Failure> {
        let rcan = |width, blocks, reduction| Rcan { width, groups: 2, blocks, reduction };
        let nano = header(6, rcan(16, 1, 8));
        self.network("nano", &nano, &[48, 16])?;
        self.network("nano, two passes", &Header { passes: Some(passes()), ..nano.clone() }, &[])?;
        let blocks = Some(Blocks { side: 4, count: (KERNELS * KERNEL_BLOCKS) as u16 });
        let pruned = Header { bank: Bank { blocks, ..nano.bank.clone() }, ..nano.clone() };
        let integers = |header: &Header| Header { integers: Some(SCALES), ..header.clone() };
        self.network("nano, in integers", &integers(&nano), &[])?;
        let bytes = Integers { features: FeatureBits::Eight, feature_log2: 3, ..SCALES };
        self.network("nano, in bytes", &Header { integers: Some(bytes), ..nano.clone() }, &[])?;
        self.network("nano, filters pruned", &pruned, &[])?;
        self.network("nano, filters pruned, two passes", &Header { passes: Some(passes()), ..pruned.clone() }, &[])?;
        self.network("nano, filters pruned, in integers", &integers(&pruned), &[])?;
        self.network("lite", &header(9, rcan(24, 2, 12)), &[])?;
        self.network("lite, in integers", &integers(&header(9, rcan(24, 2, 12))), &[])?;
        self.network("paper", &header(9, rcan(32, 3, 16)), &[])?;
        self.network("paper, in integers", &integers(&header(9, rcan(32, 3, 16))), &[])
    }

    /// The frame of an object, as a later pass predicts it.
    fn predict(&mut self) -> Result<(), Failure> {
        let (passes, size) = (passes(), |side| Size { rows: side, cols: side });
        let plan = Predictor::new(&passes, size(214), size(96)).map_err(|_| "the prediction is refused")?;
        let len = passes.corners.len() * usize::from(passes.terms) * passes.term_len(size(96)) as usize;
        let (frame, rest) = self.bulk.split_at_mut(plan.frame_len());
        let (object, arena) = rest.split_at_mut(96 * 96);
        let (model, scratch) = (&self.weights[..len], &mut *self.fast);
        let images = format_args!("frame of 9 lenses, 4 terms each, of 96x96 px");
        region(images, frame.len(), "px", || plan.process(Simd::detect(), model, object, frame, arena, scratch))
    }

    /// The watch on the optics of nine lenses, for a frame.
    fn watch(&mut self) -> Result<(), Failure> {
        let (frame, block) = (Size { rows: 214, cols: 214 }, 10);
        let statistics = [Statistic { scale: 1e-6, shot: 1.0, reading: 1.0, specimens: 0.1 }; 27];
        let len = watch::blocks(frame, block).iter().product::<usize>() * Maps::weights_of_block(statistics.len());
        let weights = bytemuck::cast_slice(&self.weights[..len]);
        let (statistics, least_light_dn) = (&statistics[..], 1.0);
        let maps = Maps { frame, block, black_dn: 64, least_light_dn, log_odds: 18.0, weights, statistics };
        let (mut watch, codes) = (Watch::new(), &self.frame[..214 * 214]);
        region(format_args!("watch on 9 lenses, 214x214 px"), codes.len(), "px", || {
            watch.see(black_box(&maps), codes, 0, 1);
            Ok::<_, Infallible>(watch.report(&maps))
        })
    }

    /// A network on a whole frame, then for squares of these sides in the middle alone.
    fn network(&mut self, name: &str, header: &Header, sides: &[u16]) -> Result<(), Failure> {
        let mut header = header.clone();
        header.memory = Pipeline::plan(&header).map_err(|_| "the header has no plan")?;
        let lens = header.section_lens().map_err(|_| "the header is refused")?;
        let (filters, rest) = self.weights.split_at(lens.filters as usize);
        let index = &INDEX[..lens.index as usize];
        let (rcan, rest) = rest.split_at(lens.rcan as usize);
        let (offset, rest) = rest.split_at(214 * 214);
        let weights = Weights {
            filters,
            index,
            rcan,
            offset_dn: Some(offset),
            inverse_gain: Some(&rest[..214 * 214]),
            convolutions: header.integers.map(|_| Convolutions {
                weights: bytemuck::cast_slice(&filters[..lens.integers as usize]),
                channels: &CHANNELS[..lens.channels as usize / 4],
            }),
            predictor: &rest[..lens.predictor as usize],
            watch: Default::default(),
        };
        let network = Network::new(header, weights).map_err(|_| "the weights are refused")?;
        let pipeline = Pipeline::new(&network).map_err(|_| "the network is refused")?;
        let frame = &self.frame[..pipeline.frame_len()];
        let (fast, scales) = self.fast.split_at_mut(self.fast.len() - pipeline.scales_len());
        let mut part = |what: Arguments<'_>, part: Region, field: Field<'_>| {
            let memory = Memory { fast: &mut *fast, bulk: &mut *self.bulk };
            let object = &mut self.object[..part.pixels()];
            let mut saw = Err("it did not run");
            region(what, part.pixels(), "px", || {
                let run = pipeline.run_with(frame, part, field, memory, object);
                run.map(|stats| saw = Ok(stats))
            })?;
            saw
        };
        let field = Field::Measured((pipeline.passes() == 1).then_some(&mut *scales));
        let whole = part(format_args!("whole `{name}` network, 214x214 px to 96x96 px"), pipeline.whole(), field)?;
        for &side in sides {
            let first = (96 - side) / 2;
            let middle = Region { row: first, col: first, rows: side, cols: side };
            let exact = format_args!("`{name}` network, {side}x{side} px in the middle alone");
            part(exact, middle, Field::Measured(None))?;
            let held = format_args!("`{name}` network, {side}x{side} px in the middle, field held");
            part(held, middle, Field::Held(whole, scales))?;
        }
        Ok(())
    }
}

/// A second pass, with nine lenses as the demo's instrument has them.
fn passes() -> Passes {
    let corner = |lens: i16| Corner { row: 9 + 50 * (lens / 3), col: 9 + 50 * (lens % 3) };
    Passes { later: 1, terms: 4, window: 21, node_step: 8, corners: (0..9).map(corner).collect() }
}

/// Scales of the networks in integers.
const SCALES: Integers = Integers { input_log2: 12, feature_log2: 10, output: 1.0e-6, features: FeatureBits::Sixteen };
/// Output channels of the convolutions in integers.
static CHANNELS: [Channel; 1024] = [Channel { bias: 1000, multiplier: 1 << 22 }; 1024];

/// Kernels of `nano`, and blocks of 4 x 4 lags that each keeps at a tenth of the bytes; 16 in each of 24 rows that are
/// spread over three quarters of the kernel, about as in a trained network.
const KERNELS: usize = 6;
const KERNEL_BLOCKS: usize = 384;
const INDEX: [u16; KERNELS * 64 + 1 + KERNELS * KERNEL_BLOCKS] = {
    let mut index = [0; KERNELS * 64 + 1 + KERNELS * KERNEL_BLOCKS];
    let (mut row, mut count) = (0, 0);
    while row < KERNELS * 64 {
        if row % 2 == 0 && row % 64 >= 8 && row % 64 < 56 {
            let mut block = 0;
            while block < 16 {
                index[KERNELS * 64 + 1 + count] = 4 * block as u16;
                (block, count) = (block + 1, count + 1);
            }
        }
        row += 1;
        index[row] = count as u16;
    }
    assert!(count == KERNELS * KERNEL_BLOCKS);
    index
};

fn header(channels: u8, rcan: Rcan) -> Header {
    Header {
        name: Default::default(),
        checkpoint: Default::default(),
        frame: Size { rows: 214, cols: 214 },
        object: Size { rows: 96, cols: 96 },
        sensor: Sensor { black_level_dn: 64.0, saturation_dn: 4095, has_offset_map: true, has_gain_map: true },
        bank: Bank {
            tile: 256,
            step: 256,
            channels,
            taps: (0..channels).map(|channel| Tap { channel, dy: 0, dx: 0 }).collect(),
            blocks: None,
        },
        rcan,
        memory: MemoryPlan { fast_bytes: 0, bulk_bytes: 0 },
        integers: None,
        passes: None,
        watch: None,
    }
}
