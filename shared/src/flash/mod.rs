//! Network files in flash: two slots, each with a commit mark.
//!
//! The flash of [`Slots`] is any NOR flash with the traits of `embedded-storage` that the core can read in place
//! ([`MappedFlash`]):
//!
//! | sectors | what |
//! |---|---|
//! | 1 | mark of slot A, stored twice |
//! | n | network file of slot A |
//! | 1 + n | the same for slot B |
//! | 2 | unused; earlier versions counted the starts there |
//!
//! A new file goes to the slot that is not active, or, where none is, to the one without the newest file. The old mark
//! of that slot is erased first. The new mark is written last, after every bit of the file was checked in place. So one
//! slot holds a complete file with its mark whenever the power fails. At a start the length and the checksum in the
//! mark are compared with the file, and every bit of the file is checked. Where that fails, the other slot becomes
//! active. A start writes nothing, so that no failure of the power during a start can damage the flash.
//!
//! ```
//! use ommatidia_shared::flash::{RAM_SECTOR, RamFlash, Slot, Slots};
//!
//! let mut memory = vec![0xff; 8 * RAM_SECTOR];
//! let mut slots = Slots::new(RamFlash::new(&mut memory));
//! assert_eq!(slots.capacity(), 2 * RAM_SECTOR, "two slots of three sectors, one of which holds the mark");
//!
//! slots.begin(100).unwrap();
//! slots.write(0, &[7; 60]).unwrap();
//! slots.write(60, &[8; 40]).unwrap();
//! slots.finish().unwrap();
//! slots.commit().unwrap();
//!
//! // After a power failure: the mark leads to the file.
//! let slots = Slots::new(RamFlash::new(&mut memory));
//! let (slot, mark) = slots.committed()[0].unwrap();
//! assert_eq!((slot, mark.generation, mark.len), (Slot::A, 1, 100));
//! assert_eq!(slots.file(slot, &mark).unwrap()[59..61], [7, 8]);
//! ```

mod mapped;
mod mark;
mod ram;
mod slots;

pub use mapped::MappedFlash;
pub use mark::{Mark, Slot};
pub use ram::{RAM_SECTOR, RamFlash};
pub use slots::Slots;

#[cfg(test)]
mod tests;
