//! Darks that light has reached: they are brighter than the darkest places of the scenes.

use super::observe::{Frame, Observations};
use ommatidia_physics::effects::blur_within;
use ommatidia_physics::noise::NoiseModel;
use ommatidia_session::Role;
use std::collections::BTreeMap;

/// Standard deviation of the Gaussian blur before the darkest place of a scene is looked for, pixels: its noise is a
/// twentieth of that of a pixel.
const SMOOTH_PX: f64 = 6.0;
/// Darks are too bright if they exceed the darkest place by more than this, DN, and by this share of the read noise.
const DN: f64 = 2.0;
const OF_READ_NOISE: f64 = 0.5;

/// Says of each stack of darks that it is brighter than the darkest place of scenes with the same exposure or a longer
/// one. No light makes a scene darker than the dark.
pub(crate) fn bright_darks(seen: &Observations, noise: &NoiseModel) -> Vec<String> {
    let of = |role: Role| seen.frames.iter().filter(move |f| f.role == role);
    let mut darks: BTreeMap<usize, Vec<&Frame>> = BTreeMap::new();
    of(Role::Dark).for_each(|f| darks.entry(f.stack).or_default().push(f));
    if darks.is_empty() {
        return Vec::new();
    }
    let darkest = |f: &Frame| blur_within(&f.measured, SMOOTH_PX).iter().fold(f32::INFINITY, |m, v| m.min(*v));
    let scenes: Vec<(f64, f32)> = of(Role::Scene).map(|f| (f.info.exposure_ms, darkest(f))).collect();
    let least = DN.max(OF_READ_NOISE * noise.read_noise_e * noise.gain_dn_per_e);
    let note = |frames: Vec<&Frame>| {
        let exposure_ms = frames.iter().map(|f| f.info.exposure_ms).fold(f64::INFINITY, f64::min);
        let level = frames.iter().filter_map(|f| f.measured.mean()).sum::<f32>() / frames.len() as f32;
        let as_long = scenes.iter().filter(|(ms, _)| *ms >= exposure_ms).map(|(_, dn)| *dn);
        let darkest = as_long.fold(f32::INFINITY, f32::min);
        let above = f64::from(level - darkest);
        (darkest.is_finite() && above > least).then(|| {
            format!(
                "the darks of {exposure_ms} ms are {above:.1} DN brighter than the darkest places of the scenes \
                 ({level:.1} and {darkest:.1} DN): light fell on them, or the black level has changed in between. Take \
                 darks again with the light off, right before or after the scenes; until then doubt what is found on \
                 the sensor"
            )
        })
    };
    darks.into_values().filter_map(note).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::Shown;
    use ndarray::Array2;
    use ommatidia_session::FrameInfo;

    fn notes(dark_dn: f32, dark_ms: f64) -> Vec<String> {
        let frame = |role, stack, ms, measured: Array2<f32>| Frame {
            stack,
            role,
            info: FrameInfo::plain(0, ms),
            measured,
            cut: None,
            shown: if role == Role::Dark { Shown::Dark } else { Shown::Object(0) },
            held_out: false,
            previous: None,
        };
        // Single pixels that scatter by 8 DN, and a specimen on one side.
        let noise = |r: usize, c: usize| if (r * 7 + c * 13).is_multiple_of(2) { 8.0 } else { -8.0 };
        let scene = Array2::from_shape_fn((64, 64), |(r, c)| 100.0 + noise(r, c) + if c > 40 { 300.0 } else { 0.0 });
        let dark = Array2::from_shape_fn((64, 64), |(r, c)| dark_dn + noise(r, c));
        let seen = Observations {
            frames: vec![frame(Role::Dark, 0, dark_ms, dark), frame(Role::Scene, 1, 10.0, scene)],
            truths: Vec::new(),
            registrations: Vec::new(),
            pixels: Vec::new(),
            blocks: Vec::new(),
            held_out_blocks: Vec::new(),
            sensor: [64, 64],
            recorded: 0,
            not_estimated: None,
        };
        bright_darks(&seen, &NoiseModel::nominal())
    }

    #[test]
    fn darks_with_light_on_them_are_said_and_good_ones_are_not() {
        assert!(notes(100.0, 10.0).is_empty() && notes(101.0, 10.0).is_empty());
        let lit = notes(160.0, 10.0);
        assert!(lit.len() == 1 && lit[0].contains("60.0 DN brighter"), "{lit:?}");
        // A longer exposure in the dark may be brighter by its dark current.
        assert!(notes(160.0, 100.0).is_empty());
    }
}
