//! What is lost of the recordings of a session: frames and files that are missing, files that are short, times that run
//! backwards.

use super::{Finding, Severity};
use ommatidia_session::Session;

/// One warning for each loss that `import` or the recording itself names. Damaged frames have findings of their own.
pub fn losses(session: &Session) -> Vec<Finding> {
    let of_stack = |stack: &ommatidia_session::Stack| stack.losses().warnings(&stack.path());
    let texts = session.stacks().iter().flat_map(of_stack);
    texts.map(|text| Finding::new("recording", Severity::Warning, text)).collect()
}
