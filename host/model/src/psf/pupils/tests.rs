//! Pupils fitted to PSFs that other code computes: transforms on a fine grid (`ommatidia_physics::optics`).

use super::*;
use crate::psf::LowRankPsf;
use crate::psf::decompose::decompose;
use ndarray::{Array1, Array2, Array3, Array4, Array5, Axis, concatenate, s};
use ommatidia_physics::optics::{Psf, Pupil, PupilConfig, Wavefront};

const SIDE: usize = 21;
const NODES: usize = 5;

/// A pupil whose cut-off is 0.21 cycles/px.
fn pupil() -> Pupil {
    let config = PupilConfig {
        wavelength_um: 0.53,
        aperture_um: 110.0,
        distance_um: 1000.0,
        soft_edge: 0.0,
        pixel_um: 2.0,
        oversampling: 5,
        field_px: 41,
    };
    config.build().unwrap()
}

/// The wavefront of a lens at (y, x), -1 to 1 over the object.
fn wavefront(lens: usize, [y, x]: [f64; 2]) -> Wavefront {
    let mut w = Wavefront::default();
    let c = &mut w.coefficient;
    let own = [[0.04, 0.02, -0.03, 0.02], [0.02, -0.03, 0.02, -0.02], [0.05, 0.01, 0.02, 0.03]][lens];
    c[3] = own[0] + 0.06 * (y * y + x * x);
    c[4] = own[1] + 0.03 * y * x;
    c[6] = own[2] + 0.03 * y;
    c[7] = own[3] + 0.03 * x;
    c[10] = 0.02;
    w
}

fn place(i: usize) -> f64 {
    2.0 * i as f64 / (NODES - 1) as f64 - 1.0
}

/// PSFs of three lenses at the nodes, [lens, node row, node col] windows; `added` to each wavefront.
fn windows(added: &Wavefront) -> Vec<Array3<f32>> {
    displaced_windows(added, 0.0)
}

/// The same with foci that a distortion displaces by `cubic_px` times the cubes of y and x.
fn displaced_windows(added: &Wavefront, cubic_px: f64) -> Vec<Array3<f32>> {
    let pupil = pupil();
    let (mut scratch, mut psf) = (pupil.scratch(), Psf::default());
    let lens = |l: usize| {
        let mut all = Array3::zeros((NODES * NODES, SIDE, SIDE));
        for (n, mut out) in all.outer_iter_mut().enumerate() {
            let at = [place(n / NODES), place(n % NODES)];
            let mut w = wavefront(l, at);
            w.coefficient.iter_mut().zip(added.coefficient).for_each(|(c, v)| *c += v);
            pupil.psf(&w, at.map(|v| cubic_px * v.powi(3)), &mut scratch, &mut psf);
            let skip = (psf.side - SIDE) / 2;
            out.indexed_iter_mut().for_each(|((r, c), v)| *v = 1e3 * psf.share[(r + skip) * psf.side + c + skip]);
        }
        all
    };
    (0..3).map(lens).collect()
}

fn calibrated() -> LowRankPsf {
    calibrated_at(vec![0.0], 0.0)
}

/// A scan at several depths with that defocus for each um, waves rms.
fn calibrated_at(node_depths_um: Vec<f64>, waves_per_um: f64) -> LowRankPsf {
    let at_depth = node_depths_um.iter().map(|z| windows(&added(&[(4, waves_per_um * z)]))).collect();
    of_windows(node_depths_um, at_depth)
}

/// A calibration of the windows at each depth.
fn of_windows(node_depths_um: Vec<f64>, at_depth: Vec<Vec<Array3<f32>>>) -> LowRankPsf {
    let (rank, depths) = (12, node_depths_um.len());
    let mut basis = Array4::zeros((3, rank, SIDE, SIDE));
    let mut coefficients = Array5::zeros((3, rank, depths, NODES, NODES));
    for l in 0..3 {
        let all: Vec<_> = at_depth.iter().map(|lenses| lenses[l].view()).collect();
        let flat = concatenate(Axis(0), &all).unwrap();
        let flat = flat.into_shape_with_order((depths * NODES * NODES, SIDE * SIDE)).unwrap();
        let d = decompose(flat.view(), None, Array1::ones(SIDE * SIDE).view(), rank).unwrap();
        for k in 0..rank {
            let kernel = d.basis.row(k).to_owned().into_shape_with_order((SIDE, SIDE)).unwrap();
            basis.slice_mut(s![l, k, .., ..]).assign(&kernel);
            let map = d.coefficients.column(k).mapv(|v| v as f32);
            let map = map.into_shape_with_order((depths, NODES, NODES)).unwrap();
            coefficients.slice_mut(s![l, k, .., .., ..]).assign(&map);
        }
    }
    let nodes: Vec<f64> = (0..NODES).map(|i| 10.0 * i as f64).collect();
    LowRankPsf {
        basis,
        coefficients,
        node_depths_um,
        node_rows_px: nodes.clone(),
        node_cols_px: nodes,
        exposure_ms: 10.0,
    }
}

