//! Simulated NOR flash with injected power failures and flipped bits.

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};
use ommatidia_shared::flash::MappedFlash;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Bytes that are written in one step.
const WORD: usize = 4;
/// Bytes that are erased in one step.
pub(super) const SECTOR: usize = 4096;

/// A fault of the flash, at a step. Steps are words written and sectors erased.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fault {
    /// Nothing.
    None,
    /// The power fails before the step.
    Cut(u64),
    /// The power fails within the step: some bits of the word are written, or some bits of the sector are erased.
    Torn(u64),
    /// A word is written with one wrong bit, and no error is reported.
    Flip(u64),
}

/// Flash with a fault.
#[derive(Debug)]
pub(super) struct FaultyFlash<'m> {
    memory: &'m mut [u8],
    fault: Fault,
    rng: ChaCha8Rng,
    /// Steps so far.
    pub steps: u64,
    /// The power has failed.
    pub dead: bool,
}

impl<'m> FaultyFlash<'m> {
    /// What `memory` holds is what the flash holds; `rng` says which bits of a torn step happen.
    pub fn new(memory: &'m mut [u8], fault: Fault, rng: ChaCha8Rng) -> Self {
        Self { memory, fault, rng, steps: 0, dead: false }
    }

    /// Takes a step from `old` to `new`.
    fn step(&mut self, at: usize, new: &[u8]) -> Result<(), NorFlashErrorKind> {
        let step = self.steps;
        self.steps += 1;
        let now = |n: u64| n == step;
        self.dead |= matches!(self.fault, Fault::Cut(n) if now(n));
        if self.dead {
            return Err(NorFlashErrorKind::Other);
        }
        let memory = &mut self.memory[at..at + new.len()];
        match self.fault {
            Fault::Torn(n) if now(n) => {
                for (old, new) in memory.iter_mut().zip(new) {
                    // Each bit that was to change has changed, or not.
                    *old ^= (*old ^ new) & self.rng.random::<u8>();
                }
                self.dead = true;
                return Err(NorFlashErrorKind::Other);
            }
            Fault::Flip(n) if now(n) => {
                memory.copy_from_slice(new);
                memory[self.rng.random_range(0..new.len())] ^= 1 << self.rng.random_range(0..8);
            }
            _ => memory.copy_from_slice(new),
        }
        Ok(())
    }
}

impl ErrorType for FaultyFlash<'_> {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for FaultyFlash<'_> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        check_read(&self, offset, bytes.len())?;
        bytes.copy_from_slice(&self.memory[offset as usize..][..bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.memory.len()
    }
}

impl NorFlash for FaultyFlash<'_> {
    const WRITE_SIZE: usize = WORD;
    const ERASE_SIZE: usize = SECTOR;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        check_erase(&self, from, to)?;
        (from as usize..to as usize).step_by(SECTOR).try_for_each(|at| self.step(at, &[0xff; SECTOR]))
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        check_write(&self, offset, bytes.len())?;
        for (i, word) in bytes.chunks(WORD).enumerate() {
            let at = offset as usize + i * WORD;
            let mut new = [0; WORD];
            for ((new, old), bits) in new.iter_mut().zip(&self.memory[at..]).zip(word) {
                *new = old & bits;
            }
            self.step(at, &new[..word.len()])?;
        }
        Ok(())
    }
}

impl MappedFlash for FaultyFlash<'_> {
    fn mapped(&self) -> &[u8] {
        self.memory
    }
}
