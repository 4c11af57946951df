//! The low-rank forward operator (Eq. 3) at three sizes, beside the same sum done term by term with transforms of the
//! whole frame.
//!
//! `cargo bench -p ommatidia-tests --bench operator`. Figures of one run are comparable with each other only. The sum
//! is that of one lens with eight basis PSFs at each size: times the lenses and an eighth of the terms of an instrument
//! it is a frame. Then the sum of 32 terms of three lenses at the paper's size, with functions that the lenses share in
//! place of the terms of each.
#![allow(clippy::unwrap_used, missing_docs)]

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use ndarray::{Array2, Array4, Array5, s};
use ommatidia_model::instrument::{Diagnostics, Instrument, LightUnit, Quality};
use ommatidia_model::psf::nodes::{Taps, even_nodes};
use ommatidia_model::psf::{ChiefRays, LowRankOperator, LowRankPsf, OperatorConfig};
use ommatidia_physics::fft2::{RealFft2, fast_size};
use ommatidia_physics::noise::{NoiseModel, Sources};
use ommatidia_session::{ArrayGeometry, Manifest, ObjectGrid, Optics, SensorSpec};
use rustfft::num_complex::Complex32;
use std::hint::black_box;

const TERMS: usize = 8;
const NODES: usize = 13;

fn value(i: usize) -> f32 {
    ((i * 7919 + 31) % 997) as f32 / 997.0
}

/// A row of lenses before a sensor of the given size.
fn instrument(object: usize, sensor: [usize; 2], window: usize, [lenses, terms]: [usize; 2]) -> Instrument {
    let nodes = even_nodes(object, NODES);
    Instrument {
        manifest: Manifest {
            format: 1,
            name: "benchmark".into(),
            sensor: SensorSpec { rows: sensor[0], cols: sensor[1], pixel_pitch_um: 1.0, bit_depth: 12 },
            array: ArrayGeometry::grid(1, lenses, 1.0),
            optics: Optics { magnification: 1.0, psf_window_px: window, wavelength_um: None },
            object: ObjectGrid { rows: object, cols: object, pixel_um: 1.0 },
            stacks: Vec::new(),
        },
        noise: NoiseModel {
            black_level_dn: 64.0,
            gain_dn_per_e: 0.5,
            gain_sigma: 0.0,
            read_noise_e: 2.0,
            read_noise_sigma: 0.0,
            saturation_dn: 4095.0,
            sources: Sources::default(),
        },
        offset_dn: None,
        response: None,
        reading_dn2: None,
        geometry: ChiefRays {
            anchors_px: (0..lenses).map(|l| sensor.map(|n| (n as f64 - 1.0) / 2.0 + 100.0 * l as f64)).collect(),
            magnification: 1.0,
            dead: vec![false; lenses],
        },
        psf: LowRankPsf {
            basis: Array4::from_shape_fn((lenses, terms, window, window), |(l, k, r, c)| {
                value(((l * terms + k) * window + r) * window + c) - 0.3
            }),
            coefficients: Array5::from_shape_fn((lenses, terms, 1, NODES, NODES), |(l, k, _, r, c)| {
                10.0 * value(((l * terms + k) * NODES + r) * NODES + c)
            }),
            node_depths_um: vec![0.0],
            node_rows_px: nodes.clone(),
            node_cols_px: nodes,
            exposure_ms: 10.0,
        },
        replicates: Vec::new(),
        pupils: Default::default(),
        effects: Vec::new(),
        light_unit: LightUnit::Bead,
        quality: Quality::default(),
        diagnostics: Diagnostics::default(),
    }
}

/// Eq. 3 as it is written: for each term the weighted object and the PSF on the whole frame, three transforms, the
/// product added up.
struct WholeFrames {
    fft: RealFft2,
    maps: Vec<Array2<f32>>,
    kernels: Vec<Array2<f32>>,
    sensor: [usize; 2],
}

impl WholeFrames {
    fn new(i: &Instrument) -> Self {
        let sensor = [i.manifest.sensor.rows, i.manifest.sensor.cols];
        let object = i.manifest.object.rows;
        let window = i.manifest.optics.psf_window_px;
        // Room for what hangs over the edges, so that nothing wraps round.
        let transform = sensor.map(|n| fast_size(n.max(object) + window - 1));
        let taps = Taps::for_pixels(&i.psf.node_rows_px, object);
        let map = |k: usize| {
            let nodes = i.psf.coefficients.slice(s![0, k, 0, .., ..]);
            let down: Vec<Vec<f32>> =
                nodes.outer_iter().map(|n| taps.iter().map(|t| t.apply(&n.to_vec())).collect()).collect();
            Array2::from_shape_fn((object, object), |(r, c)| {
                taps[r].apply(&down.iter().map(|d| d[c]).collect::<Vec<_>>())
            })
        };
        Self {
            fft: RealFft2::new(transform[0], transform[1]),
            maps: (0..TERMS).map(map).collect(),
            kernels: i.psf.basis.slice(s![0, .., .., ..]).outer_iter().map(|k| k.to_owned()).collect(),
            sensor,
        }
    }

