//! A small instrument for the tests of this module, put together by hand.

use crate::instrument::{Geometry, Instrument, LowRankPsf, Quality};
use crate::noise::NoiseModel;
use crate::session::{ArrayGeometry, Manifest, ObjectGrid, Optics, SensorSpec};
use ndarray::{Array4, Array5};

/// `side` x `side` lenses, 20 px apart about the centre of the sensor; each PSF is one pixel, the same all over the field.
pub(super) fn instrument(side: usize, sensor: [usize; 2], object: [usize; 2]) -> Instrument {
    let lenses = side * side;
    let middle = |n: usize| (n as f64 - 1.0) / 2.0;
    let anchor = |l: usize| {
        let step = |i: usize| 20.0 * (i as f64 - middle(side));
        [middle(sensor[0]) + step(l / side), middle(sensor[1]) + step(l % side)]
    };
    let mut basis = Array4::zeros((lenses, 1, 3, 3));
    basis.slice_mut(ndarray::s![.., .., 1, 1]).fill(1.0);
    Instrument {
        manifest: Manifest {
            format: 1,
            name: "by hand".into(),
            sensor: SensorSpec { rows: sensor[0], cols: sensor[1], pixel_pitch_um: 2.0, bit_depth: 12 },
            array: ArrayGeometry { rows: side, cols: side, pitch_px: 20.0 },
            optics: Optics { magnification: 0.5, psf_window_px: 3 },
            object: ObjectGrid { rows: object[0], cols: object[1], pixel_um: 4.0 },
            stacks: Vec::new(),
        },
        noise: NoiseModel {
            black_level_dn: 64.0,
            gain_dn_per_e: 0.4,
            gain_sigma: 0.0,
            read_noise_e: 2.0,
            read_noise_sigma: 0.0,
            saturation_dn: 4095.0,
            sources: Default::default(),
        },
        offset_dn: None,
        geometry: Geometry {
            anchors_px: (0..lenses).map(anchor).collect(),
            magnification: 0.5,
            dead: vec![false; lenses],
        },
        psf: LowRankPsf {
            basis,
            coefficients: Array5::ones((lenses, 1, 1, 2, 2)),
            node_depths_um: vec![0.0],
            node_rows_px: vec![0.0, object[0] as f64 - 1.0],
            node_cols_px: vec![0.0, object[1] as f64 - 1.0],
            exposure_ms: 10.0,
        },
        effects: Vec::new(),
        light_unit: Default::default(),
        quality: Quality::default(),
        diagnostics: Default::default(),
    }
}
