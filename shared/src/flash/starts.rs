//! The count of the starts of the device.
//!
//! Each start adds an entry to one of two sectors. When that sector is full, the other one is erased and takes the next
//! entry. So the highest count is never in the sector that is erased.

use super::mapped::{MappedFlash, UNIT, erase, write};
use crate::device::IoError;

/// Adds an entry to the two sectors at `at` and returns the count in it.
pub(super) fn count<F: MappedFlash>(flash: &mut F, at: usize, sector: usize) -> Result<u32, IoError> {
    let end = at + 2 * sector;
    let entries = flash.mapped().get(at..end).ok_or(IoError::Failed)?.as_chunks::<UNIT>().0;
    let newest = entries.iter().enumerate().filter_map(|(i, entry)| Some((decode(entry)?, i))).max();
    let (count, place) = match newest {
        None => (1, None),
        Some((last, i)) => {
            let units = sector / UNIT;
            let half_end = if i < units { units } else { 2 * units };
            // An entry may follow that was being written when the power failed.
            let free = (i + 1..half_end).find(|i| entries.get(*i).is_some_and(|entry| *entry == [0xff; UNIT]));
            let other = at + if i < units { sector } else { 0 };
            (last.saturating_add(1), Some(free.ok_or(other)))
        }
    };
    let place = match place {
        Some(Ok(free)) => at + free * UNIT,
        Some(Err(other)) => {
            erase(flash, other..other + sector)?;
            other
        }
        None => {
            erase(flash, at..end)?;
            at
        }
    };
    write(flash, place, &encode(count))?;
    Ok(count)
}

fn encode(count: u32) -> [u8; UNIT] {
    let mut entry = [0xff; UNIT];
    let fields = count.to_le_bytes().into_iter().chain((!count).to_le_bytes());
    entry.iter_mut().zip(fields).for_each(|(byte, field)| *byte = field);
    entry
}

fn decode(entry: &[u8; UNIT]) -> Option<u32> {
    let (count, rest) = entry.split_first_chunk()?;
    let (count, inverse) = (u32::from_le_bytes(*count), u32::from_le_bytes(*rest.first_chunk()?));
    (count == !inverse).then_some(count)
}
