//! Flash that the core reads in place, and its two operations.

use crate::device::IoError;
use core::ops::Range;
use embedded_storage::nor_flash::NorFlash;

/// Bytes that are written at once: a multiple of the write size of every flash.
pub(super) const UNIT: usize = 32;

/// NOR flash that the core reads in place. It begins at an address that is a multiple of [`crate::blob::ALIGN`].
///
/// Flash with error correction (ECC) may hold words that cannot be read: one that was torn when the power failed has
/// more wrong bits than can be corrected, and reading it is a fault of the bus. So every read of the slots goes through
/// [`Self::view`], which looks first.
pub trait MappedFlash: NorFlash {
    /// The bytes at offsets `range`, in place. `None` where it reaches beyond the flash, or where a word in it cannot
    /// be read. Never faults.
    fn view(&self, range: Range<usize>) -> Option<&[u8]>;
}

impl<F: MappedFlash> MappedFlash for &mut F {
    fn view(&self, range: Range<usize>) -> Option<&[u8]> {
        (**self).view(range)
    }
}

pub(super) fn erase<F: MappedFlash>(flash: &mut F, range: Range<usize>) -> Result<(), IoError> {
    flash.erase(address(range.start)?, address(range.end)?).map_err(|_| IoError::Failed)
}

pub(super) fn write<F: MappedFlash>(flash: &mut F, at: usize, unit: &[u8; UNIT]) -> Result<(), IoError> {
    flash.write(address(at)?, unit).map_err(|_| IoError::Failed)
}

fn address(at: usize) -> Result<u32, IoError> {
    u32::try_from(at).map_err(|_| IoError::Failed)
}
