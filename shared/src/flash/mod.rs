//! Network files in flash: two slots, each with a commit mark, and a count of the starts.
//!
//! The flash of [`Slots`] is any NOR flash with the traits of `embedded-storage` that the core can read in place ([`MappedFlash`]):
//!
//! | sectors | what |
//! |---|---|
//! | 1 | mark of slot A, written twice |
//! | n | network file of slot A |
//! | 1 + n | the same of slot B |
//! | 2 | starts counted, one sector at a time |
//!
//! A new file goes to the slot that does not run. Its old mark is erased first, its new mark written last, after every bit of the
//! file was checked where it lies: whenever the power goes, one slot holds a whole file and a mark that says so. What a mark says of
//! the file (length, checksum) is compared before a byte of it is used, and the file is decoded in full; where it fails, the other
//! slot runs.

mod mapped;
mod mark;
mod ram;
mod slots;
mod starts;

pub use mapped::MappedFlash;
pub use mark::{Mark, Slot};
pub use ram::{RAM_SECTOR, RamFlash};
pub use slots::Slots;

#[cfg(test)]
mod tests;
