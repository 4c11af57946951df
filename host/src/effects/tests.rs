#![allow(clippy::unwrap_used)]

use super::*;
use crate::noise::Sources;
use crate::rng::stream;
use crate::session::Role;
use ndarray::Array2;

fn image() -> Array2<f32> {
    Array2::from_shape_fn((9, 11), |(r, c)| ((r * 31 + c * 17) % 23) as f32 + 0.125)
}

const LAYOUT: Layout = Layout { lenses: 2, sensor: [9, 11] };
static ANCHORS: [[f64; 2]; 2] = [[4.25, 2.5], [4.0, 7.25]];

/// The second scene of a stack, late, in the first lens.
fn context(previous: &Array2<f32>) -> FrameContext<'_> {
    FrameContext {
        frame: 1,
        time_s: 3.0,
        exposure_ms: 10.0,
        temperature_c: 30.0,
        array: [1, 2],
        anchors_px: &ANCHORS,
        full_scale_e: 1e4,
        black_level_dn: 2.0,
        previous: Some(Previous { light_e: previous, interval_s: 0.02 }),
        ..Default::default()
    }
}

fn setting(id: &str, params: &[(&str, f64)]) -> EffectSetting {
    EffectSetting::new(id, params)
}

fn chain(id: &str, params: &[(&str, f64)]) -> Chain {
    Chain::build(&[setting(id, params)], LAYOUT).unwrap()
}

const RAY: Ray = Ray {
    lens: 0,
    object_um: [30.0, -50.0],
    field_px: [10.0, -17.0],
    axis_px: [12.0, -11.0],
    anchor_px: [-20.0, 15.0],
    pixel_pitch_um: 1.85,
};

/// What an effect does at each stage: images of the five stages that have one, the shift of a ray, the record, the noise, and a
/// drawn reading.
#[derive(PartialEq)]
struct Deeds {
    images: Vec<Array2<f32>>,
    shift: RayShift,
    record: Record,
    noise: NoiseModel,
    reading: Array2<f32>,
}

fn deeds(chain: &Chain) -> Deeds {
    let previous = image() * 2.0;
    let cx = context(&previous);
    // Charge and codes reach up to full scale, where some effects begin.
    let mut images = vec![image(), image(), image(), image() * 400.0, image() * 400.0];
    chain.on_object(&mut images[0], &cx);
    chain.on_lens(&mut images[1], &cx);
    chain.on_light(&mut images[2], &cx);
    chain.on_charge(&mut images[3], &cx);
    chain.on_electronics(&mut images[4], &cx);
    let mut record = Record::honest(1, 4);
    chain.on_record(&mut record, &cx);
    let mut noise = sensor_noise();
    chain.on_noise(&mut noise);
    let mut reading = image();
    chain.on_reading(&mut reading, &cx, &mut stream(1, "reading", 0));
    Deeds { images, shift: chain.shift_ray(&RAY, &cx), record, noise, reading }
}

fn sensor_noise() -> NoiseModel {
    NoiseModel {
        black_level_dn: 2.0,
        gain_dn_per_e: 0.5,
        gain_sigma: 0.0,
        read_noise_e: 2.0,
        read_noise_sigma: 0.0,
        saturation_dn: 4095.0,
        sources: Sources::default(),
    }
}

fn dimmest(images: &[Array2<f32>]) -> f32 {
    images.iter().flatten().fold(f32::INFINITY, |m, v| m.min(*v))
}

#[test]
fn switched_off_is_absent_bit_for_bit_and_switched_on_acts_at_its_stage_only() {
    let absent = deeds(&Chain::default());
    for effect in registry() {
        let d = effect.descriptor();
        let off: Vec<f64> = d.expanded(2).iter().map(|(_, p)| p.off).collect();
        // Not even the hooks themselves may act on an effect that is off.
        let mut hooked = Chain::default();
        hooked.push_even_if_off(*effect, off.clone());
        assert!(deeds(&hooked) == absent, "{} is not off", d.id);
        for (i, (name, p)) in d.expanded(2).into_iter().enumerate().filter(|(_, (_, p))| p.is_strength()) {
            let mut on = off.clone();
            on[i] += p.step;
            let mut chain = Chain::default();
            chain.push(*effect, on, None, LAYOUT).unwrap();
            let found = deeds(&chain);
            let stages = [Stage::Object, Stage::Lens, Stage::Light, Stage::Charge, Stage::Electronics];
            for (stage, (after, before)) in stages.iter().zip(found.images.iter().zip(&absent.images)) {
                assert!(after == before || *stage == d.stage, "{} acts at {stage:?}", d.id);
            }
            assert!(found.shift == absent.shift || d.stage == Stage::Geometry, "{}", d.id);
            assert!(found.record == absent.record || d.stage == Stage::Record, "{}", d.id);
            // A parameter of the second lens does nothing in the first.
            assert!(found != absent || name.ends_with("_1"), "{} does nothing with {name}", d.id);
            assert!(dimmest(&found.images) > -100.0, "{}", d.id);
        }
    }
}

