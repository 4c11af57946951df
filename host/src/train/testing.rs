//! Fixtures of the tests of training, methods and evaluation.

use super::Pair;
use crate::instrument::{Instrument, fixture};
use crate::noise::NoiseModel;
use crate::rng;
use crate::session::ArrayGeometry;
use ndarray::{Array2, Array4, Array5};
use rand::RngExt;

/// An instrument with `side` x `side` lenses, 20 px apart about the centre of the sensor; each PSF is one pixel, the
/// same all over the field.
pub(crate) fn instrument(side: usize, sensor: [usize; 2], object: [usize; 2]) -> Instrument {
    let lenses = side * side;
    let middle = |n: usize| (n as f64 - 1.0) / 2.0;
    let anchor = |l: usize| {
        let step = |i: usize| 20.0 * (i as f64 - middle(side));
        [middle(sensor[0]) + step(l / side), middle(sensor[1]) + step(l % side)]
    };
    let mut basis = Array4::zeros((lenses, 1, 3, 3));
    basis.slice_mut(ndarray::s![.., .., 1, 1]).fill(1.0);
    let mut instrument = fixture::instrument(object, sensor, 3, 1);
    instrument.manifest.array = ArrayGeometry { rows: side, cols: side, pitch_px: 20.0 };
    instrument.geometry.anchors_px = (0..lenses).map(anchor).collect();
    instrument.geometry.dead = vec![false; lenses];
    instrument.psf.basis = basis;
    instrument.psf.coefficients = Array5::ones((lenses, 1, 1, 2, 2));
    instrument.psf.node_rows_px = vec![0.0, object[0] as f64 - 1.0];
    instrument.psf.node_cols_px = vec![0.0, object[1] as f64 - 1.0];
    instrument
}

/// Noise of a sensor like the demo's.
pub(crate) fn noise() -> NoiseModel {
    NoiseModel {
        black_level_dn: 64.0,
        gain_dn_per_e: 0.4,
        gain_sigma: 0.0,
        read_noise_e: 2.0,
        read_noise_sigma: 0.0,
        saturation_dn: 4095.0,
        sources: crate::noise::Sources::default(),
    }
}

/// Pairs of random points imaged by 3 x 3 lenses, each focus a small cross; the views lie `pitch` pixels apart.
pub(crate) fn foci(count: usize, frame: usize, object: usize, pitch: usize) -> Vec<Pair> {
    let make = |i: usize| {
        let mut rng = rng::stream(11, "points", i as u64);
        let mut o = Array2::<f32>::zeros((object, object));
        for _ in 0..12 {
            o[[rng.random_range(0..object), rng.random_range(0..object)]] = rng.random_range(0.3..1.0f32);
        }
        let mut f = Array2::<f32>::zeros((frame, frame));
        let middle = (frame - object) / 2;
        for ((r, c), &v) in o.indexed_iter().filter(|(_, v)| **v > 0.0) {
            for lens in 0..9 {
                let (r0, c0) = (r + middle + (lens / 3) * pitch - pitch, c + middle + (lens % 3) * pitch - pitch);
                for (dr, dc, w) in [(0i32, 0i32, 0.5f32), (1, 0, 0.15), (-1, 0, 0.1), (0, 1, 0.15), (0, -1, 0.1)] {
                    let (r, c) = ((r0 as i32 + dr) as usize, (c0 as i32 + dc) as usize);
                    if let Some(p) = f.get_mut((r, c)) {
                        *p += v * w * 1000.0;
                    }
                }
            }
        }
        Pair { object: o, expected_e: f }
    };
    (0..count).map(make).collect()
}
