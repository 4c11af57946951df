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

/// The same of scenes that are `light` times as bright as their objects predict, in a session without flats.
pub(crate) fn unit_of_scenes(seen: &Observations, noise: &NoiseModel, light: f64) -> Option<OtherUnit> {
    if seen.frames.iter().any(|f| f.role == Role::Flat) {
        return None;
    }
    judged(black_dn(seen)?, noise, light, ShownBy::Light(light))
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
fn black_dn(seen: &Observations) -> Option<f64> {
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
        write!(f, "a black level of {now:.1} DN for {before:.1} DN, ")?;
        match self.by {
            ShownBy::Gain([now, before]) => write!(f, "{now:.3} DN an electron for {before:.3} in flats")?,
            ShownBy::Light(light) => write!(f, "and scenes {light:.3} times as bright as their objects predict")?,
        }
        let (how, by) = if self.factor < 1.0 { ("multiply", 1.0 / self.factor) } else { ("divide", self.factor) };
        let by = (100.0 * by).round() / 100.0;
        write!(
            f,
            ". A camera that is read with another number of bits writes such frames, and so does a program that scales \
             or shifts numbers. Calibrate from frames of the same kind, or {how} those of the session by {by}"
        )
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::data::Shown;
    use ndarray::Array2;
    use ommatidia_physics::noise::Sources;
    use ommatidia_session::FrameInfo;
    use rand_distr::{Distribution, StandardNormal};

    /// Two darks, and two flats of 2000 electrons if there are any, with a black level and a gain, rounded to whole DN.
    fn session(black_dn: f64, gain: f64, flats: bool) -> Observations {
        let mut rng = ommatidia_session::rng::stream(1, "units", 0);
        let mut frame = |k: usize, role: Role, electrons: f64| {
            let sigma = (electrons + 4.0).sqrt();
            let value = |z: f64| (black_dn + gain * (electrons + sigma * z)).round() as f32;
            Frame {
                stack: 0,
                role,
                info: FrameInfo::plain(k, 10.0),
                measured: Array2::from_shape_simple_fn((60, 60), || value(StandardNormal.sample(&mut rng))),
                cut: None,
                shown: if role == Role::Dark { Shown::Dark } else { Shown::Even },
                held_out: false,
                previous: (k % 2 == 1).then(|| k - 1),
            }
        };
        let roles = [(Role::Dark, 0.0), (Role::Dark, 0.0), (Role::Flat, 2000.0), (Role::Flat, 2000.0)];
        let frames = (0..if flats { 4 } else { 2 }).map(|k| frame(k, roles[k].0, roles[k].1)).collect();
        Observations {
            frames,
            truths: Vec::new(),
            registrations: Vec::new(),
            pixels: Vec::new(),
            blocks: Vec::new(),
            held_out_blocks: Vec::new(),
            sensor: [60, 60],
            recorded: 0,
            not_estimated: None,
        }
    }

    #[test]
    fn a_factor_on_all_numbers_is_another_unit_and_a_gain_or_an_offset_is_none() {
        let measured = Source::Measured;
        let sources = Sources { black_level: measured, gain: measured, read_noise: measured };
        let noise = NoiseModel { sources, ..NoiseModel::nominal() };
        for factor in [0.25, 4.0, 16.0] {
            let found = unit_of_flats(&session(64.0 * factor, 0.4 * factor, true), &noise).unwrap();
            assert!((found.factor / factor - 1.0).abs() < 0.02, "{found:?}");
        }
        for (black_dn, gain) in [(64.0, 0.4), (64.0, 1.6), (256.0, 0.4), (80.0, 0.5)] {
            assert_eq!(unit_of_flats(&session(black_dn, gain, true), &noise), None, "{black_dn} {gain}");
        }
        // Without flats scenes show it, and beside flats they do not.
        let darks = session(16.0, 0.1, false);
        let found = unit_of_scenes(&darks, &noise, 0.247).unwrap().to_string();
        assert!(
            found.contains("16.0 DN for 64.0 DN") && found.ends_with("multiply those of the session by 4"),
            "{found}"
        );
        assert_eq!(unit_of_scenes(&darks, &noise, 1.0), None);
        assert_eq!(unit_of_scenes(&session(16.0, 0.1, true), &noise, 0.25), None);
        // What was assumed of the sensor is no measure.
        assert_eq!(unit_of_flats(&session(16.0, 0.1, true), &NoiseModel::nominal()), None);
    }
}