#[test]
fn descriptors_are_sound() {
    let mut seen = std::collections::BTreeSet::new();
    for d in registry().iter().map(|e| e.descriptor()) {
        assert!(seen.insert(d.id) && !d.params.is_empty() && !d.summary.is_empty(), "{}", d.id);
        assert!(d.params.iter().any(|p| p.is_strength()), "{}", d.id);
        for l in d.lookalikes {
            assert!(find(l.id).is_some() && !l.separate_by.is_empty(), "{} and {}", d.id, l.id);
        }
        for p in d.params {
            assert!(p.min <= p.off && p.off <= p.max, "{} {}", d.id, p.name);
            let fits = p.step > 0.0 && p.off + p.step <= p.max;
            assert!(fits || p.kind == Kind::Choice, "{} {}", d.id, p.name);
        }
    }
    for stage in Stage::ALL {
        assert!(registry().iter().any(|e| e.descriptor().stage == stage), "{stage:?}");
    }
}

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
    near(shifted("array_rotation", &[("angle_mrad", 2.0)]), [0.03, 0.04], 0.0);
    near(shifted("lens_decentre", &[("row_px_0", 0.5), ("row_px_1", 9.0), ("col_px_0", -0.25)]), [0.5, -0.25], 0.0);
    near(shifted("magnification", &[("eps", 0.01)]), [0.12, -0.11], 0.0);
    near(shifted("stage_scale", &[("row_by_row", 0.01), ("col_by_row", 0.1)]), [0.1, 1.0], 0.0);
    near(shifted("thermal_drift", &[("col_px_per_s", 0.5)]), [0.0, 1.5], 0.0);
    let r2_mm2 = 265.0 * 1.85e-3f64.powi(2);
    near(shifted("radial_distortion", &[("k1_per_mm2", 2.0)]), [24.0 * r2_mm2, -22.0 * r2_mm2], 0.0);
    near(shifted("defocus", &[("z_um", -30.0)]), [0.0, 0.0], -30.0);
    near(shifted("field_curvature", &[("a_um_per_mm2", 1000.0)]), [0.0, 0.0], 1000.0 * r2_mm2);
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
    // What would fill the converter fills the well.
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
    assert_eq!((between[[7, 6]], between[[7, 7]]), (50.0, 50.0));
    // Anchors 4.75 columns and a quarter of a row apart.
    let leak = lit("lens_leakage", &[("kappa", 0.16)], &spot, &cx);
    assert!(
        (leak[[2, 9]] - 90.0).abs() < 1e-3 && (leak[[1, 8]] - 10.0).abs() < 1e-3 && (leak.sum() - 1160.0).abs() < 1e-2
    );
    let moving = lit("motion_blur", &[("var_row_px2", 0.2), ("cov_px2", 0.08)], &spot, &cx);
    assert!((moving[[1, 4]] - 100.0).abs() < 1e-3 && (moving[[3, 5]] - 20.0).abs() < 1e-3 && moving[[3, 3]] == 0.0);
    let bead = FrameContext { role: Role::Bead, ..cx };
    assert_eq!(lit("motion_blur", &[("var_row_px2", 0.2)], &spot, &bead), spot);
    let ranked = lit("rank_truncation", &[("terms", 0.4)], &spot, &cx);
    assert!((ranked.sum() - 1000.0).abs() < 1e-2 && ranked[[2, 4]] < 1000.0 && ranked[[2, 5]] > 0.0);
    // Squares: 1e6 / 1e4 x 0.02 / 2 to each neighbour.
    let fat = lit("brighter_fatter", &[("alpha", 0.02)], &spot, &cx);
    assert!((fat[[2, 3]] - 1.0).abs() < 1e-4 && (fat[[2, 4]] - 996.0).abs() < 1e-3);
}

