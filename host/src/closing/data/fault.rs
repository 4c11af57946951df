//! Faults of a session's records.

use serde::{Deserialize, Serialize};

/// A fault of one frame's record.
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
    /// The same once the record is put right.
    pub correlation_after: f64,
}

/// What can be wrong with a record.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FaultKind {
    /// The frame shows the object that is written down for another frame.
    Shows {
        /// That frame.
        truth_of: usize,
    },
    /// The object is written down upside down or the wrong way round.
    Flipped {
        /// Rows.
        rows: bool,
        /// Columns.
        cols: bool,
    },
    /// The exposure or light level is written down wrong.
    Exposure {
        /// True over written.
        factor: f64,
    },
}

impl Fault {
    /// In words.
    pub fn words(&self) -> String {
        match self.kind {
            FaultKind::Shows { truth_of } => {
                format!("scene frame {} shows the object that is written down for frame {truth_of}", self.frame)
            }
            FaultKind::Flipped { rows, cols } => {
                let axis = match (rows, cols) {
                    (true, true) => "turned by 180 degrees",
                    (true, false) => "upside down",
                    _ => "mirrored left to right",
                };
                format!("the object of scene frame {} is written down {axis}", self.frame)
            }
            FaultKind::Exposure { factor } => {
                format!("scene frame {} was exposed {factor:.4} times as much as is written down", self.frame)
            }
        }
    }
}
