//! Errors of the parts as refusals in messages.

use super::io::IoError;
use crate::pipeline::PipelineError;
use crate::wire::{Refusal, Transfer};
use core::fmt::Write;
use heapless::String;

/// A length in a message.
pub(super) fn saturated(n: usize) -> u32 {
    u32::try_from(n).unwrap_or(u32::MAX)
}

/// The refusal of a buffer, a camera or the flash.
pub(super) fn storage(error: IoError, what: Transfer) -> Refusal {
    match error {
        IoError::NoRoom { needed, available } => {
            Refusal::NoRoom { what, needed: saturated(needed), available: saturated(available) }
        }
        IoError::Failed => Refusal::Storage,
    }
}

/// The text of the pipeline's error, cut to what the message holds.
pub(super) fn refusal(error: PipelineError) -> Refusal {
    struct Cut(String<96>);
    impl Write for Cut {
        fn write_str(&mut self, text: &str) -> core::fmt::Result {
            text.chars().try_for_each(|c| self.0.push(c)).map_err(|_| core::fmt::Error)
        }
    }
    let mut text = Cut(String::new());
    let _cut = write!(text, "{error}");
    Refusal::Pipeline(text.0)
}
