//! Frames in another unit than those of the calibration: a camera that is read with another number of bits, or a
//! program that has multiplied what it wrote.
//!
//! A factor on all numbers multiplies the black level and the DN of an electron alike. A lamp, a gain or an offset
//! changes one of the two.

use super::observe::{Frame, Observations};
use ommatidia_physics::noise::{NoiseModel, Source};
use ommatidia_session::Role;

/// Smallest factor, or one over it, that is another unit: black levels and gains of one camera drift by less.
const LEAST: f64 = 1.5;
/// Relative distance up to which the factor of the black level is that of the gain of flats, or of the light of scenes.
const SAME: f64 = 0.1;
/// A black level below this says too little, DN.
const BLACK_DN: f64 = 4.0;
/// The same where scenes are darker than the dark, which no light makes; and where they are brighter, as a background
/// would make them: there the factor is a whole number, too.
const SAME_BELOW: f64 = 0.25;
const SAME_ABOVE: f64 = 0.03;
/// Share of full scale up to which flats show the gain: none of their pixels saturates.
const OPEN: f64 = 0.7;

/// Frames whose numbers are multiplied by a factor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OtherUnit {
    /// The factor.
    pub factor: f64,
    /// Black level of the session and of the calibration, DN.
    pub black_dn: [f64; 2],
    /// What else shows it.
    pub by: ShownBy,
}

/// What shows that frames are in another unit, beside their black level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ShownBy {
    /// The gain of flats in the session and in the calibration, DN/e-.
    Gain([f64; 2]),
    /// How many times as bright as predicted the scenes are (median).
    Light(f64),
    /// The same; the black level is that of the scenes where their objects are dark, against the darks or, without
    /// darks, the calibration.
    Scenes(f64),
}

/// Whether the flats of a session are in another unit than those of the calibration. None: they are not, or they cannot
/// show it.
pub(crate) fn unit_of_flats(seen: &Observations, noise: &NoiseModel) -> Option<OtherUnit> {
    if noise.sources.gain != Source::Measured {
        return None;
    }
    let black_dn = black_dn(seen)?;
    let gain = gain_dn_per_e(seen, noise, black_dn)?;
    judged(black_dn, noise, gain / noise.gain_dn_per_e, ShownBy::Gain([gain, noise.gain_dn_per_e]))
}

/// The same of scenes with known objects, and whether they alone are in another unit.
pub(crate) fn unit_of_scenes(seen: &Observations, noise: &NoiseModel, scenes: ScenesShow) -> Option<OtherUnit> {
    let of_darks = || judged(black_dn(seen)?, noise, scenes.light, ShownBy::Light(scenes.light));
    let all = if seen.frames.iter().any(|f| f.role == Role::Flat) { None } else { of_darks() };
    all.or_else(|| scenes_alone(seen, noise, scenes))
}

/// What scenes with known objects show of their unit (medians).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ScenesShow {
    /// How many times as bright as their objects predict they are.
    pub(crate) light: f64,
    /// Their level where their objects are dark, DN.
    pub(crate) level_dn: f64,
}

/// Scenes that are in another unit than the darks beside them or, without darks, than the calibration.
fn scenes_alone(seen: &Observations, noise: &NoiseModel, scenes: ScenesShow) -> Option<OtherUnit> {
    let known = (noise.sources.black_level == Source::Measured).then_some(noise.black_level_dn);
    // Light may have fallen on the darks.
    let black_dn = [black_dn(seen), known].into_iter().flatten().min_by(f64::total_cmp)?;
    let factor = scenes.level_dn / black_dn;
    if black_dn < BLACK_DN || factor <= 0.0 || factor.ln().abs() < LEAST.ln() {
        return None;
    }
    let is_near = |a: f64, b: f64, within: f64| (a / b - 1.0).abs() <= within;
    let whole = if factor > 1.0 { factor.round() } else { 1.0 / (1.0 / factor).round() };
    let is_same = match factor < 1.0 {
        true => is_near(scenes.light, factor, SAME_BELOW),
        false => is_near(factor, whole, SAME_ABOVE) && is_near(scenes.light, whole, SAME_ABOVE),
    };
    let factor = if is_near(factor, whole, SAME_ABOVE) { whole } else { factor };
    is_same.then_some(OtherUnit { factor, black_dn: [scenes.level_dn, black_dn], by: ShownBy::Scenes(scenes.light) })
}

