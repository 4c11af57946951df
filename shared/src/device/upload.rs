//! A transfer whose bytes arrive in order, some of them more than once.

use crate::wire::{Refusal, Transfer};

/// A transfer from the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Upload {
    what: Transfer,
    len: u32,
    received: u32,
}

impl Upload {
    /// No transfer has begun.
    pub fn none(what: Transfer) -> Self {
        Self { what, len: 0, received: 0 }
    }

    /// Begins a transfer of `len` bytes.
    pub fn begin(&mut self, len: u32) {
        *self = Self { what: self.what, len, received: 0 };
    }

    /// Whether a transfer of `len` bytes has begun of which nothing has arrived.
    pub fn has_just_begun(&self, len: u32) -> bool {
        self.len == len && self.received == 0
    }

    /// Number of leading bytes of the `len` that belong at `offset` that have arrived before and are to be skipped.
    ///
    /// # Errors
    /// [`Refusal::OutOfOrder`] where there is a gap before them, [`Refusal::PastEnd`] where they go past the end.
    pub fn accept(&self, offset: u32, len: usize) -> Result<usize, Refusal> {
        let end = u64::from(offset) + len as u64;
        if end > u64::from(self.len) {
            return Err(Refusal::PastEnd { len: self.len, found: end });
        }
        if offset > self.received {
            return Err(Refusal::OutOfOrder { expected: self.received, found: offset });
        }
        Ok(((self.received - offset) as usize).min(len))
    }

    /// Records that `count` more bytes were stored.
    pub fn advance(&mut self, count: usize) {
        self.received += count as u32;
    }

    /// Offset of the next bytes.
    pub fn received(&self) -> u32 {
        self.received
    }

    /// Length of the transfer, bytes.
    ///
    /// # Errors
    /// [`Refusal::Incomplete`] where bytes are missing or none has begun.
    pub fn complete(&self) -> Result<u32, Refusal> {
        if self.len > 0 && self.received == self.len {
            return Ok(self.len);
        }
        Err(Refusal::Incomplete { what: self.what, expected: self.len, found: self.received })
    }
}
