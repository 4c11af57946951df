//! Foci of every family against the laws of their optics.

#![allow(clippy::unwrap_used)]

use super::config::{FamilyName, KernelsConfig, RelayConfig, StackOf};
use super::{Lenses, Moved, Work, build};
use crate::config::{ArrayConfig, BenchConfig, ObjectConfig};
use crate::family::change::Change;
use crate::foci::Point;
use ndarray::{Array3, s};
use ommatidia_physics::effects::{EffectSetting, RayShift};
use ommatidia_physics::optics::Psf;
use ommatidia_session::stack;

/// Two lenses, with a field that holds every tail.
fn config(family: FamilyName) -> BenchConfig {
    let mut c = BenchConfig { family, ..BenchConfig::default() };
    (c.sensor.rows, c.sensor.cols) = (60, 80);
    c.array = ArrayConfig { rows: 1, cols: 2, pitch_px: 30.0, placement_rms_px: 0.3, lenses_px: None };
    c.object = ObjectConfig { rows: 18, cols: 22, pixel_um: 2.8 };
    c.optics.aperture_um = 30.0;
    c.optics.object_distance_um = 300.0;
    c.optics.psf_field_px = 61;
    c
}

/// A relay without aberrations.
fn perfect() -> BenchConfig {
    let relay = RelayConfig {
        spherical: 0.0,
        coma: 0.0,
        astigmatism: 0.0,
        field_curvature: 0.0,
        distortion_px: 0.0,
        scatter: 0.0,
        stop_walk: 0.0,
        stop_radius: 2.0,
        rays: [24, 48],
    };
    BenchConfig { relay, ..config(FamilyName::Relay) }
}

fn at(y: f64, x: f64, z_um: f64) -> Point {
    Point { at_um: [y, x], z_um }
}

/// Centroid (row, col) on the sensor, covariance (rows, cols, mixed) in pixels, and transmission.
fn spot(lenses: &dyn Lenses, l: usize, point: Point, moved: impl Into<Moved>) -> ([f64; 2], [f64; 3], f64) {
    let mut work = lenses.work();
    let focus = lenses.focus(l, point, moved.into(), &mut work);
    let (centre, spread) = moments(&work.psf);
    ([0, 1].map(|k| centre[k] + focus.centre[k] as f64), spread, focus.transmission)
}

fn moments(psf: &Psf) -> ([f64; 2], [f64; 3]) {
    let of = |i: usize| [i / psf.side, i % psf.side].map(|k| k as f64 - (psf.side / 2) as f64);
    let mean = |f: &dyn Fn([f64; 2]) -> f64| -> f64 {
        psf.share.iter().enumerate().map(|(i, v)| f64::from(*v) * f(of(i))).sum()
    };
    let [r, c] = [mean(&|p| p[0]), mean(&|p| p[1])];
    let spread = [mean(&|p| (p[0] - r).powi(2)), mean(&|p| (p[1] - c).powi(2)), mean(&|p| (p[0] - r) * (p[1] - c))];
    ([r, c], spread)
}

const STILL: RayShift = RayShift { px: [0.0; 2], z_um: 0.0, growth: 0.0 };

#[test]
fn no_light_is_lost_in_any_family_and_every_focus_is_smooth_in_its_place() {
    for family in FamilyName::ALL {
        let lenses = build(&config(family)).unwrap();
        let (mut work, mut next) = (lenses.work(), lenses.work());
        for (y, x, z) in [(0.0, 0.0, 0.0), (20.0, -25.0, 0.0), (-3.0, 11.0, 30.0)] {
            let focus = lenses.focus(1, at(y, x, z), STILL.into(), &mut work);
            let sum: f64 = work.psf.share.iter().map(|v| f64::from(*v)).sum();
            assert!((sum - 1.0).abs() < 1e-4, "{family}: {sum}");
            assert!(work.psf.share.iter().all(|v| *v >= 0.0));
            assert!(focus.transmission > 0.1 && focus.transmission <= 1.0, "{family}: {}", focus.transmission);
            // A thousandth of an object pixel further it is nearly the same.
            lenses.focus(1, at(y + 0.003, x, z), STILL.into(), &mut next);
            let most = work.psf.share.iter().fold(0.0f32, |m, v| m.max(*v));
            let change = work.psf.share.iter().zip(&next.psf.share).fold(0.0f32, |m, (a, b)| m.max((a - b).abs()));
            assert!(change < 0.01 * most, "{family}: {change} of {most}");
        }
    }
}

