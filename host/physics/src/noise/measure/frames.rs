//! Reads the frames of a session by exposure and light level, and estimates the black level where there are no darks.

use super::notes::NoiseError;
use crate::noise::stats::PixelStats;
use ommatidia_session::{Role, Session, Stack};

/// Share of the pixels of a scene that count as dark if no other frames show the black level.
pub(super) const DARKEST: f64 = 1e-3;

/// Frames of one exposure and light level.
pub(super) struct Group {
    /// Indices (stack of the role, frame in the stack).
    pub frames: Vec<(usize, usize)>,
    /// Exposure, ms.
    pub exposure_ms: f64,
    /// Exposure times illumination, ms; 0 for darks.
    pub dose: f64,
}

/// The frames of one role, grouped by exposure and light level; darks by exposure only.
pub(super) fn groups(session: &Session, role: Role) -> Vec<Group> {
    let mut keyed: Vec<([f64; 2], Group)> = Vec::new();
    for (s, stack) in session.stacks_of(role).enumerate() {
        for info in stack.whole() {
            let key = [info.exposure_ms, if role == Role::Dark { 0.0 } else { info.illumination }];
            match keyed.iter_mut().find(|(k, _)| *k == key) {
                Some((_, g)) => g.frames.push((s, info.frame)),
                None => {
                    let (frames, exposure_ms, dose) = (vec![(s, info.frame)], key[0], key[0] * key[1]);
                    keyed.push((key, Group { frames, exposure_ms, dose }));
                }
            }
        }
    }
    keyed.into_iter().map(|(_, g)| g).collect()
}

/// The darks that show what is in the other frames without light: those whose exposure is nearest to that of the beads,
/// or else of the flats, or else of the scenes, since dark current grows with it. Of two that are as near the ones with
/// more frames; single frames only where there is nothing else.
pub(super) fn darks(session: &Session) -> Option<Group> {
    let first = |role| session.stacks_of(role).flat_map(Stack::whole).map(|info| info.exposure_ms).next();
    let lit_ms = [Role::Bead, Role::Flat, Role::Scene].into_iter().find_map(first);
    let distance = |g: &Group| {
        let ratio = lit_ms.map_or(0.0, |ms| (g.exposure_ms / ms).ln().abs());
        // Darks may have an exposure of zero.
        if ratio.is_nan() { 0.0 } else { ratio }
    };
    let few = |g: &Group| g.frames.len() < 2;
    groups(session, Role::Dark).into_iter().min_by(|a, b| {
        let by_exposure = few(a).cmp(&few(b)).then(distance(a).total_cmp(&distance(b)));
        by_exposure.then(b.frames.len().cmp(&a.frames.len()))
    })
}

/// Reads the frames of a group and sums their statistics; `step` is called after each frame.
pub(super) fn read_group(
    session: &Session,
    role: Role,
    group: &Group,
    step: &mut dyn FnMut(),
) -> Result<PixelStats, NoiseError> {
    let mut readers = session.stacks_of(role).map(Stack::frames).collect::<Result<Vec<_>, _>>()?;
    let sensor = session.manifest().sensor;
    let mut stats = PixelStats::new([sensor.rows, sensor.cols]);
    for (s, frame) in &group.frames {
        stats.add(&readers[*s].read(*frame)?);
        step();
    }
    Ok(stats)
}

/// Estimates from the dark parts of the bead frames.
#[derive(Clone, Copy)]
pub(super) struct Background {
    /// Black level, DN.
    pub median: f64,
    /// Variance of a dark pixel, DN^2.
    pub variance: f64,
}

/// At most nine frames of a stack, evenly spread; damaged ones do not count.
fn some(stack: &Stack) -> impl Iterator<Item = usize> {
    let whole: Vec<usize> = stack.whole().map(|info| info.frame).collect();
    let every = whole.len().div_ceil(9).max(1);
    whole.into_iter().step_by(every)
}

/// The quantile [`DARKEST`] of the scenes, DN; 0 if there are none.
pub(super) fn darkest(session: &Session) -> Result<f64, NoiseError> {
    let mut least = f64::INFINITY;
    for stack in session.stacks_of(Role::Scene) {
        let mut frames = stack.frames()?;
        for i in some(stack) {
            let mut values: Vec<f32> = frames.read(i)?.into_iter().collect();
            let at = (values.len() as f64 * DARKEST) as usize;
            least = least.min(f64::from(*values.select_nth_unstable_by(at, f32::total_cmp).1));
        }
    }
    Ok(if least.is_finite() { least } else { 0.0 })
}

/// Median of bead frames, and the variance of the pixels below it, which no focus touches.
pub(super) fn background_of_beads(session: &Session, step: &mut dyn FnMut()) -> Result<Background, NoiseError> {
    let (mut medians, mut variances) = (Vec::new(), Vec::new());
    if let Some(stack) = session.stacks_of(Role::Bead).next() {
        let mut frames = stack.frames()?;
        for i in some(stack) {
            let mut values: Vec<f32> = frames.read(i)?.into_iter().collect();
            let middle = values.len() / 2;
            let median = f64::from(*values.select_nth_unstable_by(middle, f32::total_cmp).1);
            let below = values[..middle].iter().map(|v| (f64::from(*v) - median).powi(2)).sum::<f64>();
            medians.push(median);
            variances.push(below / middle.max(1) as f64);
            step();
        }
    }
    let middle = |v: &mut Vec<f64>| {
        v.sort_by(f64::total_cmp);
        v.get(v.len() / 2).copied().unwrap_or(0.0)
    };
    Ok(Background { median: middle(&mut medians), variance: middle(&mut variances) })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// Twelve scenes without darks: the black level is that of the whole ones, and not of the two that hold zeros.
    #[test]
    fn damaged_scenes_say_nothing_of_the_black_level() {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path();
        let manifest = "format = 1\nname = \"film\"\n[sensor]\nrows = 20\ncols = 24\npixel_pitch_um = 2.0\n\
                        bit_depth = 12\n[array]\nrows = 1\ncols = 1\npitch_px = 20.0\n[optics]\n\
                        magnification = 0.66\npsf_window_px = 9\n[object]\nrows = 8\ncols = 8\npixel_um = 3.0\n\
                        [[stack]]\nrole = \"scene\"\nfile = \"scene.npy\"\nexposure_ms = 10.0\ntable = \"scene.csv\"\n";
        std::fs::write(dir.join("session.toml"), manifest).unwrap();
        let damaged = |f: usize| f == 0 || f == 7;
        let stack = ndarray::Array3::from_shape_fn((12, 20, 24), |(f, r, _)| match damaged(f) {
            true => 0.0,
            false => 100.0 + r as f32,
        });
        ommatidia_session::stack::write(&dir.join("scene.npy"), stack.view()).unwrap();
        let data = |f: usize| if damaged(f) { "damaged" } else { "whole" };
        let rows: String = (0..12).map(|f| format!("{f},{}\n", data(f))).collect();
        std::fs::write(dir.join("scene.csv"), format!("frame,data\n{rows}")).unwrap();
        let session = Session::open(dir).unwrap();
        assert_eq!(darkest(&session).unwrap(), 100.0);
        assert!(some(&session.stacks()[0]).count() <= 9);
    }
}
