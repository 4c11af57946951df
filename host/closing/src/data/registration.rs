//! Registration of the truths: which of them were placed together, and how well.

use ommatidia_session::Stack;

/// Truths that share one registration, because the camera that took them was not moved between them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Registration {
    /// Index of their stack in the session.
    pub stack: usize,
    /// Index of the only frame in its stack; None: all frames of the stack.
    pub frame: Option<usize>,
    /// Standard deviation of their place, as the session states it, object pixels; 0: exact.
    pub sigma_px: f64,
}

impl Registration {
    /// Whether the truth of a frame is among them.
    pub(crate) fn holds(&self, stack: usize, frame: usize) -> bool {
        self.stack == stack && self.frame.is_none_or(|own| own == frame)
    }
}

/// The registrations of a stack, of which the frames `read` are used; none where it has no truths.
pub(super) fn of_stack(stack: &Stack, index: usize, read: &[usize]) -> Vec<Registration> {
    let entry = stack.entry();
    let one = |frame| Registration { stack: index, frame, sigma_px: entry.truth_registration_px };
    match (entry.truth.is_some(), entry.truth_registration_per_frame) {
        (false, _) => Vec::new(),
        (true, false) => vec![one(None)],
        (true, true) => read.iter().map(|frame| one(Some(*frame))).collect(),
    }
}
