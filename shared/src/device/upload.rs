//! Bytes that arrive in order, some of them more than once.

use crate::wire::{Refusal, Transfer};

/// A transfer from the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Upload {
    what: Transfer,
    len: u32,
    received: u32,
}

impl Upload {
    /// None has begun.
    pub fn none(what: Transfer) -> Self {
        Self { what, len: 0, received: 0 }
    }

    /// One of `len` bytes begins.
    pub fn begin(&mut self, len: u32) {
        *self = Self { what: self.what, len, received: 0 };
    }

    /// What is new of the bytes at `offset`: how many of them to skip. Bytes that have arrived before are skipped.
    ///
    /// # Errors
    /// [`Refusal::OutOfOrder`] after a gap, [`Refusal::PastEnd`].
    pub fn accept(&self, offset: u32, data: &[u8]) -> Result<usize, Refusal> {
        let end = u64::from(offset) + data.len() as u64;
        if end > u64::from(self.len) {
            return Err(Refusal::PastEnd { len: self.len, found: end });
        }
        if offset > self.received {
            return Err(Refusal::OutOfOrder { expected: self.received, found: offset });
        }
        Ok(((self.received - offset) as usize).min(data.len()))
    }

    /// `count` more bytes have been stored.
    pub fn advance(&mut self, count: usize) {
        self.received += count as u32;
    }

    /// Where the next bytes belong.
    pub fn received(&self) -> u32 {
        self.received
    }

    /// The length of the transfer.
    ///
    /// # Errors
    /// [`Refusal::Incomplete`].
    pub fn complete(&self) -> Result<u32, Refusal> {
        if self.len > 0 && self.received == self.len {
            return Ok(self.len);
        }
        Err(Refusal::Incomplete { what: self.what, expected: self.len, found: self.received })
    }
}
