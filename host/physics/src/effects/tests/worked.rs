//! Worked examples with numbers that can be checked by hand.

use super::*;

#[test]
fn blurs_keep_the_light_and_have_the_stated_width() {
    let mut point = Array2::<f32>::zeros((61, 61));
    point[[30, 30]] = 1000.0;
    let width2 = |i: &Array2<f32>| {
        let moment: f64 = i.indexed_iter().map(|((r, _), v)| f64::from(*v) * (r as f64 - 30.0).powi(2)).sum();
        moment / i.iter().map(|v| f64::from(*v)).sum::<f64>()
    };
    let blur = |id: &str, params: &[(&str, f64)]| {
        let layout = Layout { lenses: 1, sensor: [61, 61] };
        let chain = Chain::build(&[setting(id, params)], layout).unwrap();
        let mut image = point.clone();
        chain.on_light(&mut image, &FrameContext::default());
        chain.on_charge(&mut image, &FrameContext::default());
        (image.sum() / 1000.0, width2(&image))
    };
    let near = |(sum, got): (f32, f64), want: f64| {
        assert!((sum - 1.0).abs() < 1e-4 && (got - want).abs() < 0.01 * want, "{sum} {got} {want}");
    };
    near(blur("charge_diffusion", &[("sigma_px", 0.3)]), 0.09);
    near(blur("charge_diffusion", &[("sigma_px", 1.7)]), 2.89);
    near(blur("halo", &[("weight", 0.25), ("sigma_px", 4.0)]), 4.0);
    near(blur("interpixel_capacitance", &[("alpha", 0.01)]), 0.02);
}

#[test]
fn worked_examples() {
    let previous = image();
    let cx = context(&previous);
    let mut frame = Array2::from_elem((2, 2), 102.0f32);
    chain("pixel_mosaic", &[("checker", 0.03), ("rows", 0.01)]).on_electronics(&mut frame, &cx);
    assert_eq!(frame, ndarray::arr2(&[[106.0, 100.0], [98.0, 104.0]]));
    let mut light = Array2::from_elem((1, 2), 5.0f32);
    chain("background", &[("rate_e_per_ms", 0.2), ("gradient_col", 0.5)]).on_light(&mut light, &cx);
    assert_eq!(light, ndarray::arr2(&[[6.5, 7.5]]));
    let mut charge = Array2::from_elem((1, 1), 5000.0f32);
    chain("nonlinearity", &[("beta", 0.02)]).on_charge(&mut charge, &cx);
    assert_eq!(charge[[0, 0]], 4950.0);
    assert_eq!(chain("array_shift", &[("col_px", -0.25)]).shift_ray(&RAY, &cx).px, [0.0, -0.25]);
    let mut lens = Array2::from_elem((1, 1), 100.0f32);
    chain("lens_gain", &[("change_0", -0.5), ("change_1", 3.0)]).on_lens(&mut lens, &cx);
    assert_eq!(lens[[0, 0]], 50.0);
}

fn shifted(id: &str, params: &[(&str, f64)]) -> RayShift {
    chain(id, params).shift_ray(&RAY, &context(&image()))
}

fn close(found: f64, want: f64) {
    assert!((found - want).abs() < 1e-6 * want.abs().max(1e-6), "{found} instead of {want}");
}

