//! Faults of a session's records: what the session states of a frame and the frame contradicts.

use serde::{Deserialize, Serialize};

/// A fault in the record of one frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fault {
    /// Index of the frame in its stack, as the session numbers it.
    pub frame: usize,
    /// What is wrong.
    pub kind: FaultKind,
    /// Strength of the evidence, standard deviations.
    pub z: f64,
    /// Correlation of the frame with what the record predicts.
    pub correlation_before: f64,
    /// The same with the corrected record.
    pub correlation_after: f64,
}

/// What can be wrong with a record.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FaultKind {
    /// The frame shows the object that is recorded for another frame.
    Shows {
        /// Index of that frame in its stack.
        truth_of: usize,
    },
    /// The frame shows neither its object nor that of another scene. It counts as one of an unknown specimen.
    Unlike,
    /// The object is recorded flipped.
    Flipped {
        /// The order of rows is reversed.
        rows: bool,
        /// The order of columns is reversed.
        cols: bool,
    },
    /// The rows of the object are recorded as columns. With them exchanged and then, where so stated, reversed, it
    /// fits.
    Exchanged {
        /// The order of rows is reversed as well.
        rows: bool,
        /// The order of columns is reversed as well.
        cols: bool,
    },
    /// The object is recorded in a unit of light of its own.
    Unit {
        /// Light of the frame over that of the recorded object, relative to the median of the scenes.
        factor: f64,
    },
    /// The objects are too bright by the same light everywhere.
    Pedestal {
        /// This light, in the unit of the objects.
        level: f64,
    },
    /// The recorded exposure or light level is wrong.
    Exposure {
        /// True exposure over the recorded one.
        factor: f64,
    },
    /// The truths of all scenes lie beside the specimens that the frames show, all in the same way. They are left out.
    /// The fault has the number of the first of these scenes.
    Misplaced {
        /// Shift of the specimens from their truths along rows, object pixels.
        row_px: f64,
        /// The same along columns.
        col_px: f64,
        /// Turn, mrad: a point at (row, col) from the centre moves by so much times (col, -row).
        turn_mrad: f64,
        /// Size of the specimens relative to that of their truths, less one.
        scale: f64,
        /// Displacement of a corner of the field by turn and scale, object pixels.
        corner_px: f64,
    },
    /// The same for truths that each lie elsewhere.
    MisplacedOneByOne {
        /// Displacement of the truths from their mean place, root mean square, object pixels.
        rms_px: f64,
    },
}

/// What follows from misplaced truths.
const LEFT_OUT: &str = "With specimens that are estimated from the frames, the views behind the lenses agree with one \
                        another, so it is no change of the optics. The truths were left out, and no effect was \
                        searched for. Correct them and close again, or leave `truth` out of the stack; where nothing \
                        but their place is wrong, `truth_registration_px` and `truth_registration_per_frame` state how \
                        well they are placed";

impl FaultKind {
    /// Whether the truths were left out for it, so that no effect was searched for.
    pub fn is_of_all_truths(&self) -> bool {
        matches!(self, Self::Misplaced { .. } | Self::MisplacedOneByOne { .. })
    }

    /// How an image is turned or mirrored; empty for faults of another kind.
    pub(crate) fn turn_words(self) -> &'static str {
        match self {
            Self::Flipped { rows: true, cols: true } => "turned by 180 degrees",
            Self::Flipped { rows: true, .. } => "upside down",
            Self::Flipped { .. } => "mirrored left to right",
            Self::Exchanged { rows: false, cols: false } => "with rows and columns exchanged",
            Self::Exchanged { rows: true, cols: true } => "with rows and columns exchanged, and turned by 180 degrees",
            Self::Exchanged { rows: true, .. } => "turned by 90 degrees clockwise",
            Self::Exchanged { .. } => "turned by 90 degrees counter-clockwise",
            _ => "",
        }
    }
}

/// What scenes with light of their own may mean, and what to do. None: there is none among some faults.
pub(crate) fn unit_note(faults: &[Fault]) -> Option<String> {
    let factors =
        faults.iter().filter_map(|f| if let FaultKind::Unit { factor } = f.kind { Some(factor) } else { None });
    let [least, most] = factors.fold([f64::INFINITY, 0.0], |[least, most], f| [f64::min(least, f), f64::max(most, f)]);
    (most > 0.0).then(|| {
        format!(
            "each scene has light of its own, {least:.3} to {most:.3} times that of its object relative to the other \
             scenes, and the objects were scaled by it. The lamp flickers, or the light was not written down (give \
             each frame its `exposure_ms` or `illumination` in the table of the stack), or the objects are recorded in \
             units of their own (each scaled to the same maximum, for example) or not in proportion to light (gamma)"
        )
    })
}

impl Fault {
    /// The fault in one sentence, without a full stop.
    pub fn words(&self) -> String {
        match self.kind {
            FaultKind::Shows { truth_of } => {
                format!("scene frame {} shows the object that is recorded for frame {truth_of}", self.frame)
            }
            FaultKind::Unlike => format!(
                "scene frame {} shows neither the object that is recorded for it nor that of another scene, and \
                 counts as one of an unknown specimen",
                self.frame
            ),
            kind @ (FaultKind::Flipped { .. } | FaultKind::Exchanged { .. }) => {
                format!("the object of scene frame {} is recorded {}", self.frame, kind.turn_words())
            }
            FaultKind::Unit { factor } => format!(
                "scene frame {} has {factor:.4} times the light of its object, relative to the other scenes",
                self.frame
            ),
            FaultKind::Pedestal { level } => format!(
                "the object of scene frame {} is {level:.4} too bright everywhere, in its own unit: the black level \
                 of the camera that took it, for example",
                self.frame
            ),
            FaultKind::Exposure { factor } => {
                format!("scene frame {} received {factor:.4} times the recorded exposure", self.frame)
            }
            FaultKind::Misplaced { row_px, col_px, turn_mrad, scale, corner_px } => {
                let percent = 100.0 * (1.0 / (1.0 + scale) - 1.0);
                format!(
                    "the truths do not lie where the frames show the specimens: they are {:.2} % too {}, turned by \
                     {:.1} mrad and displaced by ({:.2}, {:.2}) object pixels (row, col), a corner of the field by \
                     {corner_px:.2} object pixels. {LEFT_OUT}",
                    percent.abs(),
                    if percent < 0.0 { "small" } else { "large" },
                    -turn_mrad,
                    -row_px,
                    -col_px
                )
            }
            FaultKind::MisplacedOneByOne { rms_px } => format!(
                "the truths do not lie where the frames show the specimens, each elsewhere: {rms_px:.2} object pixels \
                 from their mean place (root mean square). Nothing that is the same in all frames does that: the \
                 specimen or the array moved from frame to frame, or the truths were placed one by one. They were left \
                 out, and no effect was searched for. State how well they are placed (`truth_registration_px` with \
                 `truth_registration_per_frame`), or leave `truth` out of the stack"
            ),
        }
    }
}
