#![allow(clippy::unwrap_used)]

use super::*;
use ndarray::Array2;

fn image() -> Array2<f32> {
    Array2::from_shape_fn((9, 11), |(r, c)| ((r * 31 + c * 17) % 23) as f32 + 0.125)
}

fn geometry() -> Geometry {
    Geometry { anchors_px: vec![[10.25, 11.5], [10.0, 61.25]], magnification: 0.66, dead: vec![false; 2] }
}

fn context() -> FrameContext {
    FrameContext { exposure_ms: 10.0, illumination: 1.0, full_scale_e: 1e4, black_level_dn: 2.0, ..Default::default() }
}

fn setting(id: &str, params: &[(&str, f64)]) -> EffectSetting {
    EffectSetting { id: id.into(), params: params.iter().map(|(n, v)| ((*n).into(), *v)).collect() }
}

/// Runs every hook of an effect on the same image and chief rays.
fn run(effect: &dyn Effect, p: &[f64]) -> (Vec<Array2<f32>>, Geometry) {
    let mut images = vec![image(); 5];
    let mut moved = geometry();
    let cx = context();
    effect.on_object(p, &mut images[0], &cx);
    effect.on_geometry(p, &mut moved, &cx);
    effect.on_lens(p, &mut images[1], &cx);
    effect.on_light(p, &mut images[2], &cx);
    effect.on_charge(p, &mut images[3], &cx);
    effect.on_electronics(p, &mut images[4], &cx);
    (images, moved)
}

#[test]
fn switched_off_is_absent_bit_for_bit_and_switched_on_acts_at_its_stage_only() {
    for effect in registry() {
        let d = effect.descriptor();
        let mut p: Vec<f64> = d.params.iter().map(|p| p.off).collect();
        let (images, moved) = run(*effect, &p);
        assert!(images.iter().all(|i| *i == image()) && moved == geometry(), "{} is not off", d.id);
        p[0] += d.params[0].step;
        let (images, moved) = run(*effect, &p);
        let stages = [Stage::Object, Stage::Lens, Stage::Light, Stage::Charge, Stage::Electronics];
        for (stage, after) in stages.iter().zip(&images) {
            assert_eq!(*after != image(), *stage == d.stage, "{} at {stage:?}", d.id);
        }
        assert_eq!(moved != geometry(), d.stage == Stage::Geometry, "{}", d.id);
    }
}

#[test]
fn descriptors_are_sound() {
    let mut seen = std::collections::BTreeSet::new();
    for d in registry().iter().map(|e| e.descriptor()) {
        assert!(seen.insert(d.id) && !d.params.is_empty() && !d.summary.is_empty(), "{}", d.id);
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
        let chain = Chain::build(&[setting(id, params)]).unwrap();
        let mut image = point.clone();
        chain.on_light(&mut image, &context());
        chain.on_charge(&mut image, &context());
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
    let on = |id: &str, params: &[(&str, f64)]| Chain::build(&[setting(id, params)]).unwrap();
    let mut frame = Array2::from_elem((2, 2), 102.0f32);
    on("pixel_mosaic", &[("checker", 0.03), ("rows", 0.01)]).on_electronics(&mut frame, &context());
    assert_eq!(frame, ndarray::arr2(&[[106.0, 100.0], [98.0, 104.0]]));
    let mut light = Array2::from_elem((1, 2), 5.0f32);
    on("background", &[("rate_e_per_ms", 0.2), ("gradient_col", 0.5)]).on_light(&mut light, &context());
    assert_eq!(light, ndarray::arr2(&[[6.5, 7.5]]));
    let mut charge = Array2::from_elem((1, 1), 5000.0f32);
    on("nonlinearity", &[("beta", 0.02)]).on_charge(&mut charge, &context());
    assert_eq!(charge[[0, 0]], 4950.0);
    let mut moved = geometry();
    on("array_shift", &[("col_px", -0.25)]).on_geometry(&mut moved, &context());
    assert_eq!(moved.anchors_px, vec![[10.25, 11.25], [10.0, 61.0]]);
    let mut rows = Array2::zeros((3, 1));
    on("row_pattern", &[("amplitude_dn", 2.0)]).on_electronics(&mut rows, &context());
    assert_eq!(rows.mapv(f32::round), ndarray::arr2(&[[2.0], [-2.0], [2.0]]));
}

#[test]
fn bad_settings_are_named() {
    let message = |s: EffectSetting| Chain::build(&[s]).unwrap_err().to_string();
    assert!(message(setting("haloo", &[])).contains("`haloo`: unknown; known are excitation_profile"));
    assert!(message(setting("halo", &[("wight", 0.1)])).contains("no parameter `wight`; it has weight, sigma_px"));
    assert!(message(setting("halo", &[("weight", 2.0)])).contains("expected 0 to 1"));
    assert!(message(setting("halo", &[("weight", f64::NAN)])).contains("found NaN"));
    assert!(!Chain::build(&[setting("halo", &[])]).unwrap().acts_at(Stage::Light));
}