/// A prediction is a little negative where the errors of PSFs outweigh the light. An effect next to nothing then changes next to nothing.
#[test]
fn weak_effects_leave_light_below_zero_as_it_is() {
    let previous = image();
    let cx = context(&previous);
    let below = image().mapv(|v| v - 12.0);
    for (id, params) in [
        ("motion_blur", vec![("var_row_px2", 1e-6), ("cov_px2", 1e-6)]),
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

#[test]
fn tables_have_what_was_asked_for() {
    let drawn = |id: &str, params: &[f64]| find(id).unwrap().draw_table(params, [200, 300]);
    let rms = |t: &Array2<f32>| t.mapv(|v| v * v).mean().unwrap().sqrt();
    assert!((rms(&drawn("prnu", &[0.01, 1.0])) - 0.01).abs() < 2e-4);
    assert!((rms(&drawn("dsnu", &[2.0, 1.0])) - 2.0).abs() < 4e-2);
    assert_ne!(drawn("prnu", &[0.01, 1.0]), drawn("prnu", &[0.01, 2.0]));
    let hot = drawn("hot_pixels", &[5.0, 0.01, 1.0]);
    let lit: Vec<f32> = hot.iter().copied().filter(|v| *v > 0.0).collect();
    assert!((560..=600).contains(&lit.len()), "{}", lit.len());
    assert!((lit.iter().sum::<f32>() / lit.len() as f32 - 5.0).abs() < 0.8);
    let dust = drawn("dust", &[0.2, 10.0, 4.0, 1.0]);
    let covered = dust.iter().filter(|v| **v < 0.0).count();
    assert!(dust.iter().all(|v| (-0.2..=0.0).contains(v)) && (300..900).contains(&covered), "{covered}");
    let cx = context(&dust);
    let light = lit_with_table("prnu", TableUse::Response, &cx);
    assert!((light - 110.0).abs() < 1e-4);
    assert!((lit_with_table("hot_pixels", TableUse::DarkRate, &cx) - 101.0).abs() < 1e-4);
}

/// 100 electrons with a table of 0.1 in 10 ms.
fn lit_with_table(id: &str, acts: TableUse, cx: &FrameContext<'_>) -> f32 {
    assert_eq!(find(id).unwrap().table().unwrap().acts, acts);
    let mut with = setting(id, &[]);
    with.table = Some(Array2::from_elem((1, 11), 0.1));
    let mut light = Array2::from_elem((9, 11), 100.0);
    Chain::build(&[with], LAYOUT).unwrap().on_light(&mut light, cx);
    light[[3, 3]]
}

#[test]
fn records_are_put_right() {
    let record = |params: &[(&str, f64)], frame: usize| {
        let previous = image();
        let mut record = Record::honest(frame, 5);
        chain("metadata_fault", params).on_record(&mut record, &FrameContext { frame, ..context(&previous) });
        record
    };
    let honest = |frame| Record::honest(frame, 5);
    let factor = [("exposure_factor", 2.0), ("frame", 3.0)];
    assert_eq!(record(&factor, 3), Record { exposure_factor: 2.0, ..honest(3) });
    assert_eq!(record(&factor, 2), honest(2));
    assert!((0..5).all(|f| record(&[("flip_rows", 1.0)], f).flip_rows));
    let truths = |params: &[(&str, f64)]| (0..5).map(|f| record(params, f).truth).collect::<Vec<_>>();
    assert_eq!(truths(&[("swapped_with_next", 1.0)]), [1, 0, 3, 2, 4]);
    assert_eq!(truths(&[("swapped_with_next", 1.0), ("frame", 1.0)]), [0, 2, 1, 3, 4]);
    assert_eq!(truths(&[("swapped_with_next", 1.0), ("frame", 4.0)]), [0, 1, 2, 3, 4]);
}

/// Residuals that are exactly what an effect does to three frames of uneven light, 12 ms apart.
fn evidence_of(id: &str, params: &[(&str, f64)]) -> Evidence<'static> {
    let sensor = [96, 90];
    let chain = Chain::build(&[setting(id, params)], Layout { lenses: 2, sensor }).unwrap();
    let frames = (0..3).map(|k| {
        let cx = FrameContext { frame: k, time_s: 0.012 * k as f64, ..FrameContext::default() };
        let spots = |(r, c)| if (r * 37 + c * 11 + k * 5) % 101 < 4 { 900.0 } else { 40.0f32 };
        let light_e = Array2::from_shape_fn((sensor[0], sensor[1]), spots);
        let mut with = light_e.clone();
        chain.on_light(&mut with, &cx);
        chain.on_electronics(&mut with, &cx);
        EvidenceFrame { cx, residual_dn: with - &light_e, weight: light_e.mapv(|l| 1.0 / (l + 4.0)), light_e }
    });
    Evidence { frames: frames.collect() }
}

#[test]
fn shapes_are_guessed_from_residuals() {
    let first = |id: &str, params: &[(&str, f64)]| {
        let guesses = find(id).unwrap().guess(&evidence_of(id, params));
        assert!(!guesses.is_empty() && guesses.iter().all(|g| g.len() == find(id).unwrap().descriptor().params.len()));
        guesses[0].clone()
    };
    let ghost = first("ghost", &[("ratio", 0.02), ("centre_row", 6.5), ("centre_col", -11.0)]);
    assert_eq!(ghost, [0.0, 6.5, -11.0]);
    let rows = first("row_pattern", &[("quadrature_dn", 1.0), ("period_rows", 7.3)]);
    assert!((1.0 / rows[2] - 1.0 / 7.3).abs() < 0.5 / 96.0 / 4.0 + 1e-9, "{rows:?}");
    let even = first("row_pattern", &[("amplitude_dn", 1.0), ("period_rows", 2.0)]);
    assert_eq!(even[2], 2.0);
    let cols = first("column_pattern", &[("amplitude_dn", 1.0), ("period_cols", 5.0)]);
    assert!((1.0 / cols[2] - 0.2).abs() < 0.5 / 90.0 / 4.0 + 1e-9, "{cols:?}");
    // 30 Hz is below half the rate of 83 frames a second; three frames tell it to some Hz.
    let bands = first("flicker_banding", &[("m_cos", 0.01), ("cycles_per_row", 0.073), ("frame_hz", 30.0)]);
    assert!((bands[2] - 0.073).abs() < 0.5 / 96.0 / 2.0 && (bands[3] - 30.0).abs() < 6.0, "{bands:?}");
    let mut evidence = evidence_of("lamp_drift", &[]);
    evidence.frames[2].residual_dn.fill(5.0);
    assert_eq!(
        find("metadata_fault").unwrap().guess(&evidence)[..2],
        [[1.0, 0.0, 0.0, 0.0, -1.0], [1.0, 0.0, 0.0, 0.0, 2.0]]
    );
    for effect in registry() {
        effect.guess(&Evidence::default());
    }
}

#[test]
fn nothing_panics_on_what_is_not_there() {
    let empty = Array2::<f32>::zeros((0, 0));
    for effect in registry() {
        let d = effect.descriptor();
        let on: Vec<f64> =
            d.expanded(2).iter().map(|(_, p)| p.off + if p.is_strength() { p.step } else { 0.0 }).collect();
        for shape in [(0, 0), (0, 5), (5, 0), (1, 1), (1, 7), (7, 1)] {
            for cx in [FrameContext::default(), FrameContext { lens: 7, exposure_ms: 0.0, ..context(&empty) }] {
                let sensor = [shape.0, shape.1];
                let mut chain = Chain::default();
                chain.push(*effect, on.clone(), None, Layout { lenses: 2, sensor }).unwrap();
                let mut image = Array2::<f32>::zeros(shape);
                chain.on_object(&mut image, &cx);
                chain.on_lens(&mut image, &cx);
                chain.on_light(&mut image, &cx);
                chain.on_charge(&mut image, &cx);
                chain.on_electronics(&mut image, &cx);
                chain.on_reading(&mut image, &cx, &mut stream(1, "empty", 0));
                chain.shift_ray(&Ray { lens: 7, ..RAY }, &cx);
                chain.on_record(&mut Record::honest(0, 0), &cx);
                assert!(image.iter().all(|v| v.is_finite()), "{} {shape:?}", d.id);
            }
        }
    }
}

#[test]
fn bad_settings_are_named() {
    let message = |s: EffectSetting| Chain::build(&[s], LAYOUT).unwrap_err().to_string();
    assert!(message(setting("haloo", &[])).contains("`haloo`: unknown; known are excitation_profile"));
    assert!(message(setting("halo", &[("wight", 0.1)])).contains("no parameter `wight`; it has weight, sigma_px"));
    assert!(message(setting("halo", &[("weight", 2.0)])).contains("expected 0 to 1"));
    assert!(message(setting("halo", &[("weight", f64::NAN)])).contains("found NaN"));
    assert!(message(setting("lens_gain", &[("change_2", 0.1)])).contains("it has change_0, change_1"));
    assert!(!chain("halo", &[]).acts_at(Stage::Light));
}

/// A typical frame: spots of 1.6 px rms, as the lenses see a specimen, brightest 7000 electrons; its lenses one by one.
fn typical() -> (Vec<Array2<f32>>, Vec<[f64; 2]>) {
    let anchors: Vec<[f64; 2]> =
        (0..9).map(|l| [106.5 + 50.0 * (l / 3) as f64 - 50.0, 106.5 + 50.0 * (l % 3) as f64 - 50.0]).collect();
    let mut object = Array2::<f32>::zeros((97, 97));
    for i in 0..160usize {
        let at = [(i * 7919) % 89 + 4, (i * 104_729) % 89 + 4];
        object[at] += 1.0 + (i % 7) as f32;
    }
    let mut object = smooth::gaussian_blur(&object, 1.6);
    object += 0.02;
    let place = |anchor: &[f64; 2]| {
        let mut image = Array2::<f32>::zeros((214, 214));
        let corner = anchor.map(|a| a.round() as usize - 48);
        image.slice_mut(ndarray::s![corner[0]..corner[0] + 97, corner[1]..corner[1] + 97]).assign(&object);
        image
    };
    let mut lenses: Vec<_> = anchors.iter().map(place).collect();
    let peak = lenses.iter().fold(Array2::<f32>::zeros((214, 214)), |s, i| s + i).fold(0.0f32, |m, v| m.max(*v));
    lenses.iter_mut().for_each(|i| *i *= 7000.0 / peak);
    (lenses, anchors)
}

#[test]
fn steps_are_a_few_sigma_of_one_typical_frame() {
    let (lenses, anchors) = typical();
    let sum: Array2<f32> = lenses.iter().fold(Array2::zeros((214, 214)), |s, i| s + i);
    let previous = sum.slice(ndarray::s![..;-1, ..]).to_owned();
    let cx = FrameContext {
        frame: 1,
        time_s: 0.1,
        exposure_ms: 10.0,
        array: [3, 3],
        anchors_px: &anchors,
        full_scale_e: 1e4,
        black_level_dn: 64.0,
        gain_dn_per_e: 0.4,
        previous: Some(Previous { light_e: &previous, interval_s: 0.02 }),
        ..Default::default()
    };
    let layout = Layout { lenses: 9, sensor: [214, 214] };
    let frame = |chain: &Chain| {
        let mut light = Array2::<f32>::zeros((214, 214));
        for (lens, image) in lenses.iter().enumerate() {
            let cx = FrameContext { lens, ..cx };
            let mut image = image.clone();
            chain.on_object(&mut image, &cx);
            if chain.acts_at(Stage::Geometry) {
                let from = image.clone();
                for r in 1..213 {
                    for c in 1..213 {
                        let field = [r as f64 - anchors[lens][0], c as f64 - anchors[lens][1]];
                        let anchor = anchors[lens].map(|a| a - 106.5);
                        let axis = [0, 1].map(|a| field[a] + anchor[a] * 0.4);
                        let ray = Ray {
                            lens,
                            object_um: field.map(|v| v * 2.8),
                            field_px: field,
                            axis_px: axis,
                            anchor_px: anchor,
                            pixel_pitch_um: 1.85,
                        };
                        let s = chain.shift_ray(&ray, &cx);
                        // Defocus of 100 um widens a spot by about a tenth of a pixel squared.
                        let wide = 0.5e-3 * s.z_um;
                        let d = [from[[r + 1, c]] - from[[r - 1, c]], from[[r, c + 1]] - from[[r, c - 1]]];
                        let curve = from[[r + 1, c]] + from[[r - 1, c]] + from[[r, c + 1]] + from[[r, c - 1]]
                            - 4.0 * from[[r, c]];
                        image[[r, c]] -= 0.5 * (s.px[0] as f32 * d[0] + s.px[1] as f32 * d[1]) - wide as f32 * curve;
                    }
                }
            }
            chain.on_lens(&mut image, &cx);
            light += &image;
        }
        chain.on_light(&mut light, &cx);
        chain.on_charge(&mut light, &cx);
        let mut dn = light * 0.4 + 64.0;
        chain.on_electronics(&mut dn, &cx);
        dn
    };
    let plain = frame(&Chain::default());
    let variance = plain.mapv(|v| 0.4 * (v - 64.0) + 0.64 + 1.0 / 12.0);
    let named = registry().iter().filter(|e| !e.descriptor().id.starts_with("unknown"));
    for effect in named.filter(|e| !e.noise_only() && e.descriptor().stage != Stage::Record) {
        let d = effect.descriptor();
        let off: Vec<f64> = d.expanded(9).iter().map(|(_, p)| p.off).collect();
        for (i, (name, p)) in d.expanded(9).into_iter().enumerate().filter(|(_, (_, p))| p.is_strength()) {
            // One lens stands for all.
            if p.per_lens && !name.ends_with("_4") {
                continue;
            }
            let mut on = off.clone();
            on[i] += p.step;
            let mut chain = Chain::default();
            chain.push(*effect, on, None, layout).unwrap();
            let chi2 = (frame(&chain) - &plain).mapv(|d| d * d) / &variance;
            let sigma = chi2.sum().sqrt();
            println!("{} {name} {}: {sigma:.1} sigma", d.id, p.step);
            assert!((1.0..50.0).contains(&sigma), "{} {name}: {sigma} sigma", d.id);
        }
    }
}

/// The catalogue as a page.
fn page() -> String {
    let mut text = String::from(PAGE_HEAD);
    for stage in Stage::ALL {
        text += &format!(
            "\n## Stage `{}`\n\n| id | formula | parameters | looks like: what separates them |\n|---|---|---|---|\n",
            format!("{stage:?}").to_lowercase()
        );
        for d in registry().iter().map(|e| e.descriptor()).filter(|d| d.stage == stage) {
            let params: Vec<String> = d.params.iter().map(parameter).collect();
            let others: Vec<String> = d.lookalikes.iter().map(|l| format!("`{}`: {}", l.id, l.separate_by)).collect();
            text += &format!("| `{}` | {} | {} | {} |\n", d.id, d.summary, params.join("; "), others.join("; "));
        }
    }
    text
}

fn parameter(p: &Param) -> String {
    let unit = if p.unit == "1" { String::new() } else { format!(", {}", p.unit) };
    let each = if p.per_lens { " of each lens" } else { "" };
    match p.kind {
        Kind::Strength | Kind::Square if p.off == 0.0 => format!("**{}**{each}{unit}", p.name),
        Kind::Strength | Kind::Square => format!("**{}**{each}{unit} (absent: {})", p.name, p.off),
        Kind::Shape(_) | Kind::Choice => format!("{}{each}{unit} (default {})", p.name, p.off),
    }
}

const PAGE_HEAD: &str = "# Effects

What a real instrument does beyond its calibrated optics, in the order in which light meets it. Every effect has one definition
in `host/src/effects/`, which says more; the forward model applies it, `close` fits it, and the virtual bench injects it:
`ommatidia bench session --effect halo=0.05,sigma_px=20` sets the first parameter and others by name.

**Strengths** are in bold: with all of them at zero (or as stated) the effect is absent to the last bit. The other parameters are
shapes. This page is written from the descriptors; a test compares the two, and `OMMATIDIA_RENEW=1 cargo test -p ommatidia-host --lib
effects` writes it anew.
";

#[test]
fn the_page_of_effects_is_what_the_registry_says() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/effects.md");
    if std::env::var_os("OMMATIDIA_RENEW").is_some() {
        std::fs::write(&path, page()).unwrap();
    }
    let found = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(found == page(), "docs/effects.md is out of date: run this test with OMMATIDIA_RENEW=1");
}
