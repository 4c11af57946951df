//! Frames that a sensor cannot have delivered, judged by what is known of it: its black level and its full scale.
//!
//! Light adds to the black level, and a frame holds noise. So no frame has many pixels below the black level by more
//! than its noise, none has a value above full scale, and none is constant. Every threshold is a multiple of the noise
//! that is read off the frame itself, or a share that defect pixels do not reach.

use ndarray::{Array2, ArrayView2};
use ommatidia_session::{Role, Session, SessionError};
use std::fmt;
use std::path::Path;

/// Pixels this many standard deviations off the black level are not there by noise: 1 in 3.5 million is.
const SIGMAS: f32 = 5.0;
/// Share of pixels that may be defects: more than sensors are sold with.
const DEFECTS: f64 = 0.01;
/// Side of the blocks whose means show structure, pixels.
const BLOCK: usize = 8;
/// The smallest noise of a frame, DN: rounding has 0.29, and a frame of expected values has none.
const LEAST_DN: f32 = 0.5;

/// The codes that a sensor delivers, DN.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameRange {
    /// Mean signal without light, DN.
    pub black_level_dn: f64,
    /// The highest code, DN.
    pub saturation_dn: f64,
}

/// What is odd about a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Oddity {
    /// Every pixel has this value, DN.
    Constant(f64),
    /// No pixel differs from the black level by more than noise, and neighbours have nothing in common.
    Dark,
    /// This share of the pixels is at full scale.
    Saturated(f64),
    /// The largest value, DN, is above full scale.
    Above(f64),
    /// This share of the pixels is below the black level by more than noise.
    Below {
        /// The share.
        share: f64,
        /// What the values look like.
        like: Scaled,
    },
}

/// What values that are too small look like.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scaled {
    /// Values from 0 to 1.
    ToOne,
    /// Codes of 8 bits, where the sensor has more.
    EightBit,
    /// The black level was subtracted.
    Subtracted,
    /// Frames of another sensor, or of another setting of it.
    Other,
}

impl FrameRange {
    /// What is odd about a raw frame, DN, [rows, cols]; `None` for a frame that a sensor may have delivered, and for
    /// one with values that are not finite, which is an error elsewhere.
    ///
    /// ```
    /// use ndarray::Array2;
    /// use ommatidia_physics::sensor::{FrameRange, Oddity};
    ///
    /// let sensor = FrameRange { black_level_dn: 64.0, saturation_dn: 4095.0 };
    /// let frame = Array2::from_shape_fn((32, 32), |(r, c)| 64.0 + (100 * (r / 8) + (r * 7 + c * 5) % 9) as f32);
    /// assert_eq!(sensor.oddity(frame.view()), None);
    /// assert_eq!(sensor.oddity(Array2::from_elem((32, 32), 7.0).view()), Some(Oddity::Constant(7.0)));
    /// assert!(matches!(sensor.oddity((frame - 64.0).view()), Some(Oddity::Below { .. })));
    /// ```
    pub fn oddity(&self, frame_dn: ArrayView2<'_, f32>) -> Option<Oddity> {
        if frame_dn.is_empty() || frame_dn.iter().any(|v| !v.is_finite()) {
            return None;
        }
        let (black, full) = (self.black_level_dn as f32, self.saturation_dn as f32);
        let high = frame_dn.iter().fold(f32::NEG_INFINITY, |high, v| high.max(*v));
        let share =
            |odd: &dyn Fn(f32) -> bool| frame_dn.iter().filter(|v| odd(**v)).count() as f64 / frame_dn.len() as f64;
        if high > full + 0.5 {
            return Some(Oddity::Above(high.into()));
        }
        let saturated = share(&|v| v >= full);
        if saturated > DEFECTS {
            return Some(Oddity::Saturated(saturated));
        }
        if let Some(value) = constant_dn(frame_dn.iter()) {
            return Some(Oddity::Constant(value.into()));
        }
        let noise = noise_dn(frame_dn);
        let below = share(&|v| v < black - SIGMAS * noise.max(LEAST_DN));
        if below > DEFECTS {
            return Some(Oddity::Below { share: below, like: self.scaled(frame_dn, high) });
        }
        let lit = share(&|v| v > black + SIGMAS * noise.max(LEAST_DN));
        (lit < DEFECTS / 10.0 && !structured(frame_dn, black, noise)).then_some(Oddity::Dark)
    }

