#![allow(clippy::unwrap_used)]

use super::*;
use crate::testing::instrument;
use ommatidia_physics::effects::{EffectSetting, Previous, registry};
use ommatidia_session::rng::stream;

fn object() -> Array2<f32> {
    Array2::from_shape_fn((12, 13), |(r, c)| ((r * 13 + c) * 7919 % 101) as f32 / 40.0)
}

fn made_up() -> Instrument {
    let mut i = instrument([12, 13], [40, 41], 5, 2);
    i.psf.basis.mapv_inplace(f32::abs);
    i
}

/// The same with a second depth, where the lenses see less.
fn made_up_in_depth() -> Instrument {
    let mut i = made_up();
    let deeper = i.psf.coefficients.mapv(|v| 0.5 * v);
    i.psf.coefficients = ndarray::concatenate![ndarray::Axis(2), i.psf.coefficients, deeper];
    i.psf.node_depths_um = vec![0.0, 50.0];
    i
}

fn on(id: &str, params: &[(&str, f64)]) -> EffectSetting {
    EffectSetting::new(id, params)
}

#[test]
fn every_effect_switched_off_leaves_the_same_bits_and_switched_on_changes_the_frame() {
    let plain = Forward::new(&made_up_in_depth()).unwrap();
    let previous = Array2::from_elem((40, 41), 900.0f32);
    let light = plain.expected_e(object().view(), &plain.context()).unwrap();
    let peak = f64::from(light.fold(0.0f32, |m, v| m.max(*v)));
    let cx = FrameContext {
        frame: 1,
        time_s: 2.0,
        // Nearly full scale, where saturation begins.
        exposure_ms: plain.context().exposure_ms * 0.9 * plain.noise().full_scale_e() / peak,
        temperature_c: 30.0,
        travel: [1.0, -1.0],
        previous: Some(Previous { light_e: &previous, interval_s: 0.02 }),
        ..plain.context()
    };
    let want = plain.expected_dn(object().view(), &cx).unwrap();
    let drawn = |f: &Forward| f.draw_dn(f.expected_e(object().view(), &cx).unwrap(), &cx, &mut stream(3, "drawn", 0));
    for effect in registry().iter().filter(|e| e.descriptor().stage != Stage::Record) {
        let d = effect.descriptor();
        let names = d.expanded(2);
        let forward = |value: f64| {
            let mut i = made_up_in_depth();
            i.effects = vec![on(d.id, &[(names[0].0.as_str(), value)])];
            Forward::new(&i).unwrap()
        };
        let (off, step) = (names[0].1.off, names[0].1.step);
        assert_eq!(forward(off).expected_dn(object().view(), &cx).unwrap(), want, "{}", d.id);
        let with = forward(off + step);
        let (expected, reading) = (with.expected_dn(object().view(), &cx).unwrap(), drawn(&with));
        // No pupil explains these PSFs, so no wavefront changes them (`wavefront` has tests of its own).
        let without_pupil = d.id == "wavefront_drift";
        assert_eq!(expected != want, !effect.noise_only() && !without_pupil, "{}", d.id);
        assert_eq!(reading != drawn(&plain), !without_pupil, "{}", d.id);
    }
}

#[test]
fn units_run_from_coefficients_to_electrons_to_dn() {
    let i = made_up();
    let f = Forward::new(&i).unwrap();
    let light_dn = f.operator().apply(object().view()).unwrap();
    let mut cx = f.context();
    cx.exposure_ms *= 3.0;
    cx.illumination = 0.5;
    let e = f.expected_e(object().view(), &cx).unwrap();
    let dn = f.expected_dn(object().view(), &cx).unwrap();
    for ((l, e), d) in light_dn.iter().zip(&e).zip(&dn) {
        assert!((e - l * 1.5 / 0.5).abs() < 1e-3 && (d - (64.0 + 1.5 * l).min(4095.0)).abs() < 1e-3);
    }
}

