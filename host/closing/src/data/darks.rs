//! Darks that light has reached: they are brighter than the darkest places of the scenes.

use super::observe::{Frame, Observations};
use ommatidia_physics::effects::blur_within;
use ommatidia_physics::noise::{NoiseModel, Source};
use ommatidia_session::Role;
use std::collections::BTreeMap;

/// Standard deviation of the Gaussian blur before the darkest place of a scene is looked for, pixels: its noise is a
/// twentieth of that of a pixel.
const SMOOTH_PX: f64 = 6.0;
/// Darks are too bright if they exceed the darkest place by more than this, DN, and by this share of the read noise.
const DN: f64 = 2.0;
const OF_READ_NOISE: f64 = 0.5;

/// Of the distance from the black level of the calibration to that of lit darks, the share within which the darkest
/// places of the scenes lie about the former.
const NEAR: f64 = 0.25;

/// A stack of darks that is brighter than the darkest place of scenes with the same exposure or a longer one. No light
/// makes a scene darker than the dark.
struct Bright {
    stack: usize,
    exposure_ms: f64,
    /// Mean of the darks, and the darkest place of the scenes, DN.
    level_dn: f64,
    darkest_dn: f64,
}

impl Bright {
    fn words(&self) -> String {
        let Self { exposure_ms, level_dn, darkest_dn, .. } = self;
        format!(
            "the darks of {exposure_ms} ms are {:.1} DN brighter than the darkest places of the scenes ({level_dn:.1} \
             and {darkest_dn:.1} DN)",
            level_dn - darkest_dn
        )
    }
}

/// All such stacks.
fn bright(seen: &Observations, noise: &NoiseModel) -> Vec<Bright> {
    let of = |role: Role| seen.frames.iter().filter(move |f| f.role == role);
    let mut darks: BTreeMap<usize, Vec<&Frame>> = BTreeMap::new();
    of(Role::Dark).for_each(|f| darks.entry(f.stack).or_default().push(f));
    if darks.is_empty() {
        return Vec::new();
    }
    let darkest = |f: &Frame| blur_within(&f.measured, SMOOTH_PX).iter().fold(f32::INFINITY, |m, v| m.min(*v));
    let scenes: Vec<(f64, f32)> = of(Role::Scene).map(|f| (f.info.exposure_ms, darkest(f))).collect();
    let least = DN.max(OF_READ_NOISE * noise.read_noise_e * noise.gain_dn_per_e);
    let of_stack = |(stack, frames): (usize, Vec<&Frame>)| {
        let exposure_ms = frames.iter().map(|f| f.info.exposure_ms).fold(f64::INFINITY, f64::min);
        let level_dn = f64::from(frames.iter().filter_map(|f| f.measured.mean()).sum::<f32>() / frames.len() as f32);
        let as_long = scenes.iter().filter(|(ms, _)| *ms >= exposure_ms).map(|(_, dn)| *dn);
        let darkest_dn = f64::from(as_long.fold(f32::INFINITY, f32::min));
        let is_bright = darkest_dn.is_finite() && level_dn - darkest_dn > least;
        is_bright.then_some(Bright { stack, exposure_ms, level_dn, darkest_dn })
    };
    darks.into_iter().filter_map(of_stack).collect()
}

/// Says of darks that they are brighter than the darkest places of the scenes.
pub(crate) fn bright_darks(seen: &Observations, noise: &NoiseModel) -> Vec<String> {
    let note = |b: Bright| {
        format!(
            "{}: light fell on them, or the black level has changed in between. Take darks again with the light off, \
             right before or after the scenes; until then doubt what is found on the sensor",
            b.words()
        )
    };
    bright(seen, noise).into_iter().map(note).collect()
}

/// Leaves out darks that light has reached: the scenes are darker, and as dark as the calibration says that the dark
/// is. Says so.
pub(crate) fn leave_lit_darks_out(seen: &mut Observations, noise: &NoiseModel) -> Vec<String> {
    let black_dn = noise.black_level_dn;
    let is_lit = |b: &Bright| {
        let above = b.level_dn - black_dn;
        noise.sources.black_level == Source::Measured && above > 0.0 && (b.darkest_dn - black_dn).abs() < NEAR * above
    };
    let lit: Vec<Bright> = bright(seen, noise).into_iter().filter(is_lit).collect();
    seen.leave_out(|f| f.role == Role::Dark && lit.iter().any(|b| b.stack == f.stack));
    let note = |b: Bright| {
        format!(
            "{}, which are as dark as the calibration says ({black_dn:.1} DN): light fell on these darks. They are \
             left out; take darks again with the light off",
            b.words()
        )
    };
    lit.into_iter().map(note).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::Shown;
    use crate::data::unit::testing::observations;
    use ndarray::Array2;
    use ommatidia_physics::noise::Sources;

    /// Two darks and two scenes. `dark_ms` is the exposure of the darks.
    fn session(dark_dn: f32, dark_ms: f64) -> Observations {
        // Single pixels that scatter by 8 DN, and a specimen on one side.
        let noise = |r: usize, c: usize| if (r * 7 + c * 13).is_multiple_of(2) { 8.0 } else { -8.0 };
        let scene = Array2::from_shape_fn((64, 64), |(r, c)| 100.0 + noise(r, c) + if c > 40 { 300.0 } else { 0.0 });
        let dark = Array2::from_shape_fn((64, 64), |(r, c)| dark_dn + noise(r, c));
        let both =
            |role, shown: Shown, image: Array2<f32>| [(role, shown.clone(), image.clone()), (role, shown, image)];
        let darks = both(Role::Dark, Shown::Dark, dark);
        let mut seen = observations(darks.into_iter().chain(both(Role::Scene, Shown::Object(0), scene)).collect());
        for (k, f) in seen.frames.iter_mut().enumerate() {
            f.stack = k / 2;
            if f.role == Role::Dark {
                f.info.exposure_ms = dark_ms;
            }
        }
        seen
    }

    #[test]
    fn darks_with_light_on_them_are_said_and_good_ones_are_not() {
        let notes = |dark_dn, dark_ms| bright_darks(&session(dark_dn, dark_ms), &NoiseModel::nominal());
        assert!(notes(100.0, 10.0).is_empty() && notes(101.0, 10.0).is_empty());
        let lit = notes(160.0, 10.0);
        assert!(lit.len() == 1 && lit[0].contains("60.0 DN brighter"), "{lit:?}");
        // A longer exposure in the dark may be brighter by its dark current.
        assert!(notes(160.0, 100.0).is_empty());
    }

    #[test]
    fn darks_that_scenes_and_calibration_contradict_are_left_out() {
        let sources = Sources { black_level: Source::Measured, ..NoiseModel::nominal().sources };
        let black = |black_level_dn| NoiseModel { black_level_dn, sources, ..NoiseModel::nominal() };
        let mut seen = session(160.0, 10.0);
        let notes = leave_lit_darks_out(&mut seen, &black(101.0));
        assert!(notes.len() == 1 && notes[0].contains("60.0 DN brighter"), "{notes:?}");
        let left: Vec<_> = seen.frames.iter().map(|f| (f.role, f.previous)).collect();
        assert_eq!(left, [(Role::Scene, None), (Role::Scene, Some(0))]);
        // Here the black level may have fallen since; there it is not known.
        for noise in [black(160.0), NoiseModel { black_level_dn: 100.0, ..NoiseModel::nominal() }] {
            let mut seen = session(160.0, 10.0);
            assert!(leave_lit_darks_out(&mut seen, &noise).is_empty() && seen.frames.len() == 4);
        }
    }
}
