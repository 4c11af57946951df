//! The kernels on the workstation, each beside a peer or beside its own portable form, in one run.
//!
//! `cargo bench -p ommatidia-tests`. Figures of one run are comparable with each other only.
#![allow(clippy::unwrap_used, missing_docs)]

use criterion::{Criterion, criterion_group, criterion_main};
use half::f16;
use ommatidia_physics::fft2::RealFft2;
use ommatidia_session::rng;
use ommatidia_shared::blob::{Bank, Size, Tap};
use ommatidia_shared::filter::{FilterBank, Filters, FrameRows};
use ommatidia_shared::image::{Chw, ChwMut};
use ommatidia_shared::nn::activation::Activation;
use ommatidia_shared::nn::conv::{Conv3x3, Parameters, Store, Tensors};
use ommatidia_shared::num::simd::Simd;
use rand::RngExt;
use std::hint::black_box;

fn random(what: &str, len: usize) -> Vec<f32> {
    let mut rng = rng::stream(1, what, 0);
    (0..len).map(|_| rng.random_range(-1.0..1.0f32)).collect()
}

fn halves(what: &str, len: usize) -> Vec<f16> {
    random(what, len).into_iter().map(f16::from_f32).collect()
}

struct Frame(Vec<f32>, usize);

impl FrameRows for Frame {
    fn load(&self, row: usize, first: usize, to: &mut [f32]) {
        to.copy_from_slice(&self.0[row * self.1 + first..][..to.len()]);
    }
}

/// The demo's dense filter bank, 214 x 214 -> 6 x 96 x 96 by transforms of 256 x 256: halves stored, against realfft in
/// single precision.
fn filter_bank(c: &mut Criterion) {
    const T: usize = 256;
    const CHANNELS: usize = 6;
    let bank = Bank {
        tile: T as u16,
        step: T as u16,
        channels: CHANNELS as u8,
        taps: (0..CHANNELS as u8).map(|channel| Tap { channel, dy: 0, dx: 0 }).collect(),
        blocks: None,
    };
    let plan = FilterBank::new(&bank, Size { rows: 214, cols: 214 }, Size { rows: 96, cols: 96 }).unwrap();
    let frame = Frame(random("frame", 214 * 214), 214);
    let spectra = halves("spectra", plan.spectrum_len() * usize::from(bank.channels));
    let mut output = vec![f16::ZERO; plan.output_len()];
    let mut arena = vec![f16::ZERO; plan.arena_len()];
    let mut scratch = vec![0.0; plan.scratch_len_wide()];
    let mut group = c.benchmark_group("filter bank 256, 6 channels");
    group.bench_function("shared", |b| {
        b.iter(|| {
            let output = ChwMut::new(&mut output, CHANNELS, 96, 96).unwrap();
            let filters = Filters { halves: &spectra, index: &[] };
            plan.process(Simd::detect(), Some(black_box(&frame)), filters, output, &mut arena, &mut scratch).unwrap();
        });
    });
    let fft = RealFft2::new(T, T);
    let filters: Vec<_> = (0..CHANNELS)
        .map(|i| {
            let mut filter = vec![Default::default(); fft.spectrum_len()];
            fft.forward(&random(&format!("filter {i}"), T * T), &mut filter, &mut fft.scratch());
            filter
        })
        .collect();
    let (mut image, mut spectrum) = (random("padded", T * T), vec![Default::default(); fft.spectrum_len()]);
    let mut product = spectrum.clone();
    let mut work = fft.scratch();
    group.bench_function("realfft, single precision", |b| {
        b.iter(|| {
            fft.forward(black_box(&image), &mut spectrum, &mut work);
            for filter in &filters {
                product.iter_mut().zip(&spectrum).zip(filter).for_each(|((p, s), f)| *p = s * f);
                fft.inverse(&product, &mut image, &mut work);
            }
            image.iter_mut().for_each(|v| *v = v.clamp(-1.0, 1.0));
        });
    });
    group.finish();
}

/// 3 x 3 convolution 32 -> 32 at 64 x 64: with the vectors of this machine, and in portable code; the same bits.
fn convolution(c: &mut Criterion) {
    let plan =
        Conv3x3 { inputs: 32, outputs: 32, rows: 64, cols: 64, activation: Activation::Relu, store: Store::Replace };
    let (weights, bias) = (halves("weights", plan.weights_len()), halves("bias", 32));
    let input = halves("input", 32 * 64 * 64);
    let mut output = vec![f16::ZERO; 32 * 64 * 64];
    let mut scratch = vec![0.0; plan.scratch_len(64)];
    let mut group = c.benchmark_group("conv 3x3 32->32, 64x64");
    for (name, simd) in [("shared", Simd::detect()), ("shared, portable", Simd::PORTABLE)] {
        group.bench_function(name, |b| {
            b.iter(|| {
                let tensors = Tensors::Apart {
                    input: Chw::new(black_box(&input), 32, 64, 64).unwrap(),
                    output: ChwMut::new(&mut output, 32, 64, 64).unwrap(),
                };
                plan.process(simd, Parameters { weights: &weights, bias: &bias }, tensors, &mut scratch).unwrap();
            });
        });
    }
    group.finish();
}

criterion_group!(benches, filter_bank, convolution);
criterion_main!(benches);