#[test]
fn drawn_frames_have_the_expected_mean_and_the_models_variance() {
    let i = made_up();
    let f = Forward::new(&i).unwrap();
    let cx = f.context();
    let light = f.expected_e(object().view(), &cx).unwrap();
    let want = f.expected_dn(object().view(), &cx).unwrap();
    let (mut chi2, mut mean, frames) = (0.0, 0.0, 40);
    for n in 0..frames {
        let frame = f.draw_dn(light.clone(), &cx, &mut stream(5, "frame", n));
        assert!(frame.iter().all(|v| v.fract() == 0.0));
        for (y, mu) in frame.iter().zip(&want).filter(|(_, mu)| **mu < 4000.0) {
            let d = f64::from(y - mu);
            mean += d / frame_pixels(&want) / frames as f64;
            chi2 += d * d / i.noise.variance_dn2(f64::from(*mu)) / frame_pixels(&want) / frames as f64;
        }
    }
    // 40 x 1600 pixels: the mean of chi2 is known to 0.6 %, the mean to a few hundredths of a DN.
    assert!((chi2 - 1.0).abs() < 0.03 && mean.abs() < 0.2, "{chi2} {mean}");
}

fn frame_pixels(want: &Array2<f32>) -> f64 {
    want.iter().filter(|mu| **mu < 4000.0).count() as f64
}

#[test]
fn charge_effects_act_after_the_draw() {
    let mut i = made_up();
    i.noise.read_noise_e = 0.0;
    i.effects = vec![on("interpixel_capacitance", &[("alpha", 0.1)])];
    let f = Forward::new(&i).unwrap();
    let (mut own, mut shared) = (0.0, 0.0);
    for n in 0..20 {
        let frame = f.draw_dn(Array2::from_elem((40, 41), 1000.0), &f.context(), &mut stream(6, "ipc", n));
        let d = frame.mapv(|v| f64::from(v) - 564.0);
        own += d.iter().map(|v| v * v).sum::<f64>() / 32_800.0;
        shared += d.windows((1, 2)).into_iter().map(|w| w[[0, 0]] * w[[0, 1]]).sum::<f64>() / 32_000.0;
    }
    // White noise v through the kernel: variance v (0.6^2 + 4 0.1^2), neighbour covariance v 2 0.6 0.1; v = 1000 g^2.
    assert!((own - 250.0 * 0.40).abs() < 5.0 && (shared - 250.0 * 0.12).abs() < 4.0, "{own} {shared}");
}

#[test]
fn light_that_is_none_is_refused() {
    let f = Forward::new(&made_up()).unwrap();
    for bad in [f32::NAN, -1.0, f32::INFINITY] {
        let mut o = object();
        o[[3, 4]] = bad;
        let message = f.expected_dn(o.view(), &f.context()).unwrap_err().to_string();
        assert!(message.starts_with("object pixel (3, 4): expected a finite value >= 0"), "{message}");
    }
    let mut i = made_up();
    i.effects = vec![on("none", &[])];
    assert!(matches!(Forward::new(&i), Err(ForwardError::Effect(_))));
}

/// Centroid (row, col) px and variance (rows, cols) px^2 of the light of the first lens for one object pixel.
fn spot(effect: &EffectSetting) -> [[f64; 2]; 2] {
    let mut i = instrument([24, 26], [70, 74], 25, 1);
    i.geometry.anchors_px[0] = [34.3, 36.2];
    i.geometry.dead[1] = true;
    // A Gaussian of 1.8 px beside the middle of its window.
    i.psf.basis = ndarray::Array4::from_shape_fn((2, 1, 25, 25), |(_, _, r, c)| {
        let square = (r as f32 - 12.4).powi(2) + (c as f32 - 11.7).powi(2);
        (-square / (2.0 * 1.8 * 1.8)).exp()
    });
    i.psf.coefficients.fill(1.0);
    i.effects = vec![effect.clone()];
    let forward = Forward::new(&i).unwrap();
    let mut object = Array2::zeros((24, 26));
    object[[3, 20]] = 1.0;
    let light = forward.expected_e(object.view(), &forward.context()).unwrap();
    let mean = |of: &dyn Fn([f64; 2]) -> f64| -> f64 {
        let sum = light.indexed_iter().map(|((r, c), v)| f64::from(*v) * of([r as f64, c as f64])).sum::<f64>();
        sum / f64::from(light.sum())
    };
    let centre = [0, 1].map(|a| mean(&|at| at[a]));
    [centre, [0, 1].map(|a| mean(&|at| (at[a] - centre[a]).powi(2)))]
}