#[test]
fn worked_examples_of_chief_rays() {
    let near = |found: RayShift, px: [f64; 2], z_um: f64| {
        close(found.px[0], px[0]);
        close(found.px[1], px[1]);
        close(found.z_um, z_um);
    };
    // Anchor (-20, 15), field (10, -17), axis (12, -11) px of 1.85 um; 3 s.
    // 11, 60, 61 are the sides of a right triangle.
    let mrad = 1e3 * (11.0f64 / 60.0).atan();
    near(shifted("array_rotation", &[("angle_mrad", mrad)]), [185.0 / 61.0, 205.0 / 61.0], 0.0);
    near(shifted("lens_decentre", &[("row_px_0", 0.5), ("row_px_1", 9.0), ("col_px_0", -0.25)]), [0.5, -0.25], 0.0);
    near(shifted("magnification", &[("eps", 0.01)]), [0.12, -0.11], 0.0);
    close(shifted("magnification", &[("eps", 0.01)]).growth, 0.01);
    close(shifted("spectral_shift", &[("change", -0.05)]).growth, -0.05);
    near(shifted("stage_scale", &[("row_by_row", 0.01), ("col_by_row", 0.1)]), [0.1, 1.0], 0.0);
    near(shifted("thermal_drift", &[("col_px_per_s", 0.5)]), [0.0, 1.5], 0.0);
    near(shifted("array_jump", &[("row_px", 0.5), ("col_px", -0.25), ("since_s", 2.5)]), [0.5, -0.25], 0.0);
    near(shifted("array_jump", &[("row_px", 0.5), ("since_s", 3.5)]), [0.0, 0.0], 0.0);
    let r2_mm2 = 265.0 * 1.85e-3f64.powi(2);
    near(shifted("radial_distortion", &[("k1_per_mm2", 2.0)]), [24.0 * r2_mm2, -22.0 * r2_mm2], 0.0);
    // Focus (-10, -2) px from the centre of the array, source (30, -50) um from the centre of the object.
    near(shifted("sensor_rotation", &[("angle_mrad", mrad)]), [-12.0 / 61.0, 112.0 / 61.0], 0.0);
    // About the focus itself, which stays.
    let about = [("angle_mrad", mrad), ("row_px", 12.0 / 61.0), ("col_px", -112.0 / 61.0)];
    assert!(shifted("sensor_rotation", &about).px.iter().all(|d| d.abs() < 1e-12));
    near(shifted("object_distortion", &[("k1_per_mm2", 5.0)]), [0.17, -0.289], 0.0);
    // 0.5 + (0.2 * 10 + 0.1 * -17) / 100, and nothing of the other lens.
    near(
        shifted("unknown_warp", &[("row_px_0", 0.5), ("row_by_row_0", 0.2), ("row_by_col_0", 0.1), ("col_px_1", 3.0)]),
        [0.503, 0.0],
        0.0,
    );
    near(shifted("defocus", &[("z_um", -30.0)]), [0.0, 0.0], -30.0);
    near(shifted("field_curvature", &[("a_um_per_mm2", 1000.0)]), [0.0, 0.0], 1000.0 * r2_mm2);
    // Source (0.03, -0.05) mm: 1000 x 0.03 - 200 x 0.05 um.
    near(shifted("tilt", &[("row_um_per_mm", 1000.0), ("col_um_per_mm", 200.0)]), [0.0, 0.0], 20.0);
    // Travel (0.5, -1.5), 0.35 px/um: 2 x 0.5 x 0.35 and -1.5 x 0.35 px.
    near(shifted("stage_backlash", &[("row_um", 2.0), ("col_um", 1.0)]), [0.35, -0.525], 0.0);
}

/// The light `of` with an effect at all its stages of light and charge.
fn lit(id: &str, params: &[(&str, f64)], of: &Array2<f32>, cx: &FrameContext<'_>) -> Array2<f32> {
    let layout = Layout { lenses: 2, sensor: [of.nrows(), of.ncols()] };
    let chain = Chain::build(&[setting(id, params)], layout).unwrap();
    let mut image = of.clone();
    chain.on_object(&mut image, cx);
    chain.on_lens(&mut image, cx);
    chain.on_light(&mut image, cx);
    chain.on_charge(&mut image, cx);
    image
}

fn electronic(id: &str, params: &[(&str, f64)], of: &Array2<f32>, cx: &FrameContext<'_>) -> Array2<f32> {
    let mut image = of.clone();
    chain(id, params).on_electronics(&mut image, cx);
    image
}