#[test]
fn a_displaced_focus_is_displaced_by_as_much_in_every_family() {
    for family in FamilyName::ALL {
        let lenses = build(&config(family)).unwrap();
        let (before, ..) = spot(&*lenses, 0, at(12.0, -7.0, 0.0), STILL);
        for px in [[0.4, 0.0], [-0.23, 1.71]] {
            let (after, ..) = spot(&*lenses, 0, at(12.0, -7.0, 0.0), RayShift::by_px(px));
            for k in 0..2 {
                assert!((after[k] - before[k] - px[k]).abs() < 4e-3, "{family}: {before:?} {after:?} {px:?}");
            }
        }
    }
}

/// Of no family is the pixel, which widens foci by 1/12 px^2 along each axis, part of the PSF that grows; a
/// displacement is.
#[test]
fn a_focus_grows_in_its_place_by_the_given_share_in_every_family() {
    for family in FamilyName::ALL {
        let lenses = build(&config(family)).unwrap();
        let point = at(12.0, -7.0, 0.0);
        let (before, small, _) = spot(&*lenses, 0, point, STILL);
        for growth in [0.05, -0.04] {
            let (after, large, _) = spot(&*lenses, 0, point, RayShift { growth, ..STILL });
            let chief = lenses.focus_px(0, point, STILL.into());
            for k in 0..2 {
                let moved = (before[k] - chief[k]) * growth;
                assert!((after[k] - before[k] - moved).abs() < 8e-3, "{family}: {before:?} {after:?}");
                let found = ((large[k] - 1.0 / 12.0) / (small[k] - 1.0 / 12.0)).sqrt();
                assert!((found - 1.0 - growth).abs() < 4e-3, "{family}: {found} for {growth}");
            }
        }
    }
}

#[test]
fn a_relay_out_of_focus_shows_a_disc_of_its_aperture_times_the_distance() {
    let config = perfect();
    let lenses = build(&config).unwrap();
    let (m, aperture) = (config.true_magnification(), 15.0 / 300.0);
    let variance = |z: f64| spot(&*lenses, 0, at(0.0, 0.0, z), STILL).1;
    let focus = variance(0.0);
    // Diffraction and pixel.
    let sigma_px = 0.225 * config.optics.wavelength_um * m / aperture / 1.85;
    assert!((focus[0] - sigma_px * sigma_px - 1.0 / 12.0).abs() < 5e-3, "{focus:?} {sigma_px}");
    for z in [-150.0, 80.0, 200.0] {
        // A disc of radius R has the variance R^2 / 4 along each axis.
        let radius_px = m * z * aperture / 1.85;
        for (wide, sharp) in variance(z).iter().zip(&focus).take(2) {
            let found = wide - sharp;
            assert!((found / (radius_px * radius_px / 4.0) - 1.0).abs() < 0.01, "{z}: {found} {radius_px}");
        }
    }
}

#[test]
fn coma_moves_the_light_of_a_relay_and_distortion_its_chief_ray() {
    let mut config = perfect();
    config.array = ArrayConfig { rows: 1, cols: 1, pitch_px: 0.0, placement_rms_px: 0.0, lenses_px: None };
    let corner_um = 18f64.hypot(22.0) / 2.0 * 2.8;
    let point = at(0.0, 0.6 * corner_um, 0.0);
    let plain = spot(&*build(&config).unwrap(), 0, point, STILL).0;
    config.relay.coma = 0.2;
    let coma = spot(&*build(&config).unwrap(), 0, point, STILL).0;
    // The mean over the disc of rho.rho h + 2 (h.rho) rho is h.
    let image_aperture = 15.0 / 300.0 / config.true_magnification();
    let expected = -0.2 * 0.6 * config.optics.wavelength_um / image_aperture / 1.85;
    assert!((coma[1] - plain[1] - expected).abs() < 2e-3 && (coma[0] - plain[0]).abs() < 2e-3, "{coma:?} {expected}");
    config.relay.coma = 0.0;
    config.relay.distortion_px = 0.8;
    let bent = spot(&*build(&config).unwrap(), 0, point, STILL).0;
    assert!((bent[1] - plain[1] - 0.8 * 0.6f64.powi(3)).abs() < 2e-3, "{bent:?}");
}

