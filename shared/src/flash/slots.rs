//! The two slots.

use super::mapped::{MappedFlash, UNIT, erase, write};
use super::mark::{Mark, Slot};
use crate::device::IoError;

/// Two slots for network files in a flash.
#[derive(Debug)]
pub struct Slots<F> {
    flash: F,
    active: Option<Active>,
    staged: Option<Staged>,
}

/// The active file: the network that runs.
#[derive(Clone, Copy, Debug)]
struct Active {
    slot: Slot,
    mark: Mark,
}

/// A file that is being written.
#[derive(Clone, Copy, Debug)]
struct Staged {
    slot: Slot,
    len: usize,
    /// Bytes received.
    received: usize,
    /// Of these, bytes written to the flash. The others are in `unit`.
    written: usize,
    unit: [u8; UNIT],
}

impl<F: MappedFlash> Slots<F> {
    const SECTOR: usize = {
        assert!(UNIT.is_multiple_of(F::WRITE_SIZE), "a unit must hold whole words of the flash");
        assert!(F::ERASE_SIZE.is_multiple_of(2 * UNIT), "a sector must hold two marks, and files must be aligned");
        F::ERASE_SIZE
    };

    /// The slots of a flash, none of them active.
    pub fn new(flash: F) -> Self {
        Self { flash, active: None, staged: None }
    }

    /// Largest network file that fits, bytes.
    pub fn capacity(&self) -> usize {
        self.slot_len().saturating_sub(Self::SECTOR)
    }

    /// The slots that have a mark, with their marks, the newest first.
    pub fn committed(&self) -> [Option<(Slot, Mark)>; 2] {
        let [a, b] = Slot::ALL.map(|slot| self.mark(slot).map(|mark| (slot, mark)));
        match (&a, &b) {
            (Some((_, old)), Some((_, new))) if new.is_newer_than(old) => [b, a],
            (None, _) => [b, a],
            _ => [a, b],
        }
    }

    /// The file with this mark; `None` where length or checksum differ from those in the mark.
    pub fn file(&self, slot: Slot, mark: &Mark) -> Option<&[u8]> {
        let file = self.data(slot, mark.len as usize)?;
        (Mark::of(file, mark.generation)? == *mark).then_some(file)
    }

    /// Makes a committed file the active one.
    pub fn activate(&mut self, slot: Slot, mark: Mark) {
        self.active = Some(Active { slot, mark });
    }

    /// The active slot and its mark.
    pub fn active(&self) -> Option<(Slot, Mark)> {
        self.active.map(|Active { slot, mark }| (slot, mark))
    }

    /// The active file: the network that runs.
    pub fn active_file(&self) -> Option<&[u8]> {
        let Active { slot, mark } = self.active?;
        self.data(slot, mark.len as usize)
    }

    /// Prepares a slot for a file of `len` bytes: the one that is not active or, where none is, the one without the
    /// newest file. Its old file is lost; the other slot is not touched.
    ///
    /// # Errors
    /// [`IoError::NoRoom`] where it does not fit, [`IoError::Failed`] where the flash failed.
    pub fn begin(&mut self, len: usize) -> Result<(), IoError> {
        self.staged = None;
        let available = self.capacity();
        if len > available {
            return Err(IoError::NoRoom { needed: len, available });
        }
        // After starts that ended in faults none is active, and the newest committed file is still the one to keep.
        let [newest, _] = self.committed();
        let kept = self.active().or(newest);
        let slot = kept.map_or(Slot::A, |(slot, _)| slot.other());
        // Without its mark the content of the slot is no committed file any more.
        self.erase_sector(self.start(slot))?;
        if self.mark(slot).is_some() {
            return Err(IoError::Failed);
        }
        self.staged = Some(Staged { slot, len, received: 0, written: 0, unit: [0xff; UNIT] });
        Ok(())
    }