#[test]
fn worked_examples_of_factors() {
    let previous = Array2::from_elem((1, 1), 1000.0);
    let cx = context(&previous);
    let one = Array2::from_elem((1, 1), 100.0f32);
    let factor = |id: &str, params: &[(&str, f64)], cx: &FrameContext<'_>| f64::from(lit(id, params, &one, cx)[[0, 0]]);
    let near = |found: f64, want: f64| assert!((found - want).abs() < 1e-4 * want, "{found} instead of {want}");
    near(factor("photobleaching", &[("rate_per_s", 0.1)], &cx), 100.0 * (-0.3f64).exp());
    let flat = FrameContext { role: Role::Flat, ..cx };
    near(factor("photobleaching", &[("rate_per_s", 0.1)], &flat), 100.0);
    near(factor("lamp_drift", &[("rate_per_s", 0.1)], &flat), 130.0);
    near(factor("exposure_offset", &[("dt_ms", -2.0)], &cx), 80.0);
    near(factor("lag", &[("share", 0.1), ("tau_s", 0.02)], &cx), 100.0 + 100.0 * (-1f64).exp());
    // 30 C, 10 ms.
    near(factor("dark_current", &[("rate_e_per_ms", 0.5), ("doubling_k", 5.0)], &cx), 120.0);
    let dark = FrameContext { role: Role::Dark, ..cx };
    near(factor("lamp_drift", &[("rate_per_s", 0.1)], &dark), 100.0);
    // Charge at full scale becomes the depth of the well.
    let full = Array2::from_elem((3, 1), 1e4f32);
    let well = lit("saturation", &[("below", 0.4)], &full, &cx);
    assert!(well.iter().all(|q| (q - 6000.0).abs() < 0.1), "{well}");
    let spilled = lit("saturation", &[("below", 0.4), ("spill", 0.5)], &full, &cx);
    assert!((spilled[[0, 0]] - 7000.0).abs() < 0.1 && (spilled[[1, 0]] - 8000.0).abs() < 0.1, "{spilled}");
    let vignetted = lit("vignetting", &[("v", 0.5)], &Array2::from_elem((3, 4), 100.0), &cx);
    // Corner: (1^2 + 1.5^2) / (1.5^2 + 2^2) = 0.52.
    near(f64::from(vignetted[[0, 3]]), 74.0);
    let bands = lit(
        "flicker_banding",
        &[("m_sin", 0.1), ("cycles_per_row", 0.25), ("frame_hz", 0.25)],
        &Array2::ones((4, 1)),
        &cx,
    );
    // Three quarters of a turn at 3 s.
    for (found, want) in bands.iter().zip([0.9, 1.0, 1.1, 1.0]) {
        near(f64::from(*found), want);
    }
}

#[test]
fn worked_examples_of_images_beside_and_across() {
    let previous = image();
    let cx = context(&previous);
    let mut spot = Array2::<f32>::zeros((9, 11));
    spot[[2, 4]] = 1000.0;
    // The centre of the sensor is (4, 5): a point at (2, 4) turned about (4.5, 5) is at (7, 6).
    let ghost = lit("ghost", &[("ratio", 0.1), ("centre_row", 0.5)], &spot, &cx);
    assert_eq!((ghost[[7, 6]], ghost[[2, 4]], ghost.sum()), (100.0, 1000.0, 1100.0));
    let between = lit("ghost", &[("ratio", 0.1), ("centre_row", 0.5), ("centre_col", 0.25)], &spot, &cx);
    // The weight of a pixel of which `spot` is one, where the image is displaced by d pixels.
    let weight = |at: usize, spot: isize, d: f64| {
        let (first, weights) = crate::interpolation::weights(at as f64 - d);
        weights[(spot - first) as usize] as f32
    };
    // Half a pixel beside (7, 6).
    let half = 100.0 * weight(6, 6, 0.5);
    assert!((between[[7, 6]] - half).abs() < 1e-3 && (between[[7, 7]] - half).abs() < 1e-3 && half > 60.0);
    // A lamp lights what lies beyond the sensor as well.
    let (even, of_flat) = (Array2::from_elem((9, 11), 64.0f32), FrameContext { role: Role::Flat, ..cx });
    let [halo, ghost] = [("halo", "weight"), ("ghost", "ratio")].map(|(id, p)| lit(id, &[(p, 0.25)], &even, &of_flat));
    assert_eq!([&halo, &ghost], [&even; 2]);
    // Anchors 4.75 columns and a quarter of a row apart.
    let leak = lit("lens_leakage", &[("kappa", 0.16)], &spot, &cx);
    for at in [[2, 9], [1, 8], [2, 8]] {
        let want = spot[at] + 160.0 * weight(at[0], 2, -0.25) * weight(at[1], 4, 4.75);
        assert!((leak[at] - want).abs() < 1e-2, "{at:?}: {} for {want}", leak[at]);
    }
    assert!(leak[[2, 9]] > 120.0);
    let moving = lit("motion_blur", &[("var_row_px2", 0.2), ("cov_px2", 0.08)], &spot, &cx);
    // 0.2 and 0.08 px^2 of the light of a pixel, whose blur is that of no wave above the Nyquist frequency.
    let moment = |of: &dyn Fn(f32, f32) -> f32| -> f32 {
        moving.indexed_iter().map(|((r, c), v)| v * of(r as f32 - 2.0, c as f32 - 4.0)).sum()
    };
    assert!((moving.sum() - 1000.0).abs() < 2.0 && moving[[1, 4]] > 100.0 && moving[[3, 5]] > moving[[3, 3]]);
    // The edges, two pixels away, mirror a part.
    assert!((40.0..80.0).contains(&moment(&|r, c| r * c)), "{}", moment(&|r, c| r * c));
    let bead = FrameContext { role: Role::Bead, ..cx };
    assert_eq!(lit("motion_blur", &[("var_row_px2", 0.2)], &spot, &bead), spot);
    // What is blurred, and freed of as much blur, is as it was.
    let even = lit("motion_blur", &[("var_row_px2", 1.0), ("var_col_px2", 1.0)], &spot, &cx);
    let blurred = lit("motion_blur", &[("var_row_px2", 0.5), ("var_col_px2", 0.5)], &even, &cx);
    let sharp = lit("truth_blur", &[("var_px2", 0.5)], &blurred, &cx);
    let most = even.iter().fold(0.0f32, |m, v| m.max(*v));
    assert!((&sharp - &even).iter().all(|v| v.abs() < 1e-3 * most), "{}", &sharp - &even);
    assert!((&blurred - &even).iter().any(|v| v.abs() > 0.1 * most));
    assert_eq!(lit("truth_blur", &[("var_px2", 0.5)], &spot, &bead), spot);
    let ranked = lit("rank_truncation", &[("terms", 0.4)], &spot, &cx);
    assert!((ranked.sum() - 1000.0).abs() < 1e-2 && ranked[[2, 4]] < 1000.0 && ranked[[2, 5]] > 0.0);
    // Squares: 1e6 / 1e4 x 0.02 / 2 to each neighbour.
    let fat = lit("brighter_fatter", &[("alpha", 0.02)], &spot, &cx);
    assert!((fat[[2, 3]] - 1.0).abs() < 1e-4 && (fat[[2, 4]] - 996.0).abs() < 1e-3);
}