#[test]
fn astigmatism_of_a_relay_widens_along_the_field_and_a_stop_takes_light() {
    let mut config = perfect();
    config.array = ArrayConfig { rows: 1, cols: 1, pitch_px: 0.0, placement_rms_px: 0.0, lenses_px: None };
    let corner_um = 18f64.hypot(22.0) / 2.0 * 2.8;
    let point = at(0.8 * corner_um, 0.0, 0.0);
    let (_, round, full) = spot(&*build(&config).unwrap(), 0, point, STILL);
    config.relay.astigmatism = 0.5;
    let (_, long, _) = spot(&*build(&config).unwrap(), 0, point, STILL);
    // Slope 2 W222 h^2 along h: the rays of a disc have the variance 1 / 4.
    let image_aperture = 15.0 / 300.0 / config.true_magnification();
    let slope = 2.0 * 0.5 * 0.64 * config.optics.wavelength_um / image_aperture / 1.85;
    assert!(((long[0] - round[0]) / (slope * slope / 4.0) - 1.0).abs() < 0.01 && (long[1] - round[1]).abs() < 1e-3);
    (config.relay.stop_radius, config.relay.stop_walk) = (1.0, 0.5);
    let (.., clipped) = spot(&*build(&config).unwrap(), 0, point, STILL);
    // Two circles of radius 1 at a distance d share 2 acos(d / 2) - d / 2 sqrt(4 - d^2) of pi.
    let d = 0.4f64;
    let shared = (2.0 * (d / 2.0).acos() - d / 2.0 * (4.0 - d * d).sqrt()) / std::f64::consts::PI;
    assert!((full - 1.0).abs() < 1e-12 && (clipped - shared).abs() < 0.02, "{clipped} {shared}");
}

#[test]
fn a_wider_gap_magnifies_and_defocuses_a_relay_and_enlarges_a_kernel() {
    let setting = [EffectSetting::new("magnification", &[("eps", 0.05)])];
    let change = Change::of(&setting, 2);
    for config in [perfect(), config(FamilyName::Kernels)] {
        let lenses = build(&config).unwrap();
        let moved = lenses.moved(&change).unwrap();
        let point = at(9.0, -20.0, 0.0);
        let (before, small, _) = spot(&*lenses, 1, point, STILL);
        let (after, large, _) = spot(&*moved, 1, point, STILL);
        let axis = lenses.ray(1, point.at_um).axis_px;
        for k in 0..2 {
            let expected = 0.05 * axis[k];
            assert!((after[k] - before[k] - expected).abs() < 5e-3, "{before:?} {after:?} {axis:?}");
        }
        if config.family == FamilyName::Relay {
            // The cone beyond its tip: aperture of the lens times the relative gap.
            let radius_px = 0.05 * 15.0 / 1.85;
            assert!(((large[0] - small[0]) / (radius_px * radius_px / 4.0) - 1.0).abs() < 0.02, "{small:?} {large:?}");
        } else {
            let ratio = (large[0] + large[1] - 1.0 / 6.0) / (small[0] + small[1] - 1.0 / 6.0);
            assert!((ratio - 1.05f64.powi(2)).abs() < 0.01, "{ratio}");
        }
    }
    assert!(build(&config(FamilyName::Pupils)).unwrap().moved(&change).is_none());
}

#[test]
fn a_turned_array_turns_its_anchors_and_a_shift_takes_the_axes_along() {
    let settings = [
        EffectSetting::new("array_rotation", &[("angle_mrad", 100.0)]),
        EffectSetting::new("array_shift", &[("col_px", 2.0)]),
        EffectSetting::new("lens_decentre", &[("row_px_1", 0.5)]),
    ];
    for family in [FamilyName::Relay, FamilyName::Kernels] {
        let config = config(family);
        let lenses = build(&config).unwrap();
        let moved = lenses.moved(&Change::of(&settings, 2)).unwrap();
        let (old, new) = (lenses.anchors_px()[1], moved.anchors_px()[1]);
        let [row, col] = [old[0] - 29.5, old[1] - 39.5];
        let (sin, cos) = 0.1f64.sin_cos();
        assert!((new[0] - 29.5 - (row * cos + col * sin) - 0.5).abs() < 1e-9);
        assert!((new[1] - 39.5 - (col * cos - row * sin) - 2.0).abs() < 1e-9);
        // The axis lies opposite to the anchor.
        let m = config.true_magnification();
        assert!((moved.axes_um()[1][1] + (new[1] - 39.5) * 1.85 / (1.0 + m)).abs() < 1e-9);
        // Nothing that has moved by nothing: the same bits.
        let still = lenses.moved(&Change::of(&[EffectSetting::new("array_shift", &[("row_px", 0.0)])], 2)).unwrap();
        let (mut a, mut b) = (lenses.work(), Work::default());
        let point = at(5.0, 6.0, 0.0);
        assert_eq!(lenses.focus(0, point, STILL.into(), &mut a), still.focus(0, point, STILL.into(), &mut b));
        assert_eq!(a.psf.share, b.psf.share);
    }
}