    /// Whether a frame that should hold light above black, DN, still holds the black level: its darkest pixels lie
    /// there.
    pub fn holds_black(&self, frame_dn: ArrayView2<'_, f32>) -> bool {
        let noise = SIGMAS * noise_dn(frame_dn).max(LEAST_DN);
        let mut values: Vec<f32> = frame_dn.iter().copied().filter(|v| v.is_finite()).collect();
        let at = (DEFECTS * values.len() as f64) as usize;
        if at >= values.len() || self.black_level_dn as f32 <= 2.0 * noise {
            return false;
        }
        let darkest = *values.select_nth_unstable_by(at, f32::total_cmp).1;
        (darkest - self.black_level_dn as f32).abs() <= noise
    }

    /// An oddity in words, with what to do.
    pub fn words(&self, oddity: Oddity) -> String {
        Words(*self, oddity).to_string()
    }

    /// What values that are too small look like; `high` is the largest.
    fn scaled(&self, frame_dn: ArrayView2<'_, f32>, high: f32) -> Scaled {
        let whole = frame_dn.iter().all(|v| v.fract() == 0.0);
        let black = self.black_level_dn as f32;
        // Without light a frame that was subtracted is at 0, one of 8 bits at its share of the black level.
        let dark = lower_part(frame_dn);
        match high {
            high if high <= 1.0 => Scaled::ToOne,
            high if high <= 255.0 && whole && self.saturation_dn > 511.0 && dark < 0.5 * black => Scaled::EightBit,
            _ if dark.abs() < 0.25 * black => Scaled::Subtracted,
            _ => Scaled::Other,
        }
    }
}

/// The value of all pixels of a frame, DN; None where two differ, or there are none.
pub fn constant_dn<'a>(mut frame_dn: impl Iterator<Item = &'a f32>) -> Option<f32> {
    let first = frame_dn.next()?;
    frame_dn.all(|v| v == first).then_some(*first)
}

/// What a frame whose pixels all have one value, DN, means for a user.
pub fn constant_words(value_dn: f64) -> String {
    format!("every pixel is {value_dn} DN: no sensor delivers that; was the frame recorded at all?")
}

/// Noise of a frame, DN: from the differences of neighbours in a row, of which most hold no structure.
fn noise_dn(frame_dn: ArrayView2<'_, f32>) -> f32 {
    let mut differences: Vec<f32> = frame_dn
        .rows()
        .into_iter()
        .flat_map(|row| row.windows(2).into_iter().map(|w| (w[1] - w[0]).abs()).collect::<Vec<_>>())
        .collect();
    let half = differences.len() / 2;
    if differences.is_empty() {
        return 0.0;
    }
    // The median of |N(0, 1)| is 0.6745; a difference has twice the variance of a pixel.
    *differences.select_nth_unstable_by(half, f32::total_cmp).1 / 0.6745 / std::f32::consts::SQRT_2
}

/// The value that a tenth of the pixels lie below, DN.
fn lower_part(frame_dn: ArrayView2<'_, f32>) -> f32 {
    let mut values: Vec<f32> = frame_dn.iter().copied().collect();
    let at = values.len() / 10;
    *values.select_nth_unstable_by(at, f32::total_cmp).1
}

