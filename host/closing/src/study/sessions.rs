//! What a session to close holds: of the same instrument, sessions of several kinds.

use anyhow::Context;
use ndarray::Array2;
use ommatidia_bench::{BenchConfig, VirtualInstrument};
use ommatidia_session::{MANIFEST, Role, Session, stack};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// What a session holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Holds {
    /// Darks, flats, and scenes of known objects.
    #[default]
    Whole,
    /// As `Whole`, with 48 scenes.
    ManyFrames,
    /// As `Whole`, with scenes of up to twenty thousand electrons a pixel.
    Bright,
    /// Scenes of known objects alone.
    ScenesAlone,
    /// A bead scan, and scenes of unknown objects.
    BeadsAndUnknown,
    /// Darks and flats alone.
    DarksAndFlats,
    /// One scene of a known object.
    OneFrame,
    /// A video of an unknown object, and darks.
    Video,
    /// As `Whole`; the objects are unknown.
    Unknown,
    /// One scene of an unknown object, beside darks and flats.
    OneUnknown,
    /// A hundred scenes of unknown objects, beside darks and flats.
    ManyUnknown,
    /// As `Whole`; truths are displaced by 0.3 object pixels.
    TruthShifted,
    /// As `Whole`; truths are turned by 0.4 degrees.
    TruthTurned,
    /// As `Whole`; truths are 1 % too large.
    TruthScaled,
}

impl Holds {
    /// Kinds that a person may have in place of a whole session.
    pub const PARTS: [Self; 5] =
        [Self::ScenesAlone, Self::BeadsAndUnknown, Self::DarksAndFlats, Self::OneFrame, Self::Video];
    /// Kinds whose truths do not lie quite where the objects were.
    pub const MISREGISTERED: [Self; 3] = [Self::TruthShifted, Self::TruthTurned, Self::TruthScaled];

    /// Kinds whose objects nobody knows.
    pub const UNKNOWN: [Self; 3] = [Self::OneUnknown, Self::Unknown, Self::ManyUnknown];

    /// The name in keys.
    pub fn name(self) -> &'static str {
        match self {
            Self::Whole => "whole",
            Self::ManyFrames => "many-frames",
            Self::Bright => "bright",
            Self::ScenesAlone => "scenes-alone",
            Self::BeadsAndUnknown => "beads-and-unknown",
            Self::DarksAndFlats => "darks-and-flats",
            Self::OneFrame => "one-frame",
            Self::Video => "video",
            Self::Unknown => "unknown",
            Self::OneUnknown => "one-unknown",
            Self::ManyUnknown => "many-unknown",
            Self::TruthShifted => "truth-shifted",
            Self::TruthTurned => "truth-turned",
            Self::TruthScaled => "truth-scaled",
        }
    }

    /// The name in tables.
    pub fn words(self) -> &'static str {
        match self {
            Self::Whole => "darks, flats, 8 known scenes",
            Self::ManyFrames => "the same with 48 scenes",
            Self::Bright => "the same with twenty thousand electrons",
            Self::ScenesAlone => "known scenes alone",
            Self::BeadsAndUnknown => "beads and unknown scenes",
            Self::DarksAndFlats => "darks and flats alone",
            Self::OneFrame => "one known scene",
            Self::Video => "a video of the unknown, with darks",
            Self::Unknown => "darks, flats, 8 unknown scenes",
            Self::OneUnknown => "the same with one scene",
            Self::ManyUnknown => "the same with 100 scenes",
            Self::TruthShifted => "truths displaced by 0.3 px",
            Self::TruthTurned => "truths turned by 0.4 degrees",
            Self::TruthScaled => "truths 1 % too large",
        }
    }

    fn roles(self) -> &'static [Role] {
        match self {
            Self::ScenesAlone | Self::OneFrame => &[Role::Scene],
            Self::BeadsAndUnknown => &[Role::Bead, Role::Scene],
            Self::DarksAndFlats => &[Role::Dark, Role::Flat],
            Self::Video => &[Role::Dark, Role::Scene],
            _ => &[Role::Dark, Role::Flat, Role::Scene],
        }
    }

    fn has_truth(self) -> bool {
        !matches!(self, Self::BeadsAndUnknown | Self::Video) && !Self::UNKNOWN.contains(&self)
    }

    /// The configuration of such a session, from that of a whole one.
    pub fn config(self, whole: &BenchConfig) -> BenchConfig {
        const BRIGHT_E: f64 = 20_000.0;
        let mut c = whole.clone();
        match self {
            Self::ManyFrames => c.stacks.scene_frames = 48,
            Self::Bright => {
                let share = (BRIGHT_E / c.full_scale_e()).min(0.9);
                c.stacks.scene_peak = [0.8 * share, share];
            }
            Self::OneFrame | Self::OneUnknown => c.stacks.scene_frames = 1,
            Self::ManyUnknown => c.stacks.scene_frames = 100,
            Self::Video => {
                (c.stacks.scene_frames, c.scenes.video_frames) = (24, 24);
                c.stacks.interval_ms = 20.0;
            }
            // The scan of a later day is coarser than that of the calibration, and in one plane.
            Self::BeadsAndUnknown => {
                (c.scan.rows, c.scan.cols) = (7, 7);
                c.scan.depths_um = vec![0.0];
            }
            _ => {}
        }
        c
    }

    /// Measures a session with a bench that was built from [`Holds::config`].
    ///
    /// # Errors
    /// The folder cannot be written.
    pub fn measure(self, bench: &VirtualInstrument, dir: &Path, seed: u64) -> anyhow::Result<Session> {
        Ok(self.measure_both(bench, dir, seed)?.0)
    }

    /// The same; beside the session the one with the truths that it withholds, if it does.
    ///
    /// # Errors
    /// The folder cannot be written.
    pub fn measure_both(
        self,
        bench: &VirtualInstrument,
        dir: &Path,
        seed: u64,
    ) -> anyhow::Result<(Session, Option<Session>)> {
        bench.measure_some(dir, seed, self.roles(), |_| {})?;
        let mut with_truths = None;
        if !self.has_truth() {
            with_truths = Some(Session::open(dir)?);
            forget_truth(dir)?;
        }
        if let Some(place) = self.misplaced() {
            let file = dir.join("scene_truth.npy");
            let mut truths = stack::read(&file)?;
            for mut truth in truths.outer_iter_mut() {
                let wrong = resampled(&truth.to_owned(), place);
                truth.assign(&wrong);
            }
            stack::write(&file, truths.view())?;
        }
        Ok((Session::open(dir)?, with_truths))
    }

    /// Where a point of the written truth lies in the object, relative to its centre, object pixels.
    fn misplaced(self) -> Option<fn([f64; 2]) -> [f64; 2]> {
        Some(match self {
            Self::TruthShifted => |[r, c]| [r - 0.18, c + 0.24],
            Self::TruthTurned => |[r, c]| {
                let (sin, cos) = 0.4f64.to_radians().sin_cos();
                [r * cos - c * sin, c * cos + r * sin]
            },
            Self::TruthScaled => |at| at.map(|v| v / 1.01),
            _ => return None,
        })
    }
}