    /// Writes the next bytes of the file, which belong at `offset`. After an error the file must be begun again.
    ///
    /// # Errors
    /// [`IoError::NoRoom`] where they go past the announced length or are not the next ones, [`IoError::Failed`] where
    /// no file was begun or the flash failed.
    pub fn write(&mut self, offset: usize, bytes: &[u8]) -> Result<(), IoError> {
        let mut staged = self.staged.take().ok_or(IoError::Failed)?;
        let needed = offset.saturating_add(bytes.len());
        if offset != staged.received || needed > staged.len {
            return Err(IoError::NoRoom { needed, available: staged.len });
        }
        let mut rest = bytes;
        while !rest.is_empty() {
            let space = staged.unit.get_mut(staged.received % UNIT..).unwrap_or_default();
            let (now, later) = rest.split_at(space.len().min(rest.len()));
            space.iter_mut().zip(now).for_each(|(to, from)| *to = *from);
            staged.received += now.len();
            rest = later;
            if staged.received.is_multiple_of(UNIT) {
                self.write_unit(&mut staged)?;
            }
        }
        self.staged = Some(staged);
        Ok(())
    }

    /// Writes the bytes that are left in the buffer. [`Self::staged_file`] is complete then.
    ///
    /// # Errors
    /// [`IoError::Failed`] where no file was begun, bytes are missing, or the flash failed.
    pub fn finish(&mut self) -> Result<(), IoError> {
        let mut staged = self.staged.take().ok_or(IoError::Failed)?;
        if staged.received != staged.len {
            return Err(IoError::Failed);
        }
        if staged.written < staged.received {
            self.write_unit(&mut staged)?;
        }
        self.staged = Some(staged);
        Ok(())
    }

    /// The file that is being written, in place in the flash.
    pub fn staged_file(&self) -> Option<&[u8]> {
        let staged = self.staged.as_ref()?;
        self.data(staged.slot, staged.len)
    }

    /// Writes the mark of the finished file and makes it the active one, now and after the next start.
    ///
    /// # Errors
    /// [`IoError::Failed`] where no file was finished or neither copy of the mark could be written. The file is then
    /// not active, now or later.
    pub fn commit(&mut self) -> Result<(), IoError> {
        let Staged { slot, len, .. } = self.staged.take().ok_or(IoError::Failed)?;
        let newest = self.committed()[0].map_or(0, |(_, mark)| mark.generation);
        let file = self.data(slot, len).ok_or(IoError::Failed)?;
        let mark = Mark::of(file, newest.wrapping_add(1)).ok_or(IoError::Failed)?;
        let at = self.start(slot);
        for copy in 0..2 {
            // What a start will read decides, and not what the flash says of the step.
            let _ = write(&mut self.flash, at + copy * UNIT, &mark.encode());
        }
        if self.mark(slot) != Some(mark) {
            self.erase_sector(at)?;
            return Err(IoError::Failed);
        }
        self.activate(slot, mark);
        Ok(())
    }

    /// Size of a slot with the sector of its mark, bytes.
    fn slot_len(&self) -> usize {
        (self.flash.capacity() / Self::SECTOR).saturating_sub(2) / 2 * Self::SECTOR
    }

    fn start(&self, slot: Slot) -> usize {
        match slot {
            Slot::A => 0,
            Slot::B => self.slot_len(),
        }
    }

    /// The first `len` bytes of the file of a slot.
    fn data(&self, slot: Slot, len: usize) -> Option<&[u8]> {
        if len > self.capacity() {
            return None;
        }
        let at = self.start(slot) + Self::SECTOR;
        self.flash.view(at..at + len)
    }

    /// The mark of a slot. Either copy is enough, so one flipped bit does no harm.
    fn mark(&self, slot: Slot) -> Option<Mark> {
        if self.capacity() == 0 {
            return None;
        }
        let at = self.start(slot);
        let copy = |at: usize| Mark::decode(self.flash.view(at..at + UNIT)?);
        copy(at).or_else(|| copy(at + UNIT))
    }

    /// Writes the buffer, which ends at the last byte received. A sector is erased before its first byte is written.
    fn write_unit(&mut self, staged: &mut Staged) -> Result<(), IoError> {
        let at = self.start(staged.slot) + Self::SECTOR + staged.written;
        if at.is_multiple_of(Self::SECTOR) {
            self.erase_sector(at)?;
        }
        write(&mut self.flash, at, &staged.unit)?;
        staged.written = staged.received;
        staged.unit = [0xff; UNIT];
        Ok(())
    }

    fn erase_sector(&mut self, at: usize) -> Result<(), IoError> {
        erase(&mut self.flash, at..at + Self::SECTOR)
    }
}
