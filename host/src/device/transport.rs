//! A line to a device.

use super::DeviceError;
use ommatidia_shared::wire::CHUNK;
use std::time::Duration;

/// A line of bytes to a device. It may lose, repeat and damage them.
pub trait Transport {
    /// Sends bytes.
    ///
    /// # Errors
    /// The line is gone.
    fn send(&mut self, bytes: &[u8]) -> Result<(), DeviceError>;

    /// Waits for bytes, at most for `patience`; gives how many came, 0 for none.
    ///
    /// # Errors
    /// The line is gone.
    fn receive(&mut self, buffer: &mut [u8], patience: Duration) -> Result<usize, DeviceError>;

    /// Whether nothing can come before something is sent. Where there is a clock on the other side nobody knows.
    fn silent(&self) -> bool {
        false
    }

    /// Whether the program ends with the conversation. A board's goes on.
    fn ends(&self) -> bool {
        true
    }

    /// The most bytes of data in one answer that the line carries without losing some.
    fn answer_len(&self) -> usize {
        CHUNK
    }
}
