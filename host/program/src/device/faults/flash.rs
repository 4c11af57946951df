//! Simulated NOR flash with injected power failures and flipped bits.

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};
use ommatidia_shared::flash::MappedFlash;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::ops::Range;

/// Bytes that are written in one step, without error correction.
const WORD: usize = 4;
/// Bytes of a word with error correction, as on the STM32H7: written in one step.
pub(super) const ECC_WORD: usize = 32;
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
    /// The step reports an error although it was done, and the power stays on.
    Reported(u64),
    /// The step reports an error, some of its bits have changed, and the power stays on.
    Failed(u64),
}

/// Flash with a fault.
#[derive(Debug)]
pub(super) struct FaultyFlash<'m> {
    memory: &'m mut [u8],
    /// For flash with error correction: which words cannot be read.
    unreadable: Option<&'m mut [bool]>,
    fault: Fault,
    rng: ChaCha8Rng,
    /// Steps so far.
    pub steps: u64,
    /// The power has failed.
    pub dead: bool,
}

impl<'m> FaultyFlash<'m> {
    /// What `memory` holds is what the flash holds; `rng` says which bits of a torn step happen. With `unreadable`, one
    /// entry for each [`ECC_WORD`], the flash has error correction: a torn word cannot be read until its sector is
    /// erased, and neither can a word that was written twice.
    pub fn new(memory: &'m mut [u8], unreadable: Option<&'m mut [bool]>, fault: Fault, rng: ChaCha8Rng) -> Self {
        Self { memory, unreadable, fault, rng, steps: 0, dead: false }
    }

    /// Records which words a step from `old` leaves unreadable.
    fn correct(&mut self, at: usize, len: usize, torn: bool) {
        let erased = self.memory[at..at + len].iter().all(|byte| *byte == 0xff);
        let Some(unreadable) = &mut self.unreadable else { return };
        for word in &mut unreadable[at / ECC_WORD..(at + len).div_ceil(ECC_WORD)] {
            // One torn word in eight has so few wrong bits that it can be read.
            *word = if torn { self.rng.random_range(0..8) > 0 } else { *word || !erased };
        }
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
        let torn = matches!(self.fault, Fault::Torn(n) | Fault::Failed(n) if now(n));
        if new.len() == SECTOR && !torn {
            // An erased word is without errors.
            self.memory[at..at + new.len()].fill(0xff);
            let words = at / ECC_WORD..(at + new.len()) / ECC_WORD;
            self.unreadable.iter_mut().for_each(|unreadable| unreadable[words.clone()].fill(false));
        } else {
            self.correct(at, new.len(), torn);
        }
        let memory = &mut self.memory[at..at + new.len()];
        match self.fault {
            Fault::Torn(n) | Fault::Failed(n) if now(n) => {
                for (old, new) in memory.iter_mut().zip(new) {
                    // Each bit that was to change has changed, or not.
                    *old ^= (*old ^ new) & self.rng.random::<u8>();
                }
                self.dead = matches!(self.fault, Fault::Torn(_));
                return Err(NorFlashErrorKind::Other);
            }
            Fault::Flip(n) if now(n) => {
                memory.copy_from_slice(new);
                memory[self.rng.random_range(0..new.len())] ^= 1 << self.rng.random_range(0..8);
            }
            _ => memory.copy_from_slice(new),
        }
        let reported = matches!(self.fault, Fault::Reported(n) if now(n));
        if reported { Err(NorFlashErrorKind::Other) } else { Ok(()) }
    }
}

impl ErrorType for FaultyFlash<'_> {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for FaultyFlash<'_> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        check_read(&self, offset, bytes.len())?;
        let range = offset as usize..offset as usize + bytes.len();
        bytes.copy_from_slice(self.view(range).ok_or(NorFlashErrorKind::Other)?);
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
        let len = if self.unreadable.is_some() { ECC_WORD } else { WORD };
        for (i, word) in bytes.chunks(len).enumerate() {
            let at = offset as usize + i * len;
            let mut new = [0; ECC_WORD];
            for ((new, old), bits) in new.iter_mut().zip(&self.memory[at..]).zip(word) {
                *new = old & bits;
            }
            self.step(at, &new[..word.len()])?;
        }
        Ok(())
    }
}

impl MappedFlash for FaultyFlash<'_> {
    fn view(&self, range: Range<usize>) -> Option<&[u8]> {
        let words = range.start / ECC_WORD..range.end.div_ceil(ECC_WORD);
        let bad = self
            .unreadable
            .as_ref()
            .is_some_and(|unreadable| unreadable.get(words).is_none_or(|words| words.contains(&true)));
        if bad { None } else { self.memory.get(range) }
    }
}