    fn apply(&self, object: &Array2<f32>) -> Array2<f32> {
        let [rows, cols] = self.fft.shape();
        let zero = vec![Complex32::default(); self.fft.spectrum_len()];
        let (mut a, mut b, mut scratch) = (zero.clone(), zero, self.fft.scratch());
        let mut image = vec![0.0f32; rows * cols];
        let mut frame = Array2::zeros((self.sensor[0], self.sensor[1]));
        // Object pixel (0, 0) as the operator places it, and half a window.
        let half = self.kernels[0].nrows() / 2;
        let corner =
            self.sensor.map(|n| ((n as f64 - 1.0) / 2.0 - (object.nrows() as f64 - 1.0) / 2.0).round() as usize);
        for (map, kernel) in self.maps.iter().zip(&self.kernels) {
            image.fill(0.0);
            for ((r, c), o) in object.indexed_iter() {
                image[(r + corner[0]) * cols + c + corner[1]] = o * map[[r, c]];
            }
            self.fft.forward(&image, &mut a, &mut scratch);
            image.fill(0.0);
            for ((r, c), v) in kernel.indexed_iter() {
                image[r * cols + c] = *v;
            }
            self.fft.forward(&image, &mut b, &mut scratch);
            a.iter_mut().zip(&b).for_each(|(x, y)| *x *= y);
            self.fft.inverse(&a, &mut image, &mut scratch);
            let scale = 1.0 / (rows * cols) as f32;
            for ((r, c), v) in frame.indexed_iter_mut() {
                *v += scale * image[(r + half) * cols + c + half];
            }
        }
        frame
    }
}

/// One thread: the ratio is that of the arithmetic, not of how it is shared out.
fn forward(c: &mut Criterion) {
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global().unwrap();
    let mut group = c.benchmark_group("low-rank forward, one lens, 8 terms");
    group.sample_size(10);
    for (object, sensor, window) in [(96, [214, 214], 21), (600, [750, 1000], 61), (2400, [3000, 4000], 241)] {
        let i = instrument(object, sensor, window, [1, TERMS]);
        let whole = WholeFrames::new(&i);
        let o = Array2::from_shape_fn((object, object), |(r, c)| value(r * object + c));
        // As a large instrument is planned: the spectra of all lenses would not fit.
        let most_spectra_bytes = if object > 1000 { 0 } else { OperatorConfig::default().most_spectra_bytes };
        let config = OperatorConfig { most_spectra_bytes, ..OperatorConfig::exact(0) };
        let operator = LowRankOperator::plan(i.optics(), &i.geometry, config).unwrap();
        let (got, want) = (operator.apply(o.view()).unwrap(), whole.apply(&o));
        let top = want.iter().fold(0.0f32, |m, v| m.max(v.abs()));
        assert!(got.iter().zip(&want).all(|(a, b)| (a - b).abs() < 1e-5 * top), "the two sums differ");
        group.bench_function(BenchmarkId::new("blocks", object), |b| b.iter(|| operator.apply(black_box(o.view()))));
        group.bench_function(BenchmarkId::new("whole frames", object), |b| b.iter(|| whole.apply(black_box(&o))));
    }
    group.finish();
}

/// The same at the paper's size, with three lenses of 32 terms whose coefficients are as smooth over the field, and as
/// unlike in their strength, as calibrated ones are: with the terms of each lens, and with functions that the lenses
/// share in each block.
fn shared_functions(c: &mut Criterion) {
    const TERMS: usize = 32;
    const LENSES: usize = 3;
    let mut i = instrument(2400, [3000, 4000], 241, [LENSES, TERMS]);
    let smooth = |k: usize, at: usize, phase: f64| (phase + (k + 1) as f64 * at as f64 / NODES as f64).cos();
    i.psf.coefficients = Array5::from_shape_fn((LENSES, TERMS, 1, NODES, NODES), |(l, k, _, r, c)| {
        let phase = 0.4 * l as f64;
        (smooth(k % 6, r, 0.3 + phase) * smooth(k / 6, c, 1.1 - phase) * 0.8f64.powi(k as i32)) as f32
    });
    let o = Array2::from_shape_fn((2400, 2400), |(r, c)| value(r * 2400 + c));
    let plan = |most_error: f64| {
        let config = OperatorConfig { most_spectra_bytes: 0, most_error, ..OperatorConfig::default() };
        LowRankOperator::plan(i.optics(), &i.geometry, config).unwrap()
    };
    let (all, shared) = (plan(0.0), plan(OperatorConfig::default().most_error));
    let (want, got) = (all.apply(o.view()).unwrap(), shared.apply(o.view()).unwrap());
    let power = |f: &Array2<f32>| f.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>();
    let error = (power(&(&got - &want)) / power(&want)).sqrt();
    assert!(error < 1e-3, "shared functions err by {error}");
    let mut group = c.benchmark_group("low-rank forward, three lenses, 32 terms");
    group.sample_size(10);
    group.bench_function("terms of each lens", |b| b.iter(|| all.apply(black_box(o.view()))));
    group.bench_function("shared functions", |b| b.iter(|| shared.apply(black_box(o.view()))));
    group.finish();
}

criterion_group!(benches, forward, shared_functions);
criterion_main!(benches);
