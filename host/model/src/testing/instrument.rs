//! A small synthetic instrument: 1 x 2 lenses, smooth coefficient maps, pseudo-random basis PSFs.

use crate::instrument::{Diagnostics, Instrument, LightUnit, Quality};
use crate::psf::nodes::even_nodes;
use crate::psf::{ChiefRays, LowRankPsf};
use ndarray::{Array4, Array5};
use ommatidia_physics::effects::blur_within;
use ommatidia_physics::noise::{NoiseModel, Sources};
use ommatidia_session::{ArrayGeometry, Manifest, ObjectGrid, Optics, SensorSpec};

/// An instrument with the given rows and columns of object and sensor, side of the window (px) and rank. The images of
/// its two lenses overlap and extend beyond the sensor.
pub fn instrument(object: [usize; 2], sensor: [usize; 2], window: usize, rank: usize) -> Instrument {
    let value = |i: usize| ((i * 7919 + 31) % 997) as f32 / 997.0;
    let nodes = [even_nodes(object[0], 5), even_nodes(object[1], 6)];
    let centre = sensor.map(|n| (n as f64 - 1.0) / 2.0);
    Instrument {
        manifest: Manifest {
            format: 1,
            name: "made up".into(),
            sensor: SensorSpec { rows: sensor[0], cols: sensor[1], pixel_pitch_um: 1.0, bit_depth: 12 },
            array: ArrayGeometry::grid(1, 2, 7.0),
            optics: Optics { magnification: 1.0, psf_window_px: window, wavelength_um: None },
            object: ObjectGrid { rows: object[0], cols: object[1], pixel_um: 1.0 },
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
            anchors_px: vec![[centre[0] + 0.3, centre[1] - 12.2], [centre[0] - 12.0, centre[1] + 6.4]],
            magnification: 1.0,
            dead: vec![false; 2],
        },
        psf: LowRankPsf {
            basis: Array4::from_shape_fn((2, rank, window, window), |(l, k, r, c)| {
                value(((l * rank + k) * window + r) * window + c) - 0.3
            }),
            coefficients: Array5::from_shape_fn((2, rank, 1, 5, 6), |(l, k, _, r, c)| {
                10.0 * value(((l * rank + k) * 5 + r) * 6 + c)
            }),
            node_depths_um: vec![0.0],
            node_rows_px: nodes[0].clone(),
            node_cols_px: nodes[1].clone(),
            exposure_ms: 10.0,
        },
        replicates: Vec::new(),
        effects: Vec::new(),
        light_unit: LightUnit::Bead,
        pupils: Default::default(),
        quality: Quality::default(),
        diagnostics: Diagnostics::default(),
    }
}

/// The instrument with PSFs blurred by a Gaussian of 1 px, as optics and pixels blur them.
pub fn smooth(mut instrument: Instrument) -> Instrument {
    for mut kernels in instrument.psf.basis.outer_iter_mut() {
        for mut kernel in kernels.outer_iter_mut() {
            let blurred = blur_within(&kernel.to_owned(), 1.0);
            kernel.assign(&blurred);
        }
    }
    instrument
}
