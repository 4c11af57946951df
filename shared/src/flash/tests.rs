//! Slots in memory: committed files are found after a start, others are not. The host's `device::faults` tests power
//! failures.

#![allow(clippy::unwrap_used)]

extern crate std;

use super::mapped::UNIT;
use super::*;
use crate::device::IoError;
use core::ops::Range;
use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use proptest::prelude::*;
use std::vec;
use std::vec::Vec;

/// Room for 8,192 bytes in each slot.
const FLASH: usize = (2 * 3 + 2) * RAM_SECTOR;

fn fill(slots: &mut Slots<RamFlash<'_>>, file: &[u8], piece: usize) -> Result<(), IoError> {
    slots.begin(file.len())?;
    let mut at = 0;
    for piece in file.chunks(piece) {
        slots.write(at, piece)?;
        at += piece.len();
    }
    slots.finish()
}

/// The file that a start finds.
fn found(memory: &mut [u8]) -> Option<(Slot, u32, Vec<u8>)> {
    let slots = Slots::new(RamFlash::new(memory));
    let newest = slots.committed().into_iter().flatten();
    newest.filter_map(|(slot, mark)| Some((slot, mark.generation, slots.file(slot, &mark)?.to_vec()))).next()
}

proptest! {
    #[test]
    fn what_is_committed_is_found_after_a_start(
        files in prop::collection::vec(prop::collection::vec(any::<u8>(), 4..8192), 1..4),
        piece in 1usize..3000, noise: u8,
    ) {
        let mut memory = vec![noise; FLASH];
        for (i, file) in files.iter().enumerate() {
            let mut slots = Slots::new(RamFlash::new(&mut memory));
            if let Some((slot, mark)) = slots.committed()[0] {
                slots.activate(slot, mark);
            }
            fill(&mut slots, file, piece).unwrap();
            prop_assert_eq!(slots.staged_file().unwrap(), file.as_slice());
            slots.commit().unwrap();
            prop_assert_eq!(slots.active_file().unwrap(), file.as_slice());
            let slot = Slot::ALL[i % 2];
            prop_assert_eq!(found(&mut memory), Some((slot, i as u32 + 1, file.clone())));
        }
    }

    #[test]
    fn memory_of_any_content_holds_no_file_and_takes_one(memory in prop::collection::vec(any::<u8>(), 0..FLASH)) {
        let mut memory = memory;
        prop_assert_eq!(found(&mut memory), None);
        let mut slots = Slots::new(RamFlash::new(&mut memory));
        let fits = slots.capacity() >= 100;
        prop_assert_eq!(fill(&mut slots, &[7; 100], 9).is_ok(), fits);
    }
}

#[test]
fn an_unfinished_file_is_not_found_and_the_old_one_is() {
    let mut memory = vec![0; FLASH];
    let mut slots = Slots::new(RamFlash::new(&mut memory));
    fill(&mut slots, &[1; 500], 100).unwrap();
    slots.commit().unwrap();
    fill(&mut slots, &[2; 500], 100).unwrap();
    assert_eq!(found(&mut memory), Some((Slot::A, 1, vec![1; 500])));
}

#[test]
fn one_flipped_bit_of_a_mark_costs_nothing_and_one_of_a_file_costs_the_file() {
    let mut memory = vec![0; FLASH];
    for byte in 1..3 {
        let mut slots = Slots::new(RamFlash::new(&mut memory));
        if let Some((slot, mark)) = slots.committed()[0] {
            slots.activate(slot, mark);
        }
        fill(&mut slots, &[byte; 500], 100).unwrap();
        slots.commit().unwrap();
    }
    let mark = 3 * RAM_SECTOR;
    for bit in 0..8 * 2 * UNIT {
        memory[mark + bit / 8] ^= 1 << (bit % 8);
        assert_eq!(found(&mut memory), Some((Slot::B, 2, vec![2; 500])), "bit {bit}");
        memory[mark + bit / 8] ^= 1 << (bit % 8);
    }
    // Bits before the last four bytes are seen by the network file's own checksum.
    for bit in 8 * 496..8 * 500 {
        memory[mark + RAM_SECTOR + bit / 8] ^= 1 << (bit % 8);
        assert_eq!(found(&mut memory), Some((Slot::A, 1, vec![1; 500])), "bit {bit}");
        memory[mark + RAM_SECTOR + bit / 8] ^= 1 << (bit % 8);
    }
}