/// Predictions can be slightly negative because of errors of the PSFs. A very weak effect must change them very little.
#[test]
fn weak_effects_leave_light_below_zero_as_it_is() {
    let previous = image();
    let cx = context(&previous);
    let below = image().mapv(|v| v - 12.0);
    for (id, params) in [
        ("motion_blur", vec![("var_row_px2", 1e-6), ("cov_px2", 1e-6)]),
        ("truth_blur", vec![("var_px2", 1e-6)]),
        ("rank_truncation", vec![("terms", 1e-6)]),
        ("unknown_operator", vec![("amplitude", 1e-6), ("operator", 3.0)]),
        (
            "unknown_profile",
            vec![("knot_00", 1e-6), ("covariate", 0.0), ("additive", 1.0), ("low", 0.0), ("high", 8.0)],
        ),
    ] {
        let change = lit(id, &params, &below, &cx) - &below;
        assert!(change.iter().all(|v| v.abs() < 1e-3), "{id}: {change}");
        assert!(change.iter().any(|v| *v != 0.0), "{id}");
    }
}

#[test]
fn maps_of_scenes_leave_flats_as_they_are() {
    let previous = image();
    let scene = context(&previous);
    let flat = FrameContext { role: Role::Flat, ..scene };
    let table = ndarray::arr2(&[[0.5, -2.0]]);
    let layout = Layout { lenses: 2, sensor: [1, 2] };
    let frame = |id: &str, cx: &FrameContext<'_>| {
        let mut chain = Chain::default();
        let effect = find(id).unwrap();
        let off = effect.descriptor().expanded(2).iter().map(|(_, p)| p.off).collect();
        chain.push(effect, off, Some(&table), layout).unwrap();
        let mut image = ndarray::arr2(&[[10.0f32, 10.0]]);
        chain.on_lens(&mut image, cx);
        chain.on_light(&mut image, cx);
        chain.on_electronics(&mut image, cx);
        image
    };
    // Of the first lens, whose number is the default.
    assert_eq!(scene.lens, 0);
    assert_eq!(frame("unknown_view", &scene), ndarray::arr2(&[[15.0, 0.0]]));
    assert_eq!(frame("unknown_view", &FrameContext { lens: 1, ..scene }), ndarray::arr2(&[[10.0, 10.0]]));
    // 10 ms; light is never negative.
    assert_eq!(frame("unknown_shading", &scene), ndarray::arr2(&[[15.0, 0.0]]));
    // A dark signal is there without light as well.
    let dark = [&scene, &flat].map(|cx| frame("unknown_dark", cx));
    assert!(dark.iter().all(|image| *image == ndarray::arr2(&[[15.0, -10.0]])));
    assert_eq!(frame("unknown_light", &scene), ndarray::arr2(&[[15.0, 0.0]]));
    assert_eq!(frame("unknown_stray", &scene), ndarray::arr2(&[[15.0, 0.0]]));
    assert_eq!(frame("unknown_offset", &scene), ndarray::arr2(&[[10.5, 8.0]]));
    for id in ["unknown_shading", "unknown_light", "unknown_stray", "unknown_offset", "unknown_view"] {
        assert_eq!(frame(id, &flat), ndarray::arr2(&[[10.0, 10.0]]), "{id}");
    }
}

