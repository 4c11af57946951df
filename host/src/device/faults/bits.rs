//! Bits flip in the flash, and networks that are none arrive.

use super::desk::{Desk, FLASH, Network, reconstructs, telemetry, upload};
use super::flash::{Fault, SECTOR};
use super::power::with;
use super::{Row, Tally};
use crate::device::DeviceError;
use ommatidia_shared::wire::Refusal;

/// Each bit of the newer network, of its mark, flips while the power is off.
pub(super) fn rot() -> Result<[Row; 2], DeviceError> {
    let (old, new) = (Network::new(1)?, Network::new(2)?);
    let mut desk = with(&old);
    desk.life(Fault::None, 0, |device| upload(device, new.blob.bytes())).map_err(DeviceError::Refused)?;
    let after = desk.save();
    // The third network of a device lies in its first slot.
    let file = 8 * SECTOR..8 * (SECTOR + new.blob.bytes().len());
    let mut marks = Tally::default();
    for bit in 0..8 * 64 {
        let (runs, refused) = rotten(&mut desk, &after, bit, &new, true);
        marks.try_one(refused > 0);
        marks.blobs_lost += u64::from(!runs);
    }
    let mut files = Tally::default();
    for (i, bit) in file.enumerate() {
        // A reconstruction for every bit would take minutes.
        let (runs, refused) = rotten(&mut desk, &after, bit, &old, i % 16 == 0);
        files.try_one(refused == 1);
        files.blobs_lost += u64::from(!runs);
    }
    Ok([
        marks.row("a bit of the mark flips at rest", "every bit of both copies; the other copy serves"),
        files.row("a bit of the network flips at rest", "every bit; the older network runs, and `device status` tells"),
    ])
}

/// Whether `expected` runs after a bit has flipped, and how many slots were refused.
fn rotten(desk: &mut Desk, flash: &[u128], bit: usize, expected: &Network, reconstruct: bool) -> (bool, u8) {
    debug_assert!(bit < 8 * FLASH);
    desk.restore(flash);
    desk.flip(bit);
    desk.life(Fault::None, 0, |device| {
        let telemetry = telemetry(device);
        let named = expected.blob.network().is_ok_and(|network| network.header().name == telemetry.network);
        (named && (!reconstruct || reconstructs(device, expected)), telemetry.refused_slots)
    })
}

/// A bit flips as a word is written: at every word of an upload.
pub(super) fn flipped_writes() -> Result<Row, DeviceError> {
    let (old, new) = (Network::new(1)?, Network::new(2)?);
    let (mut desk, mut tally) = (with(&old), Tally::default());
    let before = desk.save();
    desk.life(Fault::None, 0, |device| upload(device, new.blob.bytes())).map_err(DeviceError::Refused)?;
    for step in 0..desk.steps {
        desk.restore(&before);
        let (runs, seen) = desk.life(Fault::Flip(step), step, |device| {
            let seen = upload(device, new.blob.bytes()).is_err();
            (reconstructs(device, if seen { &old } else { &new }), seen)
        });
        tally.try_one(seen);
        tally.blobs_lost += u64::from(!runs);
        let again =
            desk.life(Fault::None, 0, |device| upload(device, new.blob.bytes()).is_ok() && reconstructs(device, &new));
        tally.frames_lost += u64::from(!again);
    }
    Ok(tally.row(
        "a bit flips as it is written",
        "every step; what is not seen hit one copy of the mark, the count of starts, or bits that are written anyway",
    ))
}

/// Networks that are none: each is refused by name, and the old one runs on.
pub(super) fn bad_networks() -> Result<Row, DeviceError> {
    let (old, new) = (Network::new(1)?, Network::new(2)?);
    let (mut desk, mut tally) = (with(&old), Tally::default());
    let good = new.blob.bytes();
    let mut bad: Vec<Vec<u8>> = (0..good.len()).map(|len| good[..len].to_vec()).collect();
    bad.extend((0..good.len()).map(|at| {
        let mut bytes = good.to_vec();
        bytes[at] ^= 1 << (at % 8);
        bytes
    }));
    bad.push(vec![0; FLASH]);
    bad.push([good, &[0]].concat());
    for (i, bytes) in bad.iter().enumerate() {
        let (refused, runs) = desk.life(Fault::None, 0, |device| {
            let refused = matches!(
                upload(device, bytes),
                Err(Refusal::Blob(_) | Refusal::NoRoom { .. } | Refusal::Incomplete { .. } | Refusal::Pipeline(_))
            );
            (refused, i % 16 != 0 || reconstructs(device, &old))
        });
        let named = desk.life(Fault::None, 0, |device| telemetry(device).network);
        let kept = old.blob.network().is_ok_and(|network| network.header().name == named);
        tally.try_one(refused);
        tally.blobs_lost += u64::from(!runs || !kept);
    }
    Ok(tally.row(
        "a network that is none arrives",
        "cut at every length, every byte with a flipped bit, too long, too large",
    ))
}