#[test]
fn drawn_kernels_have_the_stated_width_and_turn_with_depth() {
    let mut config = config(FamilyName::Kernels);
    config.kernels = KernelsConfig {
        count: 1,
        morph: 0.0,
        turn_rad: 0.0,
        stretch: 0.0,
        warp_px: 0.0,
        falloff: 0.0,
        rms_px: 2.5,
        turn_rad_per_um: 0.01,
        ..KernelsConfig::default()
    };
    let lenses = build(&config).unwrap();
    let (centre, spread, _) = spot(&*lenses, 0, at(0.0, 0.0, 0.0), STILL);
    let ray = lenses.focus_px(0, at(0.0, 0.0, 0.0), STILL.into());
    assert!((0..2).all(|k| (centre[k] - ray[k]).abs() < 0.01), "{centre:?} {ray:?}");
    let width = (spread[0] + spread[1] - 1.0 / 6.0).sqrt();
    assert!((width - 2.5).abs() < 0.05, "{width}");
    // Direction of the long axis.
    let direction = |s: [f64; 3]| 0.5 * (2.0 * s[2]).atan2(s[1] - s[0]);
    let turned = direction(spot(&*lenses, 0, at(0.0, 0.0, 30.0), STILL).1) - direction(spread);
    let wrapped = (turned - 0.3 + 1.5 * std::f64::consts::PI).rem_euclid(std::f64::consts::PI);
    assert!((wrapped - 0.5 * std::f64::consts::PI).abs() < 0.01, "{turned}");
}

/// A stack of round spots whose standard deviations are given, on a background.
fn spots(sigmas: &[f32]) -> Array3<f32> {
    let mut stack = Array3::zeros((sigmas.len(), 41, 41));
    for (i, sigma) in sigmas.iter().enumerate() {
        for ((r, c), v) in stack.slice_mut(s![i, .., ..]).indexed_iter_mut() {
            let square = (r as f32 - 19.0).powi(2) + (c as f32 - 21.0).powi(2);
            *v = 100.0 + 1000.0 * (-0.5 * square / (sigma * sigma)).exp();
        }
    }
    stack
}

#[test]
fn measured_kernels_are_read_scaled_and_blended_in_depth_and_over_the_field() {
    let dir = tempfile::tempdir().unwrap();
    stack::write(&dir.path().join("a.npy"), spots(&[6.0, 5.0, 4.0, 5.0, 7.0]).view()).unwrap();
    let mut config = config(FamilyName::Kernels);
    config.kernels = KernelsConfig {
        psfs: vec![dir.path().display().to_string()],
        slice_um: 20.0,
        rms_px: 1.8,
        stretch: 0.0,
        warp_px: 0.0,
        ..KernelsConfig::default()
    };
    config.scan.depths_um = vec![-40.0, 0.0, 40.0];
    let lenses = build(&config).unwrap();
    let ray = lenses.focus_px(1, at(8.0, 9.0, 0.0), STILL.into());
    let width = |z: f64| {
        let (centre, spread, _) = spot(&*lenses, 1, at(8.0, 9.0, z), STILL);
        assert!((0..2).all(|k| (centre[k] - ray[k]).abs() < 0.05), "{centre:?} {ray:?}");
        (spread[0] + spread[1] - 1.0 / 6.0).sqrt()
    };
    assert!((width(0.0) - 1.8).abs() < 0.1, "{}", width(0.0));
    assert!((width(40.0) / width(0.0) - 7.0 / 4.0).abs() < 0.12, "{}", width(40.0));
    // Beyond the stack nothing is known.
    let defocus = EffectSetting::new("defocus", &[("z_um", 5.0)]);
    let why = config.build(std::slice::from_ref(&defocus)).unwrap_err().to_string();
    assert!(why.contains("`defocus` cannot act") && why.contains("kernels") && why.contains("40 um"), "{why}");
    config.scan.depths_um = vec![-90.0];
    assert!(config.build(&[]).unwrap_err().to_string().contains("scan.depths_um"));
    // The same frames as a field of 2 x 2: no depth at all, and the width changes from corner to corner.
    stack::write(&dir.path().join("a.npy"), spots(&[4.0, 4.0, 4.0, 6.0]).view()).unwrap();
    config.kernels.stack_of = StackOf::Field;
    config.scan.depths_um = vec![0.0];
    let lenses = build(&config).unwrap();
    let width = |y: f64, x: f64| spot(&*lenses, 0, at(y, x, 0.0), STILL).1[0];
    assert!(width(24.0, 30.0) > 1.2 * width(-24.0, -30.0));
    assert!(config.build(&[defocus]).is_err());
    config.kernels.psfs = vec![dir.path().join("none").display().to_string()];
    assert!(config.build(&[]).is_err());
}