/// An object with its light at other places, by bilinear interpolation.
fn resampled(object: &Array2<f32>, from: fn([f64; 2]) -> [f64; 2]) -> Array2<f32> {
    let (rows, cols) = object.dim();
    let centre = [rows, cols].map(|n| (n as f64 - 1.0) / 2.0);
    Array2::from_shape_fn((rows, cols), |(r, c)| {
        let at = from([r as f64 - centre[0], c as f64 - centre[1]]);
        let y = (at[0] + centre[0]).clamp(0.0, rows as f64 - 1.0);
        let x = (at[1] + centre[1]).clamp(0.0, cols as f64 - 1.0);
        let (r0, c0) = ((y as usize).min(rows.saturating_sub(2)), (x as usize).min(cols.saturating_sub(2)));
        let (fr, fc) = ((y - r0 as f64) as f32, (x - c0 as f64) as f32);
        let value = |r: usize, c: usize| object[[r.min(rows - 1), c.min(cols - 1)]];
        let line = |r: usize| value(r, c0) * (1.0 - fc) + value(r, c0 + 1) * fc;
        line(r0) * (1.0 - fr) + line(r0 + 1) * fr
    })
}

/// Takes the truths out of a session's manifest.
fn forget_truth(dir: &Path) -> anyhow::Result<()> {
    let file = dir.join(MANIFEST);
    let text = std::fs::read_to_string(&file).with_context(|| file.display().to_string())?;
    let kept: Vec<&str> = text.lines().filter(|l| !l.starts_with("truth = ")).collect();
    std::fs::write(&file, kept.join("\n")).with_context(|| file.display().to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_misplaced_truth_is_displaced_and_keeps_its_light() {
        let spot = |r: f64, c: f64| {
            Array2::from_shape_fn((31, 31), |(i, j)| {
                let square = (i as f64 - 15.0 - r).powi(2) + (j as f64 - 15.0 - c).powi(2);
                (-0.5 * square / 9.0).exp() as f32
            })
        };
        let centroid = |a: &Array2<f32>| {
            let sum: f32 = a.iter().sum();
            let r: f32 = a.indexed_iter().map(|((r, _), v)| r as f32 * v).sum();
            let c: f32 = a.indexed_iter().map(|((_, c), v)| c as f32 * v).sum();
            [r / sum - 15.0, c / sum - 15.0]
        };
        for (holds, expected) in [
            (Holds::TruthShifted, [4.18, -0.24]),
            (Holds::TruthTurned, [4.0, -4.0 * 0.4f32.to_radians()]),
            (Holds::TruthScaled, [4.04, 0.0]),
        ] {
            let found = holds.misplaced().map(|from| centroid(&resampled(&spot(4.0, 0.0), from))).unwrap_or_default();
            assert!((0..2).all(|k| (found[k] - expected[k]).abs() < 0.02), "{holds:?}: {found:?}");
        }
    }
}