#[test]
fn a_gradient_follows_a_parabola_of_the_place() {
    let previous = image();
    let cx = context(&previous);
    let even = Array2::from_elem((3, 5), 100.0f32);
    let planes = lit("unknown_gradient", &[("by_row", 0.1), ("by_col", -0.2)], &even, &cx);
    // Rows -1, 0, 1, columns -1, -0.5, 0, 0.5, 1.
    let worked = Array2::from_shape_fn((3, 5), |(r, c)| 100.0 + 10.0 * (r as f32 - 1.0) - 10.0 * (c as f32 - 2.0));
    assert!((planes - worked).iter().all(|v| v.abs() < 1e-4));
    let saddle = [("by_row_squared", -0.3), ("by_col_squared", 0.3), ("by_row_and_col", 0.4)];
    let bent = lit("unknown_gradient", &saddle, &even, &cx);
    let at = |r: usize, c: usize| bent[[r, c]];
    assert!((at(1, 2) - 100.0).abs() < 1e-4 && (at(0, 2) - 70.0).abs() < 1e-4 && (at(1, 4) - 130.0).abs() < 1e-4);
    assert!((at(0, 0) - 140.0).abs() < 1e-4 && (at(0, 4) - 60.0).abs() < 1e-4);
    // Light is never negative.
    assert_eq!(lit("unknown_gradient", &[("by_row", 2.0)], &even, &cx)[[0, 0]], 0.0);
}

#[test]
fn worked_examples_of_a_smear_a_gamma_and_a_blur() {
    let previous = image();
    let cx = context(&previous);
    let smeared = lit("column_smear", &[("share", 0.1)], &ndarray::arr2(&[[0.0, 0.0], [100.0, 40.0]]), &cx);
    assert_eq!(smeared, ndarray::arr2(&[[5.0, 2.0], [105.0, 42.0]]));
    // Full scale 10^4 DN at one DN per electron, black level 2 DN: a quarter of it becomes half.
    let bent = electronic("camera_gamma", &[("gamma", 0.5)], &ndarray::arr2(&[[2502.0, 10_002.0, 1.0]]), &cx);
    assert_eq!(bent, ndarray::arr2(&[[5002.0, 10_002.0, 1.0]]));
    let mut point = Array2::<f32>::zeros((9, 9));
    point[[4, 4]] = 100.0;
    let wide = lit("unknown_blur", &[("var_row_px2_0", 0.2), ("var_row_px2_1", 9.0)], &point, &cx);
    // More than the 10 and less than the 80 of second differences; the columns stay where they are.
    assert_eq!([wide[[3, 4]], wide[[4, 4]], wide[[4, 3]]].map(f32::round), [13.0, 75.0, 0.0]);
    // The same variance with the other sign takes it back.
    let narrow = lit("unknown_blur", &[("var_row_px2_0", -0.2)], &wide, &cx);
    assert!((&narrow - &point).iter().all(|v| v.abs() < 2.0), "{narrow}");
}

