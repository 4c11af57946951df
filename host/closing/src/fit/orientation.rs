//! Frames that are turned or mirrored as a whole: the camera was mounted in another way than for the calibration, or a
//! program has turned what it wrote.

use super::record::{IN_PLACE, Seen, Turn, correlation, median};
use crate::data::FaultKind;

/// Turned back, the scenes leave less than this share of the unexplained variance, (1 - correlation), of what they
/// leave as they are, and of what turned objects leave.
const BETTER: f64 = 0.5;
/// Number of scenes that this takes.
const SCENES: usize = 2;

/// How the frames of a session are turned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orientation {
    /// What turns them back.
    pub turn: FaultKind,
    /// Median correlation with their records as they are.
    pub own: f64,
    /// The same after they were turned back.
    pub turned: f64,
}

/// Finds that the scenes fit their records after one turn of the whole frame, and that no turn of the objects does the
/// same: the lenses of an array differ, so that the two are not alike. None: they are not turned.
pub fn orientation(frames: &[Seen]) -> Option<Orientation> {
    let all = |of: &dyn Fn(&Seen) -> f64| median(frames.iter().map(of).collect());
    let own = all(&|s| correlation(&s.measured, &s.own))?;
    if frames.len() < SCENES || own > IN_PLACE {
        return None;
    }
    let by_object = |s: &Seen| {
        let turned = s.turned.iter().map(|t| correlation(&s.measured, &t.light));
        turned.fold(correlation(&s.measured, &s.own), f64::max)
    };
    let objects = all(&by_object)?;
    let of = |turn: Turn| Some((all(&|s| correlation(&turn.of(&s.measured), &s.own))?, turn));
    let (turned, turn) = Turn::all(frames.first()?.measured.dim()).filter_map(of).max_by(|a, b| a.0.total_cmp(&b.0))?;
    let leaves_less = |than: f64| 1.0 - turned < BETTER * (1.0 - than);
    (leaves_less(own) && leaves_less(objects)).then(|| Orientation { turn: turn.fault(), own, turned })
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::super::record::Turned;
    use super::*;
    use ndarray::Array2;

    /// The frame of an object: a copy behind each of two lenses, of which one is dimmer.
    fn frame(object: &Array2<f32>) -> Array2<f32> {
        Array2::from_shape_fn((48, 48), |(r, c)| {
            let at = |row: usize, col: usize| object.get((r.wrapping_sub(row), c.wrapping_sub(col))).copied();
            at(4, 4).unwrap_or(0.0) + 0.5 * at(22, 26).unwrap_or(0.0)
        })
    }

    fn scenes(frame_turned: bool, object_turned: bool) -> Vec<Seen> {
        let mirror = Turn { exchanged: false, rows: false, cols: true };
        (0..4)
            .map(|k| {
                let object = Array2::from_shape_fn((20, 20), |(r, c)| ((r * (7 + k) + c * 13 + r * c) % 29) as f32);
                let mirrored = mirror.of(&object);
                let shown = frame(if object_turned { &mirrored } else { &object });
                Seen {
                    frame: k,
                    measured: if frame_turned { mirror.of(&shown) } else { shown },
                    moved: None,
                    own: frame(&object),
                    turned: vec![Turned { turn: mirror, light: frame(&mirrored) }],
                }
            })
            .collect()
    }

    #[test]
    fn mirrored_frames_are_found_and_mirrored_objects_are_none() {
        let found = orientation(&scenes(true, false)).unwrap();
        assert_eq!(found.turn.turn_words(), "mirrored left to right");
        assert!(found.turned > 0.999 && found.own < 0.8, "{found:?}");
        assert_eq!(orientation(&scenes(false, true)), None);
        assert_eq!(orientation(&scenes(false, false)), None);
    }
}