/// Whether the means of blocks vary by more than independent noise of the pixels lets them. Defects are cut off.
fn structured(frame_dn: ArrayView2<'_, f32>, black: f32, noise: f32) -> bool {
    let most = SIGMAS * noise.max(LEAST_DN);
    let cut: Array2<f32> = frame_dn.mapv(|v| (v - black).clamp(-most, most));
    let blocks: Vec<f64> = cut
        .exact_chunks((BLOCK.min(cut.nrows()), BLOCK.min(cut.ncols())))
        .into_iter()
        .map(|block| f64::from(block.sum()) / block.len() as f64)
        .collect();
    let n = blocks.len() as f64;
    if n < 2.0 {
        return true;
    }
    let variance = |values: &mut dyn Iterator<Item = f64>, n: f64| {
        let (sum, squares) = values.fold((0.0, 0.0), |(s, q), v| (s + v, q + v * v));
        ((squares - sum * sum / n) / (n - 1.0)).max(0.0)
    };
    let of_pixels = variance(&mut cut.iter().map(|v| f64::from(*v)), cut.len() as f64);
    let expected = of_pixels / (BLOCK.min(cut.nrows()) * BLOCK.min(cut.ncols())) as f64;
    // The variance of n means of noise has the relative standard error sqrt(2 / (n - 1)).
    variance(&mut blocks.iter().copied(), n) > expected * (1.0 + f64::from(SIGMAS) * (2.0 / (n - 1.0)).sqrt())
}

/// Watches the frames of a stack: the first odd one is remembered, the others are counted.
#[derive(Clone, Debug)]
pub struct FrameWatch {
    range: FrameRange,
    first: Option<(usize, Oddity)>,
    odd: usize,
    seen: usize,
}

impl FrameWatch {
    /// Watches frames of this sensor.
    pub fn new(range: FrameRange) -> Self {
        Self { range, first: None, odd: 0, seen: 0 }
    }

    /// Looks at frame `i` of the stack.
    pub fn see(&mut self, i: usize, frame_dn: ArrayView2<'_, f32>) {
        self.seen += 1;
        if let Some(oddity) = self.range.oddity(frame_dn) {
            self.odd += 1;
            self.first.get_or_insert((i, oddity));
        }
    }

    /// The warning for the stack at `path`, if a frame was odd.
    pub fn warning(&self, path: &Path) -> Option<String> {
        let (frame, oddity) = self.first?;
        let others = match self.odd - 1 {
            0 => String::new(),
            more => format!(" ({more} more of {} are odd, too)", self.seen),
        };
        Some(format!("{}: frame {frame}{others}: {}", path.display(), self.range.words(oddity)))
    }
}

/// Warnings for the scenes of a session whose frames do not fit what is known of the sensor, one a stack.
///
/// # Errors
/// A frame cannot be read.
pub fn odd_scenes(session: &Session, range: FrameRange) -> Result<Vec<String>, SessionError> {
    let mut warnings = Vec::new();
    for stack in session.stacks_of(Role::Scene) {
        let (mut frames, mut watch) = (stack.frames()?, FrameWatch::new(range));
        for i in 0..frames.len() {
            watch.see(i, frames.read(i)?.view());
        }
        warnings.extend(watch.warning(&stack.path()));
    }
    Ok(warnings)
}

/// An oddity in words.
struct Words(FrameRange, Oddity);

