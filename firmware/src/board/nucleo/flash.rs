//! The sectors of the internal flash that hold network files. They are read in place.
#![allow(unsafe_code)] // flash is memory

use super::memory::flash_range;
use embassy_stm32::Peri;
use embassy_stm32::flash::{Blocking, Error, FLASH_BASE, Flash, MAX_ERASE_SIZE, WRITE_SIZE};
use embassy_stm32::peripherals::FLASH;
use embedded_storage::nor_flash::{self, NorFlash, ReadNorFlash};
use ommatidia_shared::flash::MappedFlash;

/// All sectors without that of the program: fifteen of 128 KB, for files of up to 640 KB.
pub struct InternalFlash(Flash<'static, Blocking>);

impl InternalFlash {
    pub(super) fn new(flash: Peri<'static, FLASH>) -> Self {
        Self(Flash::new_blocking(flash))
    }

    /// Converts an offset in these sectors to one in the whole flash.
    fn offset(&self, at: u32) -> Result<u32, Error> {
        let first = flash_range().start.addr() - FLASH_BASE;
        u32::try_from(first).ok().and_then(|first| first.checked_add(at)).ok_or(Error::Size)
    }
}

impl nor_flash::ErrorType for InternalFlash {
    type Error = Error;
}

impl ReadNorFlash for InternalFlash {
    const READ_SIZE: usize = 1;

    fn read(&mut self, at: u32, bytes: &mut [u8]) -> Result<(), Error> {
        let at = self.offset(at)?;
        self.0.blocking_read(at, bytes)
    }

    fn capacity(&self) -> usize {
        self.mapped().len()
    }
}

impl NorFlash for InternalFlash {
    const WRITE_SIZE: usize = WRITE_SIZE;
    const ERASE_SIZE: usize = MAX_ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Error> {
        let (from, to) = (self.offset(from)?, self.offset(to)?);
        self.0.blocking_erase(from, to)
    }

    fn write(&mut self, at: u32, bytes: &[u8]) -> Result<(), Error> {
        let at = self.offset(at)?;
        self.0.blocking_write(at, bytes)
    }
}

impl MappedFlash for InternalFlash {
    fn mapped(&self) -> &[u8] {
        let core::ops::Range { start, end } = flash_range();
        // SAFETY: the memory map puts nothing else in these sectors, and they change through `&mut self` only.
        unsafe { core::slice::from_raw_parts(start, end.addr() - start.addr()) }
    }
}
