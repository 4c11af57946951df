#![allow(clippy::unwrap_used)]

mod steps;
mod worked;

use super::*;
use crate::noise::NoiseModel;
use crate::optics::Wavefront;
use ndarray::Array2;
use ommatidia_session::Role;
use ommatidia_session::rng::stream;
use rand_distr::{Distribution, StandardNormal};

fn image() -> Array2<f32> {
    Array2::from_shape_fn((9, 11), |(r, c)| ((r * 31 + c * 17) % 23) as f32 + 0.125)
}

const LAYOUT: Layout = Layout { lenses: 2, sensor: [9, 11] };
static ANCHORS: [[f64; 2]; 2] = [[4.25, 2.5], [4.0, 7.25]];
static AXES: [[f64; 2]; 2] = [[4.0, 4.0], [4.0, 6.0]];

/// The second scene of a stack, late, in the first lens.
fn context(previous: &Array2<f32>) -> FrameContext<'_> {
    FrameContext {
        frame: 1,
        time_s: 3.0,
        exposure_ms: 10.0,
        temperature_c: 30.0,
        anchors_px: &ANCHORS,
        axes_px: &AXES,
        pixel_pitch_um: 2.0,
        travel: [0.5, -1.5],
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
    px_per_um: 0.35,
};

/// Results of an effect at each stage: images of five stages, the shift of a ray, the record, the noise, and a noisy
/// reading.
#[derive(PartialEq)]
struct Deeds {
    images: Vec<Array2<f32>>,
    shift: RayShift,
    wavefront: Wavefront,
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
    let (shift, wavefront) = (chain.shift_ray(&RAY, &cx), chain.wavefront(&RAY, &cx));
    Deeds { images, shift, wavefront, record, noise, reading }
}

fn sensor_noise() -> NoiseModel {
    NoiseModel { black_level_dn: 2.0, gain_dn_per_e: 0.5, ..NoiseModel::nominal() }
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
            let moves = found.shift != absent.shift || found.wavefront != absent.wavefront;
            assert!(!moves || d.stage == Stage::Geometry, "{}", d.id);
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
fn the_share_of_telegraph_pixels_is_counted_where_jumps_stand_out() {
    let effect = find("telegraph_pixels").unwrap();
    let guess = |amplitude: f64, share: f64| {
        let on = setting("telegraph_pixels", &[("amplitude_dn", amplitude), ("share", share)]);
        let chain = Chain::build(&[on], Layout { lenses: 1, sensor: [96, 90] }).unwrap();
        let mut rng = stream(8, "jumps", 0);
        let frame = |k: usize| {
            // Three darks, so that the fourth frame is a flat without a partner among them.
            let role = if k < 3 { Role::Dark } else { Role::Flat };
            let mut residual_dn = Array2::from_shape_simple_fn((96, 90), || {
                let z: f32 = StandardNormal.sample(&mut rng);
                z
            });
            let cx = FrameContext { role, frame: k, ..FrameContext::default() };
            chain.on_reading(&mut residual_dn, &cx, &mut rng);
            EvidenceFrame { cx, residual_dn, light_e: Array2::zeros((96, 90)), weight: Array2::ones((96, 90)) }
        };
        effect.guess(&Evidence { frames: (0..9).map(frame).collect() })
    };
    for share in [0.002, 0.01] {
        let found = guess(20.0, share);
        assert!(found.len() == 1 && (found[0][1] / share - 1.0).abs() < 0.3, "{found:?} for {share}");
    }
    // Jumps as small as the noise, and too few of them, are left to the starting values of the catalogue.
    assert!(guess(4.0, 0.01).is_empty() && guess(20.0, 1e-5).is_empty());
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
    // The best about the axis is tried even where other centres explain more, once for each part of the field.
    let guesses = find("ghost").unwrap().guess(&evidence_of("ghost", &[("ratio", 0.02), ("centre_row", 40.0)]));
    let near = |c: &[f64], row: f64, col: f64| (c[1] - row).abs() <= 10.0 && (c[2] - col).abs() <= 10.0;
    for (row, col) in [(0.0, 0.0), (20.0, 0.0), (-20.0, 20.0)] {
        assert!(guesses.iter().any(|g| near(g, row, col)), "{guesses:?}");
    }
    let rows = first("row_pattern", &[("quadrature_dn", 1.0), ("period_rows", 7.3)]);
    assert!((1.0 / rows[2] - 1.0 / 7.3).abs() < 0.5 / 96.0 / 4.0 + 1e-9, "{rows:?}");
    let even = first("row_pattern", &[("amplitude_dn", 1.0), ("period_rows", 2.0)]);
    assert_eq!(even[2], 2.0);
    let cols = first("column_pattern", &[("amplitude_dn", 1.0), ("period_cols", 5.0)]);
    assert!((1.0 / cols[2] - 0.2).abs() < 0.5 / 90.0 / 4.0 + 1e-9, "{cols:?}");
    // 30 Hz is below half the rate of 83 frames a second; three frames determine it to some Hz.
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
