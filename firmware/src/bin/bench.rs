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
use ommatidia_firmware::board::mps2_an500 as board;
use ommatidia_shared::blob::{Bank, Header, MemoryPlan, Rcan, Sensor, Size, Tap, Weights};
use ommatidia_shared::fft::{Fft2, RowSource, Strip, StripSource};
use ommatidia_shared::image::{Chw, ChwMut};
use ommatidia_shared::nn::activation::Activation;
use ommatidia_shared::nn::channel_attention::{self, ChannelAttention};
use ommatidia_shared::nn::conv::{self, Addressing, Conv3x3, Store, Tensors};
use ommatidia_shared::num::simd::Simd;
use ommatidia_shared::num::{narrow, narrow_slice, widen_slice};
use ommatidia_shared::pipeline::{Memory, Pipeline};

/// Why there is no count.
type Failure = &'static str;

/// Memory to work in.
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
        weights: bytemuck::cast_slice_mut(parts.blob),
        frame: parts.frame,
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

/// Halves from -`scale` to `scale`.
fn fill(halves: &mut [f16], seed: u32, scale: f32) {
    let mut state = seed;
    for half in halves {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        *half = narrow(((state >> 8) as f32 / 8_388_608.0 - 1.0) * scale);
    }
}

/// Counts what `work` does.
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

impl StripSource for Product<'_> {
    #[inline(always)]
    fn add<const L: usize>(&self, mut strip: Strip<'_, L>) {
        strip.add_product(self.0, self.1);
    }
}

impl Bench {
    fn run(&mut self) -> Result<(), Failure> {
        for side in [64, 128, 256] {
            self.transform(side)?;
        }
        for channels in [16, 32] {
            self.convolve(channels)?;
            self.attend(channels)?;
        }
        self.convert()?;
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
            fft.inverse(simd, &Product(spectrum, filter), 0..side, halfway, scratch, |row, values| {
                narrow_slice(values, &mut out[row * side..][..side]);
            })
        })
    }

    /// 3x3, C -> C, on the 48 x 48 features of a 96 x 96 object.
    fn convolve(&mut self, channels: usize) -> Result<(), Failure> {
        let (rows, cols) = (48, 48);
        let (activation, store) = (Activation::Linear, Store::Replace);
        let conv = Conv3x3 { inputs: channels, outputs: channels, rows, cols, activation, store };
        let (weights, rest) = self.weights.split_at(conv.weights_len());
        let parameters = conv::Parameters { weights, bias: &rest[..channels] };
        let len = channels * rows * cols;
        let (input, rest) = self.bulk.split_at_mut(len);
        let input = Chw::new(input, channels, rows, cols).map_err(|_| "a shape is wrong")?;
        let output = ChwMut::new(&mut rest[..len], channels, rows, cols).map_err(|_| "a shape is wrong")?;
        let tensors = Tensors::Apart { input, addressing: Addressing::Direct, output };
        let scratch = &mut *self.fast;
        let products = 9 * channels * channels * rows * cols;
        region(format_args!("3x3 convolution {channels}->{channels}, {rows}x{cols}"), products, "MAC", || {
            conv.process(Simd::detect(), parameters, tensors, scratch)
        })
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

    /// The demo's network: 214 x 214 sensor, 96 x 96 object, six dense filters of side 256, 16 features.
    fn reconstruct(&mut self) -> Result<(), Failure> {
        let mut header = demo_header();
        header.memory = Pipeline::plan(&header).map_err(|_| "the header has no plan")?;
        let (spectra, rest) = self.weights.split_at(6 * 2 * 256 * 129);
        let count = ommatidia_shared::nn::rcan::weights_len(&header.rcan, header.bank.channels);
        let weights = Weights { spectra, rcan: &rest[..count], offset_dn: None, inverse_gain: None };
        let pipeline = Pipeline::new(&header, weights).map_err(|_| "the network is refused")?;
        let memory = Memory { fast: self.fast, bulk: self.bulk };
        let (frame, object) = (&self.frame[..pipeline.frame_len()], &mut self.object[..pipeline.output_len()]);
        let px = pipeline.output_len();
        region(format_args!("whole `nano` network, 214x214 px to 96x96 px"), px, "px", || {
            pipeline.run(frame, memory, object)
        })
    }
}

fn demo_header() -> Header {
    Header {
        name: Default::default(),
        checkpoint: Default::default(),
        frame: Size { rows: 214, cols: 214 },
        object: Size { rows: 96, cols: 96 },
        sensor: Sensor { black_level_dn: 64.0, saturation_dn: 4095, has_offset_map: false, has_gain_map: false },
        bank: Bank {
            tile: 256,
            step: 256,
            channels: 6,
            taps: (0..6).map(|channel| Tap { channel, dy: 0, dx: 0 }).collect(),
        },
        rcan: Rcan { width: 16, groups: 2, blocks: 1, reduction: 8 },
        memory: MemoryPlan { fast_bytes: 0, bulk_bytes: 0 },
    }
}
