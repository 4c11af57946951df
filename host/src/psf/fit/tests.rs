use super::lenses::limits_of;
use super::misfit::misfit;
use super::*;
use crate::psf::windows::{BeadScale, LensWindows};
use ndarray::{Array1, Array2};

#[test]
fn a_checkerboard_has_its_neighbours_in_the_other_half() {
    let at_px =
        Array2::from_shape_fn((20, 2), |(i, a)| if a == 0 { (i / 5) as f64 * 7.3 } else { (i % 5) as f64 * 7.3 });
    let plane = Plane { z_um: 0.0, beads: (0..20).collect(), at_px };
    let train = checkerboard(&[plane], 20);
    for i in 0..20 {
        assert!(i % 5 == 4 || train[i] != train[i + 1]);
        assert!(i >= 15 || train[i] != train[i + 5]);
    }
}

#[test]
fn a_scan_of_depth_alone_is_divided_by_depths_and_predicted_between_them() {
    // The light wanders smoothly from one pixel to the next with depth.
    let plane = |i: usize| Plane { z_um: i as f64, beads: vec![i], at_px: ndarray::arr2(&[[5.0, 5.0]]) };
    let planes: Vec<Plane> = (0..11).map(plane).collect();
    let light = Array2::from_shape_fn((11, 2), |(i, p)| {
        let share = (0.1 * i as f32).sin();
        if p == 0 { 1.0 - share } else { share }
    });
    let windows = LensWindows { light_dn: light, known: None, variance_dn2: ndarray::arr1(&[1.0, 1.0]) };
    let train = checkerboard(&planes, 11);
    assert!(train.iter().enumerate().all(|(i, t)| *t == (i % 2 == 0)));
    let terms = Terms::Truncated { most: 2, spline_order: 2 };
    let windows = [windows];
    let models = LensModels::fit(&windows, &[false], &select(&planes, |n| train[n]), terms).unwrap();
    let misfit = models.misfit(&windows, &select(&planes, |n| !train[n])).unwrap();
    assert!(misfit.nrmse(2, BeadScale::Physical) < 1e-3, "{}", misfit.nrmse(2, BeadScale::Physical));
}

#[test]
fn lenses_of_different_aberrations_need_more_terms_together_than_each_alone() {
    use rand_distr::{Distribution, StandardNormal};
    // Two terms a lens whose coefficients have nothing to do with those of the other lens.
    let mut rng = crate::rng::stream(3, "whole array", 0);
    let mut random = |shape| Array2::<f32>::from_shape_simple_fn(shape, || StandardNormal.sample(&mut rng));
    let mut lens =
        || LensWindows { light_dn: random((30, 2)).dot(&random((2, 49))), known: None, variance_dn2: Array1::ones(49) };
    let windows = [lens(), lens()];
    let at_px = Array2::from_shape_fn((30, 2), |(i, a)| [i / 6, i % 6][a] as f64);
    let planes = [Plane { z_um: 0.0, beads: (0..30).collect(), at_px }];
    let terms = Terms::Truncated { most: 4, spline_order: 2 };
    let models = LensModels::fit(&windows, &[false, false], &planes, terms).unwrap();
    let whole = models.whole_array(&windows, &planes[0].beads, 6).unwrap();
    assert!(whole[1] > 0.2 && whole[2] > 0.05 && whole[3] < 1e-3, "{whole:?}");
    let own = approximation(&windows[0], models.fits[0].as_ref().unwrap(), &planes[0].beads);
    assert!(own.nrmse(2, BeadScale::Physical) < 1e-3);
}

#[test]
fn functions_are_held_where_the_foci_fall_off_the_sensor() {
    let plane = |beads: &[usize]| Plane {
        z_um: 0.0,
        beads: beads.to_vec(),
        at_px: Array2::from_shape_fn((beads.len(), 2), |(i, a)| [beads[i] / 3, beads[i] % 3][a] as f64 * 10.0),
    };
    let all = plane(&[0, 1, 2, 3, 4, 5, 6, 7, 8]);
    let free = [f64::NEG_INFINITY, f64::INFINITY];
    assert_eq!(limits_of(&all, &all), [free, free]);
    // The first row was not seen.
    assert_eq!(limits_of(&plane(&[3, 4, 5, 6, 7, 8]), &all), [[10.0, f64::INFINITY], free]);
}

#[test]
fn one_colour_of_a_checkerboard_is_divided_by_rows() {
    let places: Vec<(usize, usize)> =
        (0..49usize).map(|i| (i / 7, i % 7)).filter(|(r, c)| (r + c).is_multiple_of(2)).collect();
    let at_px = Array2::from_shape_fn((places.len(), 2), |(i, a)| [places[i].0, places[i].1][a] as f64 * 9.1);
    let train = checkerboard(&[Plane { z_um: 0.0, beads: (0..places.len()).collect(), at_px }], places.len());
    assert!(places.iter().zip(&train).all(|((r, _), t)| *t == r.is_multiple_of(2)));
}

#[test]
fn misfit_is_the_norm_of_the_difference_with_and_without_a_free_scale() {
    let windows = LensWindows {
        light_dn: ndarray::arr2(&[[3.0, 4.0, 100.0]]),
        known: Some(ndarray::arr2(&[[true, true, false]])),
        variance_dn2: ndarray::arr1(&[0.5, 0.5, 9.0]),
    };
    let basis = ndarray::arr2(&[[0.6, 0.8, 0.0], [0.8, -0.6, 0.0]]);
    let m = misfit(&windows, &[0], &basis, ndarray::arr2(&[[4.0, 0.5]]).view());
    assert!((m.nrmse(1, BeadScale::Physical) - 0.2).abs() < 1e-6);
    assert!(m.nrmse(1, BeadScale::PerFrame) < 1e-6);
    assert!((m.nrmse(2, BeadScale::Physical) - 1.25f64.sqrt() / 5.0).abs() < 1e-6);
    assert!((m.noise_floor() - 0.2).abs() < 1e-12);
    assert_eq!(m.best_rank(BeadScale::Physical), 1);
}
