//! Scenes or flats that a program has changed: scaled to 0 to 1 or to 8 bits, shifted to higher bits, with the black
//! level subtracted.
//!
//! What such frames leave is no effect of the optics or the sensor, and a search for one takes long and ends in false
//! names. So they are an error.

use super::observe::{Frame, Observations};
use super::unit::black_dn;
use ommatidia_physics::noise::{NoiseModel, Source};
use ommatidia_physics::sensor::{FrameRange, Oddity, Scaled};
use ommatidia_session::Role;

/// Frames of one role that no sensor delivers beside the darks of the session.
#[derive(Clone, Debug, PartialEq)]
pub struct ScaledFrames {
    /// Their role.
    pub role: Role,
    /// How many of them, of all of that role.
    pub count: [usize; 2],
    /// What is odd about the first of them.
    pub words: String,
}

/// Scenes or flats of which more than half have been changed by a program. None: there are none.
///
/// They are compared with the darks of the session. Without darks a black level that has changed is a free quantity of
/// the session, so that only values that no setting of the sensor gives count. Where darks and calibration disagree,
/// the lower black level counts: light may have fallen on the darks.
pub(crate) fn scaled_frames(seen: &Observations, noise: &NoiseModel) -> Option<ScaledFrames> {
    let (darks, known) = (black_dn(seen), noise.sources.black_level == Source::Measured);
    let black_level_dn = darks.map_or(noise.black_level_dn, |dn| if known { dn.min(noise.black_level_dn) } else { dn });
    let range = FrameRange { black_level_dn, saturation_dn: noise.saturation_dn };
    let changed = |f: &&Frame| {
        let oddity = range.oddity(f.measured.view())?;
        let is_changed = match oddity {
            Oddity::Above(_) => true,
            Oddity::Below { like: Scaled::ToOne | Scaled::EightBit, .. } => true,
            Oddity::Below { like: Scaled::Subtracted, .. } => darks.is_some(),
            _ => false,
        };
        is_changed.then_some(oddity)
    };
    [Role::Scene, Role::Flat].into_iter().find_map(|role| {
        let frames: Vec<&Frame> = seen.frames.iter().filter(|f| f.role == role).collect();
        let odd: Vec<Oddity> = frames.iter().filter_map(changed).collect();
        let first = odd.first().filter(|_| 2 * odd.len() > frames.len())?;
        Some(ScaledFrames { role, count: [odd.len(), frames.len()], words: range.words(*first) })
    })
}

impl std::fmt::Display for ScaledFrames {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { role, count: [odd, all], words } = self;
        let role = role.name();
        write!(f, "{odd} of {all} {role} frames are not as the sensor delivers them: {words}")
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::data::Shown;
    use crate::data::unit::testing::observations;
    use ndarray::Array2;
    use ommatidia_physics::noise::Sources;
    use rand_distr::{Distribution, StandardNormal};

    /// Darks of a black level and scenes of one bright spot, changed by `change`.
    fn session(darks: usize, black_dn: f64, change: impl Fn(f32) -> f32) -> Observations {
        let mut rng = ommatidia_session::rng::stream(1, "scaled", 0);
        let mut frame = |light_dn: f64| {
            Array2::from_shape_fn((60, 60), |(r, c)| {
                let off = ((r as f64 - 30.0).powi(2) + (c as f64 - 25.0).powi(2)) / 60.0;
                let mean = black_dn + light_dn * (-off).exp();
                let z: f64 = StandardNormal.sample(&mut rng);
                (mean + (4.0 + 0.4 * (mean - black_dn)).sqrt() * z).round() as f32
            })
        };
        let mut frames: Vec<_> = (0..darks).map(|_| (Role::Dark, Shown::Dark, frame(0.0))).collect();
        frames.extend((0..4).map(|_| (Role::Scene, Shown::Unknown, frame(2000.0).mapv(&change))));
        observations(frames)
    }

    #[test]
    fn scaled_and_subtracted_scenes_are_found_and_other_settings_are_not() {
        let measured = Source::Measured;
        let sources = Sources { black_level: measured, gain: measured, read_noise: measured };
        let noise = NoiseModel { sources, ..NoiseModel::nominal() };
        let found = |darks, black_dn, change: &dyn Fn(f32) -> f32| {
            scaled_frames(&session(darks, black_dn, change), &noise).map(|found| found.to_string())
        };
        let says = |text: Option<String>, words: &str| {
            let text = text.unwrap();
            assert!(text.starts_with("4 of 4 scene frames") && text.contains(words), "{text}");
        };
        let black = NoiseModel::nominal().black_level_dn;
        says(found(2, black, &|v| v / 4095.0), "scaled to 0 to 1");
        says(found(0, black, &|v| v / 4095.0), "scaled to 0 to 1");
        says(found(2, black, &|v| (v / 16.0).floor()), "8 bits");
        says(found(2, black, &|v| v - black as f32), "black level looks subtracted");
        says(found(2, black, &|v| 16.0 * v), "full scale is 4095");
        // As the sensor gives them; with another offset in darks and scenes; with another offset and no darks.
        assert_eq!(found(2, black, &|v| v), None);
        assert_eq!(found(2, 0.1 * black, &|v| v), None);
        assert_eq!(found(0, black, &|v| v - black as f32), None);
        // Scenes are a little darker than the darks, since the black level has drifted.
        assert_eq!(found(2, black, &|v| v - 8.0), None);
    }
}
