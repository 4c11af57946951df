#![allow(clippy::unwrap_used)]

use super::*;
use crate::noise::Sources;
use crate::rng::stream;
use ndarray::Array2;

fn image() -> Array2<f32> {
    Array2::from_shape_fn((9, 11), |(r, c)| ((r * 31 + c * 17) % 23) as f32 + 0.125)
}

const LAYOUT: Layout = Layout { lenses: 2, sensor: [9, 11] };
static ANCHORS: [[f64; 2]; 2] = [[4.25, 2.5], [4.0, 7.25]];

/// The second frame of a stack, late, in the first lens.
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
    let mut images = vec![image(); 5];
    chain.on_object(&mut images[0], &cx);
    chain.on_lens(&mut images[1], &cx);
    chain.on_light(&mut images[2], &cx);
    chain.on_charge(&mut images[3], &cx);
    chain.on_electronics(&mut images[4], &cx);
    let mut record = Record::honest(1, 4);
    chain.on_record(&mut record, &cx);
    let mut noise = NoiseModel {
        black_level_dn: 2.0,
        gain_dn_per_e: 0.5,
        gain_sigma: 0.0,
        read_noise_e: 2.0,
        read_noise_sigma: 0.0,
        saturation_dn: 4095.0,
        sources: Sources::default(),
    };
    chain.on_noise(&mut noise);
    let mut reading = image();
    chain.on_reading(&mut reading, &cx, &mut stream(1, "reading", 0));
    Deeds { images, shift: chain.shift_ray(&RAY, &cx), record, noise, reading }
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
        for (i, (name, p)) in d.expanded(2).into_iter().enumerate().filter(|(_, (_, p))| p.kind == Kind::Strength) {
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
        assert!(d.params.iter().any(|p| p.kind == Kind::Strength), "{}", d.id);
        for l in d.lookalikes {
            assert!(find(l.id).is_some() && !l.separate_by.is_empty(), "{} and {}", d.id, l.id);
        }
        for p in d.params {
            assert!(p.min <= p.off && p.off <= p.max && p.step > 0.0 && p.off + p.step <= p.max, "{} {}", d.id, p.name);
        }
    }
    for stage in [Stage::Object, Stage::Geometry, Stage::Lens, Stage::Light, Stage::Charge, Stage::Electronics] {
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
    let mut rows = Array2::zeros((3, 1));
    chain("row_pattern", &[("amplitude_dn", 2.0)]).on_electronics(&mut rows, &cx);
    assert_eq!(rows.mapv(f32::round), ndarray::arr2(&[[2.0], [-2.0], [2.0]]));
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
