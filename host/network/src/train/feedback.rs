//! The shape of feedback: passes that compare what was found before them with the frame.

use super::TrainError;
use serde::{Deserialize, Serialize};

/// Largest number of passes after the first one.
const MOST_PASSES: usize = 7;
/// Largest number of Richardson-Lucy iterations.
const MOST_ITERATIONS: usize = 100;

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
    /// Number of accelerated Richardson-Lucy iterations with the same model ahead of the first pass, which then
    /// corrects what they find as a later pass corrects what a pass finds; 0: the first pass takes the frame alone.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub iterations: usize,
    /// Frame pixel of object pixel (0, 0) behind each living lens.
    pub corners: Vec<[i32; 2]>,
    /// Number of terms of each lens.
    pub terms: usize,
    /// Side of the basis PSFs, pixels; odd.
    pub window: usize,
    /// Rows and columns of the nodes of the coefficients.
    pub nodes: [usize; 2],
}

/// Networks without iterations are written as before there were any.
fn is_zero(n: &usize) -> bool {
    *n == 0
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
        if self.iterations > MOST_ITERATIONS {
            return wrong("feedback.iterations", "at most 100", self.iterations);
        }
        if self.passes > MOST_PASSES || self.passes + self.iterations == 0 {
            return wrong("feedback.passes", "1 to 7, or 0 after Richardson-Lucy iterations", self.passes);
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