#[test]
fn the_response_falls_with_the_square_of_the_distance_from_the_axis_of_the_lens() {
    let previous = image();
    let cx = context(&previous);
    let cx = FrameContext { pixel_pitch_um: 20.0, ..cx };
    let found = lit("chief_ray_response", &[("c_per_mm2", 10.0)], &Array2::from_elem((9, 11), 100.0), &cx);
    // Axis at (4, 4), pixels of 20 um: at (4, 9) the distance is 0.1 mm, at (0, 1) it is 5 px as well.
    for (at, want) in [([4, 4], 100.0), ([4, 9], 90.0), ([0, 1], 90.0), ([4, 5], 99.6)] {
        close(f64::from((found[at] * 1e3).round()), want * 1e3);
    }
    let second = FrameContext { lens: 1, ..cx };
    let found = lit("chief_ray_response", &[("c_per_mm2", 10.0)], &Array2::from_elem((9, 11), 100.0), &second);
    assert_eq!(found[[4, 6]], 100.0);
}

#[test]
fn telegraph_pixels_have_two_levels_and_keep_their_places() {
    let cx = FrameContext::default();
    let layout = Layout { lenses: 1, sensor: [100, 120] };
    let on = [setting("telegraph_pixels", &[("amplitude_dn", 10.0), ("share", 0.01)])];
    let chain = Chain::build(&on, layout).unwrap();
    let mut rng = stream(4, "telegraph", 0);
    let (mut low, mut high) = (Array2::<f32>::zeros((100, 120)), Array2::<f32>::zeros((100, 120)));
    let mut sum = Array2::<f32>::zeros((100, 120));
    for _ in 0..400 {
        let mut frame = Array2::<f32>::zeros((100, 120));
        chain.on_reading(&mut frame, &cx, &mut rng);
        low.zip_mut_with(&frame, |l, v| *l = l.min(*v));
        high.zip_mut_with(&frame, |h, v| *h = h.max(*v));
        sum += &frame;
    }
    // 120 draws of a place, a few of them twice: those add up.
    let jumping = low.iter().filter(|v| **v < 0.0).count();
    assert!((112..=120).contains(&jumping), "{jumping}");
    let single = low.iter().zip(&high).filter(|(l, h)| **l == -5.0 && **h == 5.0).count();
    assert!(single + 8 >= jumping, "{single} of {jumping}");
    // Both levels are equally likely: 5 / sqrt(400) = 0.25 DN for each.
    let mean = sum.sum() / 400.0 / 120.0;
    assert!(mean.abs() < 0.1, "{mean}");
}

#[test]
fn worked_examples_of_readout() {
    let previous = image();
    let cx = context(&previous);
    let rows = electronic("row_pattern", &[("amplitude_dn", 2.0), ("period_rows", 2.0)], &Array2::zeros((3, 1)), &cx);
    assert_eq!(rows, ndarray::arr2(&[[2.0], [-2.0], [2.0]]));
    let cols = electronic("column_pattern", &[("quadrature_dn", 2.0)], &Array2::zeros((1, 4)), &cx);
    assert_eq!(cols.mapv(f32::round), ndarray::arr2(&[[0.0, 2.0, 0.0, -2.0]]));
    let lagging = electronic("readout_lag", &[("share", 0.1)], &ndarray::arr2(&[[10.0, 110.0, 10.0]]), &cx);
    assert_eq!(lagging, ndarray::arr2(&[[10.0, 100.0, 20.0]]));
    assert_eq!(electronic("black_level_drift", &[("rate_dn_per_s", -1.0)], &Array2::ones((1, 1)), &cx)[[0, 0]], -2.0);
    let codes = ndarray::arr2(&[[2501.0, 2503.0]]);
    let jumped = electronic("adc_nonlinearity", &[("step_dn", 4.0)], &codes, &cx);
    assert_eq!(jumped, ndarray::arr2(&[[2501.0, 2507.0]]));
    let mut noise = sensor_noise();
    chain("noise_scale", &[("read_noise", 0.5), ("gain", -0.1)]).on_noise(&mut noise);
    assert_eq!((noise.read_noise_e, noise.gain_dn_per_e), (3.0, 0.45));
    let mut frame = Array2::zeros((4000, 2));
    chain("row_noise", &[("sigma_dn", 2.0)]).on_reading(&mut frame, &cx, &mut stream(1, "rows", 0));
    assert_eq!(frame.column(0), frame.column(1));
    let rms = (frame.mapv(|v: f32| v * v).mean().unwrap()).sqrt();
    assert!((rms - 2.0).abs() < 0.1, "{rms}");
}