impl fmt::Display for Words {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(FrameRange { black_level_dn: black, saturation_dn: full }, oddity) = self;
        match oddity {
            Oddity::Constant(value) => f.write_str(&constant_words(*value)),
            Oddity::Dark => write!(
                f,
                "no light above the noise, all pixels lie at the black level ({black:.1} DN): was the shutter closed, \
                 the lamp off?"
            ),
            Oddity::Saturated(share) => write!(
                f,
                "{:.1} % of the pixels are at full scale ({full} DN), where the light is lost: expose for a shorter \
                 time",
                100.0 * share
            ),
            Oddity::Above(value) => write!(
                f,
                "a pixel has {value} DN, and full scale is {full} DN: frames of more bits, or shifted to the high bits \
                 of 16? Give the codes of the sensor"
            ),
            Oddity::Below { share, like } => {
                let looks = match like {
                    Scaled::ToOne => "the values look scaled to 0 to 1",
                    Scaled::EightBit => "they look like frames of 8 bits",
                    Scaled::Subtracted => "the black level looks subtracted",
                    Scaled::Other => "they look like frames of another sensor or setting",
                };
                write!(
                    f,
                    "{:.0} % of the pixels lie below the black level ({black:.1} DN) by more than noise: {looks}. Give \
                     frames as the sensor delivers them, with nothing subtracted or scaled",
                    100.0 * share
                )
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::noise::NoiseModel;
    use ommatidia_session::rng::stream;
    use rand::RngExt;

    const RANGE: FrameRange = FrameRange { black_level_dn: 64.0, saturation_dn: 4095.0 };

    /// A frame with a bright spot of `light` DN, noise of the noise model, and `defects` hot and dead pixels.
    fn frame(seed: u64, light: f64, defects: usize) -> Array2<f32> {
        let noise = NoiseModel::nominal();
        let mut rng = stream(seed, "frames of the watch", 0);
        let mut frame = Array2::from_shape_fn((96, 120), |(r, c)| {
            let off = ((r as f64 - 40.0).powi(2) + (c as f64 - 70.0).powi(2)) / 300.0;
            let mean = noise.black_level_dn + light * (-off).exp();
            // The sum of twelve uniform numbers is nearly normal.
            let normal = (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
            (mean + noise.variance_dn2(mean).sqrt() * normal).round().clamp(0.0, 4095.0) as f32
        });
        for i in 0..defects {
            frame[[(i * 37) % 96, (i * 53) % 120]] = if i % 2 == 0 { 4095.0 } else { 0.0 };
        }
        frame
    }

    #[test]
    fn frames_of_a_sensor_pass_at_any_light() {
        for seed in 0..40 {
            for light in [2.0, 5.0, 30.0, 300.0, 3000.0] {
                let frame = frame(seed, light, 20);
                assert_eq!(RANGE.oddity(frame.view()), None, "seed {seed}, {light} DN");
                assert!(!RANGE.holds_black((frame - 64.0).view()));
            }
        }
    }

    #[test]
    fn frames_that_cannot_be_are_named() {
        for seed in 0..20 {
            let raw = frame(seed, 800.0, 20);
            let odd = |frame: Array2<f32>| RANGE.oddity(frame.view());
            let like = |frame: Array2<f32>| match odd(frame) {
                Some(Oddity::Below { like, .. }) => like,
                other => panic!("seed {seed}: {other:?}"),
            };
            assert_eq!(like(&raw / 4095.0), Scaled::ToOne);
            assert_eq!(like(raw.mapv(|v| (v / 16.0).floor())), Scaled::EightBit);
            assert_eq!(like(&raw - 64.0), Scaled::Subtracted);
            assert_eq!(like(&raw - 30.0), Scaled::Other);
            assert_eq!(odd(frame(seed, 0.0, 5)), Some(Oddity::Dark), "seed {seed}");
            assert!(matches!(odd(&raw * 16.0), Some(Oddity::Above(_))));
            assert!(matches!(odd(raw.mapv(|v| (v * 20.0).min(4095.0))), Some(Oddity::Saturated(_))));
            assert_eq!(odd(Array2::from_elem((9, 9), 100.0)), Some(Oddity::Constant(100.0)));
            assert!(RANGE.holds_black(raw.view()));
        }
    }

    #[test]
    fn the_first_odd_frame_is_named_and_the_others_are_counted() {
        let mut watch = FrameWatch::new(RANGE);
        assert_eq!(watch.warning(Path::new("a.npy")), None);
        for (i, frame) in
            [frame(1, 300.0, 0), frame(2, 300.0, 0) / 4095.0, frame(3, 300.0, 0) - 64.0].iter().enumerate()
        {
            watch.see(i, frame.view());
        }
        let text = watch.warning(Path::new("a.npy")).unwrap();
        for words in ["a.npy: frame 1 (1 more of 3 are odd, too)", "scaled to 0 to 1", "64.0 DN"] {
            assert!(text.contains(words), "{text}");
        }
    }
}
