//! The sectors of the internal flash that hold network files. They are read in place.
#![allow(unsafe_code)] // flash is memory

use super::cache;
use super::memory::flash_range;
use crate::board::masked;
use core::ops::Range;
use embassy_stm32::Peri;
use embassy_stm32::flash::{Blocking, Error, FLASH_BASE, Flash, MAX_ERASE_SIZE, WRITE_SIZE};
use embassy_stm32::pac;
use embassy_stm32::peripherals::FLASH;
use embedded_storage::nor_flash::{self, NorFlash, ReadNorFlash};
use ommatidia_shared::flash::MappedFlash;

/// All sectors without those of the program: fourteen of 128 KB, for files of up to 640 KB.
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
        let Range { start, end } = flash_range();
        end.addr() - start.addr()
    }
}

impl NorFlash for InternalFlash {
    const WRITE_SIZE: usize = WRITE_SIZE;
    const ERASE_SIZE: usize = MAX_ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Error> {
        let (from, to) = (self.offset(from)?, self.offset(to)?);
        clear_flags();
        let done = outcome(self.0.blocking_erase(from, to));
        cache::forget(FLASH_BASE + from as usize..FLASH_BASE + to as usize);
        done
    }

    fn write(&mut self, at: u32, bytes: &[u8]) -> Result<(), Error> {
        let at = self.offset(at)?;
        clear_flags();
        let done = outcome(self.0.blocking_write(at, bytes));
        cache::forget(FLASH_BASE + at as usize..FLASH_BASE + at as usize + bytes.len());
        done
    }
}

/// Clears the flags of both banks. They stay until they are cleared, through CCR (ST RM0433, section 4.9.6): the driver
/// takes each of them for an error of its step, one bit that was corrected in a read long ago included.
fn clear_flags() {
    for bank in [0, 1] {
        pac::FLASH.bank(bank).ccr().write(|w| {
            w.set_clr_eop(true);
            w.set_clr_wrperr(true);
            w.set_clr_pgserr(true);
            w.set_clr_strberr(true);
            w.set_clr_incerr(true);
            w.set_clr_operr(true);
            w.set_clr_rdperr(true);
            w.set_clr_rdserr(true);
            w.set_clr_sneccerr(true);
            w.set_clr_dbeccerr(true);
            w.set_clr_crcrderr(true);
        });
    }
}

/// The outcome of a step. A bit that was corrected meanwhile, anywhere in the bank, is no error of a step that was
/// finished: no byte of it waits in the buffer.
fn outcome(done: Result<(), Error>) -> Result<(), Error> {
    let finished = [0, 1].into_iter().all(|bank| {
        let status = pac::FLASH.bank(bank).sr().read();
        !(status.operr() || status.dbeccerr() || status.wbne())
    });
    if finished && done == Err(Error::Prog) { Ok(()) } else { done }
}

impl MappedFlash for InternalFlash {
    /// Reads one number of every word of 256 bits first: of a word with more wrong bits than its error correction can
    /// correct, reading is a fault (ST RM0433, section 4.3.9).
    fn view(&self, range: Range<usize>) -> Option<&[u8]> {
        let Range { start, end } = flash_range();
        let len = end.addr() - start.addr();
        if range.start > range.end || range.end > len {
            return None;
        }
        // SAFETY: the memory map puts nothing else in these sectors, and they change through `&mut self` only.
        let all = unsafe { core::slice::from_raw_parts(start, len) };
        let first = range.start / WRITE_SIZE * WRITE_SIZE;
        let readable = (first..range.end).step_by(WRITE_SIZE).all(|word| {
            // SAFETY: a word of flash, whose reading has no effect.
            unsafe { masked::readable(start.wrapping_add(word).cast()) }
        });
        // The controller reports errors that reach the core otherwise as well, and a driver takes the flag for its own.
        let failed = [0, 1].map(|bank| {
            let failed = pac::FLASH.bank(bank).sr().read().dbeccerr();
            pac::FLASH.bank(bank).ccr().write(|w| w.set_clr_dbeccerr(true));
            failed
        });
        if readable && failed == [false; 2] { all.get(range) } else { None }
    }
}