fn fitted(psf: &LowRankPsf) -> PupilModel {
    PupilModel::fit(psf, 0, &[false; 3], Scale { magnification: 0.66, pixel_pitch_um: 2.0 }).unwrap()
}

/// A distortion of the third order displaces foci as no tilt does that is quadratic in the field. Left to the pupils,
/// it is bought by other aberrations.
#[test]
fn where_foci_lie_is_none_of_the_pupils() {
    let plain = fitted(&calibrated()).summary();
    let displaced = of_windows(vec![0.0], vec![displaced_windows(&Wavefront::default(), 0.6)]);
    let found = fitted(&displaced).summary();
    assert!(found.misfit < 0.03, "{found:?}");
    assert!((found.cutoff_cycles_per_px / plain.cutoff_cycles_per_px - 1.0).abs() < 0.03, "{found:?} {plain:?}");
    for (found, plain) in [
        (found.defocus_waves, plain.defocus_waves),
        (found.astigmatism_waves, plain.astigmatism_waves),
        (found.coma_waves, plain.coma_waves),
        (found.spherical_waves, plain.spherical_waves),
    ] {
        assert!((found - plain).abs() < 0.015, "{found} {plain}");
    }
}

/// A source off the focus by z has a path longer by z NA^2 / 2 at the rim, NA on its side; the rms of such a wavefront
/// is 1 / (2 sqrt 3) of that. Of the pupil above: NA 0.055 on the side of the image, times the magnification.
#[test]
fn a_depth_is_the_defocus_of_the_aperture() {
    let model = fitted(&calibrated());
    let na: f64 = 0.055 * 0.66;
    let waves = 30.0 * na * na / 2.0 / 0.53 / (2.0 * 3f64.sqrt());
    for lens in 0..3 {
        let found = model.defocus_waves(lens, 30.0, 0.53);
        assert!((found / waves - 1.0).abs() < 0.1, "{lens}: {found} {waves}");
    }
}

/// Depths that lie as far apart as the depth of field: 0.12 waves rms from plane to plane, to either side.
#[test]
fn a_scan_at_several_depths_shows_how_far_wavefronts_bend_and_to_which_side() {
    // As the aperture has it: see the test of a depth.
    for waves_per_um in [3.6e-4, -3.6e-4] {
        let psf = calibrated_at(vec![-330.0, 0.0, 330.0], waves_per_um);
        let scale = Scale { magnification: 0.66, pixel_pitch_um: 2.0 };
        let model = PupilModel::fit(&psf, 1, &[false; 3], scale).unwrap().with_depths(&psf).unwrap();
        for lens in 0..3 {
            let found = model.defocus_waves(lens, 50.0, 0.53) / (50.0 * waves_per_um);
            // The even terms that made the PSFs have the sign that is chosen, so that the defocus keeps its own.
            assert!((found - 1.0).abs() < 0.1, "{lens}: {found}");
        }
    }
    // The same PSFs at all depths have no defocus.
    let psf = calibrated_at(vec![-100.0, 0.0, 100.0], 0.0);
    let scale = Scale { magnification: 0.66, pixel_pitch_um: 2.0 };
    assert!(PupilModel::fit(&psf, 1, &[false; 3], scale).unwrap().with_depths(&psf).is_none());
}

/// Relative error of predicted changes, and the change relative to the PSFs.
fn errors(model: &PupilModel, psf: &LowRankPsf, added: &Wavefront, sign: f64) -> [f64; 2] {
    let mut turned = *added;
    for (k, even) in EVEN.iter().enumerate().filter(|(_, even)| **even) {
        let _ = even;
        turned.coefficient[k + 1] *= sign;
    }
    let shape = (model.nodes_px()[0].len(), model.nodes_px()[1].len());
    let by = Wavefronts { added: Array2::from_elem(shape, turned), misjudged_waves: 0.0 };
    let [before, after] = [windows(&Wavefront::default()), windows(added)];
    let (mut off, mut size, mut all) = (0.0, 0.0, 0.0);
    for l in 0..3 {
        let change = model.change(psf, (l, 0), &by).unwrap();
        for n in 0..NODES * NODES {
            let mut found = Array2::<f32>::zeros((SIDE, SIDE));
            for k in 0..change.basis.dim().1 {
                let weight = change.coefficients[[0, k, 0, n / NODES, n % NODES]];
                found.scaled_add(weight, &change.basis.slice(s![0, k, .., ..]));
            }
            let [b, a] = [&before, &after].map(|w| w[l].slice(s![n, .., ..]).to_owned());
            let wanted = &a - &b;
            off += (&found - &wanted).mapv(|v| v * v).sum();
            size += wanted.mapv(|v| v * v).sum();
            all += b.mapv(|v| v * v).sum();
        }
    }
    [f64::from(off / size).sqrt(), f64::from(size / all).sqrt()]
}

