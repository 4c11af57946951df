//! Depths between the planes of a scan, against PSFs that other code computes: transforms on a fine grid.
#![allow(clippy::unwrap_used)]

use ndarray::{Array2, Array4, Array5, s};
use ommatidia_model::forward::Forward;
use ommatidia_model::instrument::Instrument;
use ommatidia_model::psf::OperatorConfig;
use ommatidia_model::testing::instrument;
use ommatidia_physics::effects::Chain;
use ommatidia_physics::optics::{Psf, PupilConfig, Wavefront};

const SIDE: usize = 21;
/// Defocus by depth of a pupil of 0.21 cycles/px, waves rms per um: R^2 wavelength / (4 sqrt 3) at unit magnification.
const WAVES_PER_UM: f64 = 3.37e-3;

/// Two lenses with astigmatism, coma and some defocus, measured at `depths_um`.
fn measured(depths_um: &[f64]) -> Instrument {
    let config = PupilConfig {
        wavelength_um: 0.53,
        aperture_um: 110.0,
        distance_um: 1000.0,
        soft_edge: 0.0,
        pixel_um: 2.0,
        oversampling: 5,
        field_px: 41,
    };
    let pupil = config.build().unwrap();
    let (mut scratch, mut psf) = (pupil.scratch(), Psf::default());
    let rank = depths_um.len();
    let mut i = instrument([41, 41], [90, 90], SIDE, rank);
    let mut basis = Array4::zeros((2, rank, SIDE, SIDE));
    let mut coefficients = Array5::zeros((2, rank, rank, 5, 6));
    for (lens, own) in [[0.05, 0.03, 0.04], [0.03, 0.05, -0.03]].iter().enumerate() {
        for (d, z) in depths_um.iter().enumerate() {
            let mut w = Wavefront::default();
            (w.coefficient[3], w.coefficient[4], w.coefficient[7]) = (own[0] + WAVES_PER_UM * z, own[1], own[2]);
            pupil.psf(&w, [0.0; 2], &mut scratch, &mut psf);
            let skip = (psf.side - SIDE) / 2;
            let window =
                Array2::from_shape_fn((SIDE, SIDE), |(r, c)| 1e3 * psf.share[(r + skip) * psf.side + c + skip]);
            basis.slice_mut(s![lens, d, .., ..]).assign(&window);
            coefficients.slice_mut(s![lens, d, d, .., ..]).fill(1.0f32);
        }
    }
    (i.psf.basis, i.psf.coefficients, i.psf.node_depths_um) = (basis, coefficients, depths_um.to_vec());
    i
}

fn frame_e(instrument: &Instrument, z_um: f64) -> Array2<f32> {
    let forward =
        Forward::with_all_depths(instrument, OperatorConfig::exact(instrument.psf.depth_nearest(0.0))).unwrap();
    let mut object = Array2::zeros((41, 41));
    object[[20, 20]] = 1.0;
    let (chain, cx) = (Chain::default(), forward.context());
    let scene = forward.scene(object.view(), &chain, &cx).unwrap().at_depth(z_um);
    forward.sum_e(&scene, &chain, &cx)
}

#[test]
fn foci_between_and_beyond_planes_that_lie_far_apart_are_those_of_optics() {
    // 0.12 waves rms from plane to plane.
    let depths_um = [-35.0, 0.0, 35.0];
    let scanned = measured(&depths_um);
    let planes = depths_um.map(|z| frame_e(&scanned, z));
    let norm = |image: &Array2<f32>| image.mapv(|v| v * v).sum().sqrt();
    for (d, z) in depths_um.iter().enumerate() {
        let wanted = frame_e(&measured(&[*z]), *z);
        assert!(norm(&(&planes[d] - &wanted)) < 1e-3 * norm(&wanted), "{z}");
    }
    for z in [-50.0, -17.0, 12.0, 20.0, 50.0] {
        let wanted = frame_e(&measured(&[z]), z);
        let error = norm(&(frame_e(&scanned, z) - &wanted)) / norm(&wanted);
        // The quadratic mixture of the planes; beyond them the last one.
        let x: f64 = (z / 35.0f64).clamp(-1.0, 1.0);
        let shares = [x * (x - 1.0) / 2.0, 1.0 - x * x, x * (x + 1.0) / 2.0].map(|v| v as f32);
        let mixture = &planes[0] * shares[0] + &planes[1] * shares[1] + &planes[2] * shares[2];
        let mixed = norm(&(mixture - &wanted)) / norm(&wanted);
        assert!(error < 0.1 * mixed, "{z} um: {error}, a mixture of planes {mixed}");
    }
}
