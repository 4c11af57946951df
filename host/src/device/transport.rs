//! The line to a device.

use super::error::DeviceError;
use ommatidia_shared::wire::CHUNK;
use std::time::Duration;

/// A byte stream to a device and back, which may lose, repeat or damage bytes.
pub trait Transport {
    /// Sends bytes.
    ///
    /// # Errors
    /// The connection is closed.
    fn send(&mut self, bytes: &[u8]) -> Result<(), DeviceError>;

    /// Waits for bytes, at most for `patience`; returns how many arrived, 0 for none.
    ///
    /// # Errors
    /// The connection is closed.
    fn receive(&mut self, buffer: &mut [u8], patience: Duration) -> Result<usize, DeviceError>;

    /// Whether no byte can arrive before the next one is sent; only lines without a clock know this.
    fn silent(&self) -> bool {
        false
    }

    /// Whether the program ends when the host quits. On a board it keeps running.
    fn ends(&self) -> bool {
        true
    }

    /// Maximum data bytes in one reply that the line carries without loss.
    fn answer_len(&self) -> usize {
        CHUNK
    }
}