fn added(terms: &[(usize, f64)]) -> Wavefront {
    let mut w = Wavefront::default();
    terms.iter().for_each(|(j, v)| w.coefficient[j - 1] = *v);
    w
}

#[test]
fn changes_of_wavefronts_are_predicted_from_one_plane() {
    let psf = calibrated();
    let model = fitted(&psf);
    assert!(model.misfit < 0.05, "{}", model.misfit);
    // The true even terms are positive in the mean, which is the sign that is chosen.
    for terms in [vec![(4, 0.02)], vec![(4, -0.05)], vec![(4, 0.12)], vec![(7, 0.05), (8, -0.08)], vec![(6, 0.04)]] {
        let [off, size] = errors(&model, &psf, &added(&terms), 1.0);
        assert!(off < 0.1, "{terms:?}: {off} of a change of {size}");
    }
    // The other sign of what is even is another change.
    assert!(errors(&model, &psf, &added(&[(4, 0.05)]), -1.0)[0] > 0.5);
}

/// PSFs of lenses that are out of focus by `own` more than those that were fitted: an added defocus changes them as the
/// pupil says that knows of it.
#[test]
fn a_misjudged_defocus_changes_what_a_wavefront_does_and_no_psf_by_itself() {
    let psf = calibrated();
    let model = fitted(&psf);
    let shape = (model.nodes_px()[0].len(), model.nodes_px()[1].len());
    let change = |waves: f64, own: f64, l: usize| {
        let added = Array2::from_elem(shape, added(&[(4, waves)]));
        model.change(&psf, (l, 0), &Wavefronts { added, misjudged_waves: own }).unwrap()
    };
    let (own, waves) = (0.03, 0.06);
    let [with, from] = [own + waves, own].map(|v| windows(&added(&[(4, v)])));
    for l in 0..3 {
        assert!(change(0.0, own, l).coefficients.iter().all(|c| *c == 0.0));
        let distance = |misjudged: f64| {
            let found = change(waves, misjudged, l);
            let (mut off, mut size) = (0.0, 0.0);
            for n in 0..NODES * NODES {
                let mut sum = Array2::<f32>::zeros((SIDE, SIDE));
                for k in 0..found.basis.dim().1 {
                    let weight = found.coefficients[[0, k, 0, n / NODES, n % NODES]];
                    sum.scaled_add(weight, &found.basis.slice(s![0, k, .., ..]));
                }
                let wanted = &with[l].slice(s![n, .., ..]) - &from[l].slice(s![n, .., ..]);
                off += (&sum - &wanted).mapv(|v| v * v).sum();
                size += wanted.mapv(|v| v * v).sum();
            }
            (off / size).sqrt()
        };
        let [known, unknown] = [own, 0.0].map(distance);
        assert!(known < 0.1 && unknown > 0.2, "{l}: {known} {unknown}");
    }
    // What the misfit hides of a lens that is well out of focus is less than of one that is in it.
    let doubts: Vec<f64> = (0..3).map(|l| model.doubt_waves(l)).collect();
    assert!(doubts.iter().all(|d| (1e-4..0.05).contains(d)), "{doubts:?}");
}

#[test]
fn what_no_pupil_explains_has_none() {
    let mut psf = calibrated();
    // Two foci a lens: a ghost that is as bright as the focus itself.
    let moved = psf.basis.clone();
    for (l, k) in (0..3).flat_map(|l| (0..12).map(move |k| (l, k))) {
        let mut to = psf.basis.slice_mut(s![l, k, 7.., ..]);
        to += &moved.slice(s![l, k, ..SIDE - 7, ..]);
    }
    let scale = Scale { magnification: 0.66, pixel_pitch_um: 2.0 };
    let none = PupilModel::fit(&psf, 0, &[false; 3], scale);
    assert!(none.is_none(), "{none:?}");
    // One pixel says nothing of a pupil.
    let small = LowRankPsf { basis: psf.basis.slice(s![.., .., 10..11, 10..11]).to_owned(), ..psf };
    assert!(PupilModel::fit(&small, 0, &[false; 3], scale).is_none());
}

#[test]
fn dark_and_broken_lenses_are_no_failure() {
    let mut psf = calibrated();
    psf.coefficients.slice_mut(s![1, .., .., .., ..]).fill(0.0);
    let scale = Scale { magnification: 0.66, pixel_pitch_um: 2.0 };
    assert!(PupilModel::fit(&psf, 0, &[false, true, false], scale).is_some());
    // A lens without light that is not marked as dead has no pupil, and then no lens has.
    assert!(PupilModel::fit(&psf, 0, &[false; 3], scale).is_none());
    psf.coefficients.fill(f32::NAN);
    assert!(PupilModel::fit(&psf, 0, &[false; 3], scale).is_none());
}
