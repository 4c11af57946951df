//! The float network at the published size, without burn's graph and with it: one frame of 2886 x 3500 pixels, nine
//! filters of 4200 x 4200, an object of 2400 x 2400 pixels.
//!
//! `cargo bench -p ommatidia-tests --bench network`. Figures of one run are comparable with each other only; all cores
//! are used. It takes some minutes and 4 GB of memory.
#![allow(clippy::unwrap_used, missing_docs)]

use criterion::{Criterion, criterion_group, criterion_main};
use ommatidia_network::train::network::values;
use ommatidia_network::train::ops::fourier::Fourier;
use ommatidia_network::train::{Inference, Mode, Network, NetworkConfig, NetworkInput, Preset, weights};
use std::hint::black_box;
use std::sync::Arc;

fn reconstruction(c: &mut Criterion) {
    let published = Preset::Paper.network([2886, 3500], [2400, 2400]);
    let config = NetworkConfig { filter_size: 4200, ..published };
    let tensors = weights::random(&config, 1);
    let frame: Vec<f32> = (0..config.frame[0] * config.frame[1]).map(|i| ((i * 7919) % 1013) as f32 / 1013.0).collect();
    let plan = Arc::new(Fourier::new(config.fourier()));
    let mut group = c.benchmark_group("float network at the published size");
    group.sample_size(10);
    let direct = Inference::new(&config, &tensors).unwrap();
    let got = direct.reconstruct(&frame, &[]);
    group.bench_function("without the graph", |b| b.iter(|| direct.reconstruct(black_box(&frame), &[])));
    drop(direct);
    let graph = Network::new(&config, &plan, &tensors, Mode::Infer).unwrap();
    let run = || values(graph.forward(vec![NetworkInput::of(&config, &plan, black_box(&frame))]).logits);
    let want = run().into_iter().map(|v| 1.0 / (1.0 + (-v).exp()));
    assert!(got.iter().zip(want).all(|(a, b)| (a - b).abs() < 1e-4), "the two outputs differ");
    group.bench_function("burn's graph", |b| b.iter(run));
    group.finish();
}

criterion_group!(benches, reconstruction);
criterion_main!(benches);
