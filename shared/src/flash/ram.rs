//! Memory that behaves like NOR flash: for boards whose flash is emulated, and for the workstation.

use super::mapped::MappedFlash;
use core::ops::Range;
use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};

/// Size of a sector of [`RamFlash`], which is erased at once, bytes.
pub const RAM_SECTOR: usize = 4096;

/// Memory with the rules of NOR flash: a sector is erased to ones, a word is written by clearing bits.
#[derive(Debug)]
pub struct RamFlash<'m> {
    memory: &'m mut [u8],
}

impl<'m> RamFlash<'m> {
    /// A flash with the content of `memory`.
    pub fn new(memory: &'m mut [u8]) -> Self {
        Self { memory }
    }

    /// The memory.
    pub fn into_memory(self) -> &'m mut [u8] {
        self.memory
    }
}

impl ErrorType for RamFlash<'_> {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for RamFlash<'_> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        check_read(&self, offset, bytes.len())?;
        let from = self.memory.get(offset as usize..).unwrap_or_default();
        bytes.iter_mut().zip(from).for_each(|(to, from)| *to = *from);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.memory.len()
    }
}

impl NorFlash for RamFlash<'_> {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = RAM_SECTOR;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        check_erase(&self, from, to)?;
        self.memory.get_mut(from as usize..to as usize).ok_or(NorFlashErrorKind::OutOfBounds)?.fill(0xff);
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        check_write(&self, offset, bytes.len())?;
        let to = self.memory.get_mut(offset as usize..).unwrap_or_default();
        to.iter_mut().zip(bytes).for_each(|(to, from)| *to &= *from);
        Ok(())
    }
}

impl MappedFlash for RamFlash<'_> {
    fn view(&self, range: Range<usize>) -> Option<&[u8]> {
        self.memory.get(range)
    }
}