/// Another unit, if black level and `other` have one factor.
fn judged(black_dn: f64, noise: &NoiseModel, other: f64, by: ShownBy) -> Option<OtherUnit> {
    let black_dn = [black_dn, noise.black_level_dn];
    let factor = black_dn[0] / black_dn[1];
    let is_known = noise.sources.black_level != Source::Nominal && black_dn[1] >= BLACK_DN;
    let is_another = is_known && factor > 0.0 && factor.ln().abs() >= LEAST.ln();
    let is_near = |a: f64, b: f64| (a / b - 1.0).abs() <= SAME;
    // Bits are lost or gained as powers of two; a black level that was rounded down is a little too small.
    let of_bits = factor.log2().round().exp2();
    let whole = is_near(of_bits, factor) && is_near(of_bits, other);
    let factor = if whole { of_bits } else { factor };
    (is_another && is_near(other, factor)).then_some(OtherUnit { factor, black_dn, by })
}

/// Mean of the darks, DN.
pub(super) fn black_dn(seen: &Observations) -> Option<f64> {
    let darks = seen.frames.iter().filter(|f| f.role == Role::Dark);
    let means: Vec<f64> = darks.filter_map(|f| f.measured.mean()).map(f64::from).collect();
    (!means.is_empty()).then(|| means.iter().sum::<f64>() / means.len() as f64)
}

/// The gain that pairs of flats of one light show, DN/e- (median): the variance of their noise over their light.
fn gain_dn_per_e(seen: &Observations, noise: &NoiseModel, black_dn: f64) -> Option<f64> {
    let factor = black_dn / noise.black_level_dn;
    let reading_dn2 = (factor * noise.gain_dn_per_e * noise.read_noise_e).powi(2) + 1.0 / 12.0;
    let of_pair = |(a, b): (&Frame, &Frame)| {
        let light_dn = f64::from(a.measured.mean()? + b.measured.mean()?) / 2.0 - black_dn;
        let difference = &b.measured - &a.measured;
        let variance_dn2 = f64::from(difference.var(1.0)) / 2.0 - reading_dn2;
        let is_open = light_dn > 0.0 && light_dn < OPEN * (factor * noise.saturation_dn - black_dn);
        (is_open && variance_dn2 > 0.0).then_some(variance_dn2 / light_dn)
    };
    let pairs = seen.frames.iter().filter(|f| f.role == Role::Flat).filter_map(|b| {
        let a = &seen.frames[b.previous?];
        let same = a.info.illumination == b.info.illumination && a.info.exposure_ms == b.info.exposure_ms;
        same.then_some((a, b))
    });
    let mut gains: Vec<f64> = pairs.filter_map(of_pair).collect();
    gains.sort_by(f64::total_cmp);
    gains.get(gains.len() / 2).copied()
}

