//! The shape of feedback: passes that compare what the passes before them found with the frame.

use super::TrainError;
use serde::{Deserialize, Serialize};

/// Largest number of passes after the first one.
const MOST_PASSES: usize = 7;

/// Shape of the feedback of a network.
///
/// A pass predicts the frame of the reconstruction x so far with a short low-rank model A of the calibrated PSFs, puts
/// the prediction through the same filters F as the frame y, and gives `F y - s F A x` and x to an enhancement network
/// of its own, whose logits are added to those before. The scale s fits best (least squares). It is a learned step of
/// the iteration `x + F (y - A x)`, where the filters play the part of an inverse of A (J. Adler, O. Oektem, Inverse
/// Problems 33, 124007 (2017)).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Feedback {
    /// Number of passes after the first one.
    pub passes: usize,
    /// Frame pixel of object pixel (0, 0) behind each living lens.
    pub corners: Vec<[i32; 2]>,
    /// Number of terms of each lens.
    pub terms: usize,
    /// Side of the basis PSFs, pixels; odd.
    pub window: usize,
    /// Rows and columns of the nodes of the coefficients.
    pub nodes: [usize; 2],
}

impl Feedback {
    /// Checks that the sizes describe an operator.
    ///
    /// # Errors
    /// [`TrainError::Config`] with the name of the field that does not.
    pub fn check(&self) -> Result<(), TrainError> {
        let wrong = |field, expected: &str, found: usize| {
            Err(TrainError::Config { field, expected: expected.into(), found: found.to_string() })
        };
        if !(1..=MOST_PASSES).contains(&self.passes) {
            return wrong("feedback.passes", "1 to 7", self.passes);
        }
        if self.window.is_multiple_of(2) {
            return wrong("feedback.window", "an odd side", self.window);
        }
        let counts = [
            ("feedback.corners", self.corners.len()),
            ("feedback.terms", self.terms),
            ("feedback.nodes", self.nodes[0].min(self.nodes[1])),
        ];
        match counts.into_iter().find(|(_, n)| *n == 0) {
            Some((field, n)) => wrong(field, "one or more", n),
            None => Ok(()),
        }
    }
}