/// A focus at x goes to x + d(x), for strong effects as for weak ones.
#[test]
fn a_focus_goes_where_the_law_of_its_effect_says() {
    let [still, _] = spot(&on("array_shift", &[("row_px", 0.0)]));
    // From the centre of the object, one object pixel is one pixel of the image. A PSF moves as a whole by what the law
    // says for the middle of its window, wherever in the window its light is.
    let field = [3.0 - 11.5, 20.0 - 12.5];
    for eps in [0.001, 0.05, -0.05] {
        let [at, _] = spot(&on("stage_scale", &[("row_by_row", eps), ("col_by_col", eps)]));
        for a in 0..2 {
            let (moved, law) = (at[a] - still[a], eps * field[a]);
            assert!((moved - law).abs() < 0.01 * law.abs(), "{eps}: {moved} instead of {law}");
        }
    }
}

#[test]
fn displacements_leave_psfs_as_they_are_and_growth_leaves_foci_where_they_are() {
    let [still, width] = spot(&on("array_shift", &[("row_px", 0.0)]));
    for (effect, moves, grows) in [
        (on("spectral_shift", &[("change", 0.05)]), false, 1.05),
        (on("spectral_shift", &[("change", -0.04)]), false, 0.96),
        (on("stage_scale", &[("row_by_row", 0.04), ("col_by_col", 0.04)]), true, 1.0),
        (on("magnification", &[("eps", 0.05)]), true, 1.05),
    ] {
        let [at, wide] = spot(&effect);
        for a in 0..2 {
            assert_eq!((at[a] - still[a]).abs() > 0.1, moves, "{effect:?}: {still:?} {at:?}");
            assert!(moves || (at[a] - still[a]).abs() < 2e-3, "{effect:?}: {still:?} {at:?}");
            let found = (wide[a] / width[a]).sqrt();
            assert!((found - grows).abs() < 2e-3, "{effect:?}: {found} instead of {grows}");
        }
    }
}

/// Images for sources in other planes are made when something first asks for them.
#[test]
fn only_what_lies_in_another_plane_needs_its_images() {
    let instrument = made_up_in_depth();
    let plan = |depth| Forward::with_all_depths(&instrument, OperatorConfig { depth, ..Default::default() }).unwrap();
    let (forward, deeper) = (plan(0), plan(1));
    let cx = forward.context();
    let scene = forward.scene(object().view(), &Chain::default(), &cx).unwrap();
    let moved = Chain::build(&[on("array_shift", &[("row_px", 0.5)])], forward.layout()).unwrap();
    let _ = forward.light_e(&scene, &moved, &cx);
    assert!(scene.planes[0].get().is_some() && scene.planes[1].get().is_none());

    let scene = scene.at_depth(50.0);
    let found = forward.light_e(&scene, &Chain::default(), &cx);
    assert!(scene.planes[1].get().is_some());
    let other = deeper.scene(object().view(), &Chain::default(), &deeper.context()).unwrap();
    let expected = deeper.light_e(&other, &Chain::default(), &deeper.context());
    let most = expected.iter().fold(0.0f32, |m, v| m.max(*v));
    assert!(most > 0.0 && (&found - &expected).iter().all(|d| d.abs() < 1e-4 * most));
}