impl std::fmt::Display for OtherUnit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [now, before] = self.black_dn;
        match self.by {
            ShownBy::Scenes(_) => {
                write!(f, "scenes of {now:.1} DN where their objects are dark, for {before:.1} DN, ")?
            }
            _ => write!(f, "a black level of {now:.1} DN for {before:.1} DN, ")?,
        }
        match self.by {
            ShownBy::Gain([now, before]) => write!(f, "{now:.3} DN an electron for {before:.3} in flats")?,
            ShownBy::Light(light) => write!(f, "and scenes {light:.3} times as bright as their objects predict")?,
            ShownBy::Scenes(light) => write!(f, "and {light:.3} times as bright as these predict")?,
        }
        let (how, by) = if self.factor < 1.0 { ("multiply", 1.0 / self.factor) } else { ("divide", self.factor) };
        let by = (100.0 * by).round() / 100.0;
        let whose = if matches!(self.by, ShownBy::Scenes(_)) { "the scenes" } else { "those of the session" };
        write!(
            f,
            ". A camera that is read with another number of bits writes such frames, and so does a program that scales \
             or shifts numbers. Calibrate from frames of the same kind, or {how} {whose} by {by}"
        )
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::testing::observations;
    use super::*;
    use crate::data::Shown;
    use ndarray::Array2;
    use ommatidia_physics::noise::Sources;
    use rand_distr::{Distribution, StandardNormal};

    /// Two darks, and two flats of 2000 electrons if there are any, with a black level and a gain, rounded to whole DN.
    fn session(black_dn: f64, gain: f64, flats: bool) -> Observations {
        let mut rng = ommatidia_session::rng::stream(1, "units", 0);
        let mut frame = |role: Role, electrons: f64| {
            let sigma = (electrons + 4.0).sqrt();
            let value = |z: f64| (black_dn + gain * (electrons + sigma * z)).round() as f32;
            let image = Array2::from_shape_simple_fn((60, 60), || value(StandardNormal.sample(&mut rng)));
            (role, if role == Role::Dark { Shown::Dark } else { Shown::Even }, image)
        };
        let roles = [(Role::Dark, 0.0), (Role::Dark, 0.0), (Role::Flat, 2000.0), (Role::Flat, 2000.0)];
        observations((0..if flats { 4 } else { 2 }).map(|k| frame(roles[k].0, roles[k].1)).collect())
    }

    /// A sensor whose black level and gain were measured.
    fn measured() -> NoiseModel {
        let measured = Source::Measured;
        let sources = Sources { black_level: measured, gain: measured, read_noise: measured };
        NoiseModel { sources, ..NoiseModel::nominal() }
    }

    #[test]
    fn a_factor_on_all_numbers_is_another_unit_and_a_gain_or_an_offset_is_none() {
        let noise = measured();
        for factor in [0.25, 4.0, 16.0] {
            let found = unit_of_flats(&session(64.0 * factor, 0.4 * factor, true), &noise).unwrap();
            assert!((found.factor / factor - 1.0).abs() < 0.02, "{found:?}");
        }
        for (black_dn, gain) in [(64.0, 0.4), (64.0, 1.6), (256.0, 0.4), (80.0, 0.5)] {
            assert_eq!(unit_of_flats(&session(black_dn, gain, true), &noise), None, "{black_dn} {gain}");
        }
        // Without flats scenes show it, and beside flats they do not.
        let darks = session(16.0, 0.1, false);
        let show = |light, level_dn| ScenesShow { light, level_dn };
        let found = unit_of_scenes(&darks, &noise, show(0.247, 16.0)).unwrap().to_string();
        assert!(
            found.contains("16.0 DN for 64.0 DN") && found.ends_with("multiply those of the session by 4"),
            "{found}"
        );
        assert_eq!(unit_of_scenes(&darks, &noise, show(1.0, 16.0)), None);
        assert_eq!(unit_of_scenes(&session(16.0, 0.1, true), &noise, show(0.25, 16.0)), None);
        // What was assumed of the sensor is no measure.
        assert_eq!(unit_of_flats(&session(16.0, 0.1, true), &NoiseModel::nominal()), None);
    }

    #[test]
    fn scenes_alone_in_another_unit_are_found_and_other_light_is_not() {
        let (noise, seen) = (measured(), session(64.0, 0.4, true));
        let found = |light, level_dn| unit_of_scenes(&seen, &noise, ScenesShow { light, level_dn });
        let half = found(0.51, 32.4).unwrap();
        assert_eq!((half.factor, half.by), (0.5, ShownBy::Scenes(0.51)));
        assert!(half.to_string().ends_with("multiply the scenes by 2"), "{half}");
        // A background in the scenes raises their level by a third of the dark one.
        assert!(found(0.25, 21.0).is_some());
        assert_eq!(found(4.02, 257.0).unwrap().factor, 4.0);
        // As recorded; brighter; dimmer; with a background as bright as the black level; with another offset.
        for (light, level_dn) in [(1.0, 64.0), (4.0, 66.0), (0.25, 64.0), (1.0, 128.0), (2.2, 128.0), (1.0, 32.0)] {
            assert_eq!(found(light, level_dn), None, "{light} {level_dn}");
        }
        // Light fell on the darks.
        let lit = session(300.0, 0.4, false);
        assert_eq!(unit_of_scenes(&lit, &noise, ScenesShow { light: 1.0, level_dn: 64.0 }), None);
    }
}

/// Sessions for tests.
#[cfg(test)]
pub(super) mod testing {
    use crate::data::{Frame, Observations, Shown};
    use ndarray::Array2;
    use ommatidia_session::{FrameInfo, Role};

    /// Frames of 10 ms of one stack, every second one the repeat of the one before.
    pub(in crate::data) fn observations(frames: Vec<(Role, Shown, Array2<f32>)>) -> Observations {
        let sensor = frames.first().map_or([0, 0], |(_, _, image)| image.dim().into());
        let frame = |(k, (role, shown, measured)): (usize, (Role, Shown, Array2<f32>))| Frame {
            stack: 0,
            role,
            info: FrameInfo::plain(k, 10.0),
            measured,
            cut: None,
            shown,
            held_out: false,
            previous: (k % 2 == 1).then(|| k - 1),
        };
        Observations {
            frames: frames.into_iter().enumerate().map(frame).collect(),
            truths: Vec::new(),
            registrations: Vec::new(),
            pixels: Vec::new(),
            blocks: Vec::new(),
            held_out_blocks: Vec::new(),
            sensor,
            recorded: 0,
            not_estimated: None,
        }
    }
}