/// As after starts that ended in faults.
#[test]
fn where_no_slot_is_active_the_newest_file_is_kept() {
    let mut memory = vec![0; FLASH];
    for byte in 1..5 {
        let newest = found(&mut memory);
        let mut slots = Slots::new(RamFlash::new(&mut memory));
        // Begun and not committed: what was newest is found again.
        fill(&mut slots, &[0; 500], 100).unwrap();
        assert_eq!(found(&mut memory), newest);
        let mut slots = Slots::new(RamFlash::new(&mut memory));
        fill(&mut slots, &[byte; 500], 100).unwrap();
        slots.commit().unwrap();
        let slot = Slot::ALL[usize::from(byte + 1) % 2];
        assert_eq!(found(&mut memory), Some((slot, byte.into(), vec![byte; 500])));
    }
}

/// Memory whose writes report errors, from the n-th on; `keeps`: although they are done.
struct Reporting<'m> {
    flash: RamFlash<'m>,
    writes_left: u32,
    keeps: bool,
}

impl ErrorType for Reporting<'_> {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Reporting<'_> {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        self.flash.read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        self.flash.capacity()
    }
}

impl NorFlash for Reporting<'_> {
    const WRITE_SIZE: usize = RamFlash::WRITE_SIZE;
    const ERASE_SIZE: usize = RamFlash::ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        self.flash.erase(from, to)
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        let fails = self.writes_left == 0;
        self.writes_left = self.writes_left.saturating_sub(1);
        if !fails || self.keeps {
            self.flash.write(offset, bytes)?;
        }
        if fails { Err(NorFlashErrorKind::Other) } else { Ok(()) }
    }
}

impl MappedFlash for Reporting<'_> {
    fn view(&self, range: Range<usize>) -> Option<&[u8]> {
        self.flash.view(range)
    }
}

#[test]
fn a_commit_that_is_refused_stays_refused_and_one_that_is_not_is_found() {
    // The file is whole: the writes that report errors are those of both copies of its mark, or of the second one.
    let file = [1; 500];
    for (copies, keeps) in [(0, false), (0, true), (1, false), (1, true)] {
        let mut memory = vec![0; FLASH];
        let flash = RamFlash::new(&mut memory);
        let writes_left = file.len().div_ceil(UNIT) as u32 + copies;
        let mut slots = Slots::new(Reporting { flash, writes_left, keeps });
        slots.begin(file.len()).unwrap();
        slots.write(0, &file).unwrap();
        slots.finish().unwrap();
        let committed = slots.commit().is_ok();
        assert_eq!(committed, copies > 0 || keeps, "one copy of the mark is enough");
        assert_eq!(found(&mut memory).is_some(), committed, "{copies} {keeps}");
    }
}

#[test]
fn generations_may_wrap() {
    let mark = |generation| Mark { generation, len: 4, crc: 0 };
    assert!(mark(0).is_newer_than(&mark(u32::MAX)));
    assert!(!mark(u32::MAX).is_newer_than(&mark(0)));
    assert!(!mark(5).is_newer_than(&mark(5)));
}

#[test]
fn bytes_that_do_not_follow_are_refused_and_nothing_is_committed() {
    let mut memory = vec![0; FLASH];
    let mut slots = Slots::new(RamFlash::new(&mut memory));
    assert_eq!(slots.write(0, &[1]), Err(IoError::Failed));
    slots.begin(10).unwrap();
    assert!(slots.write(1, &[1]).is_err());
    slots.begin(10).unwrap();
    assert!(slots.write(0, &[1; 11]).is_err());
    slots.begin(10).unwrap();
    slots.write(0, &[1; 9]).unwrap();
    assert_eq!(slots.finish(), Err(IoError::Failed));
    assert_eq!(slots.commit(), Err(IoError::Failed));
    let available = slots.capacity();
    assert_eq!(slots.begin(available + 1), Err(IoError::NoRoom { needed: available + 1, available }));
    assert_eq!(found(&mut memory), None);
}
