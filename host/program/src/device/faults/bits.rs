//! Faults of bits: flips in the flash, and invalid network files.

use super::flash::{ECC_WORD, Fault, SECTOR};
use super::power::with;
use super::tally::{Row, Tally};
use super::test_device::{FLASH, Network, Saved, TestDevice, reconstructs, telemetry, upload};
use crate::device::error::DeviceError;
use ommatidia_shared::wire::Refusal;

/// Flips each bit of the newer network, and of its commit mark, while the power is off.
pub(super) fn bit_rot() -> Result<[Row; 2], DeviceError> {
    let (old, new) = (Network::new(1)?, Network::new(2)?);
    let mut device = with(&old, false);
    device.power_on(Fault::None, 0, |dut| upload(dut, new.blob.bytes())).map_err(DeviceError::Refused)?;
    let after = device.save();
    // The third network of a device lies in its first slot.
    let file = 8 * SECTOR..8 * (SECTOR + new.blob.bytes().len());
    let mut marks = Tally::default();
    for bit in 0..8 * 64 {
        let (runs, refused) = after_flip(&mut device, &after, bit, &new, true);
        marks.try_one(refused > 0);
        marks.blobs_lost += u64::from(!runs);
    }
    let mut files = Tally::default();
    for (i, bit) in file.enumerate() {
        // A reconstruction for every bit would take minutes.
        let (runs, refused) = after_flip(&mut device, &after, bit, &old, i % 16 == 0);
        files.try_one(refused == 1);
        files.blobs_lost += u64::from(!runs);
    }
    Ok([
        marks.row(
            "a bit of the commit mark flips while the power is off",
            "every bit of both copies; the other copy \
            is used",
        ),
        files.row(
            "a bit of the network flips while the power is off",
            "every bit; the older network runs, and \
            `device status` reports it",
        ),
    ])
}

/// Makes each word of the newer network, and of its commit mark, unreadable while the power is off. Where the mark or
/// the file cannot be read the older network runs; one copy of the mark is enough.
pub(super) fn spoilt_words() -> Result<Row, DeviceError> {
    let (old, new) = (Network::new(1)?, Network::new(2)?);
    let (mut device, mut tally) = (with(&old, true), Tally::default());
    device.power_on(Fault::None, 0, |dut| upload(dut, new.blob.bytes())).map_err(DeviceError::Refused)?;
    let after = device.save();
    let file = SECTOR / ECC_WORD..(SECTOR + new.blob.bytes().len()).div_ceil(ECC_WORD);
    for word in (0..2).chain(file) {
        device.restore(&after);
        device.spoil(word);
        let expected = if word < 2 { &new } else { &old };
        let (runs, refused) =
            device.power_on(Fault::None, 0, |dut| (reconstructs(dut, expected), telemetry(dut).refused_slots));
        tally.try_one(refused > 0);
        tally.blobs_lost += u64::from(!runs);
        let again =
            device.power_on(Fault::None, 0, |dut| upload(dut, new.blob.bytes()).is_ok() && reconstructs(dut, &new));
        tally.frames_lost += u64::from(!again);
    }
    Ok(tally.row(
        "a word of 32 bytes becomes unreadable while the power is off",
        "every word of the newer network and of its mark; one copy of the mark is enough, otherwise the older \
         network runs",
    ))
}

/// Whether `expected` runs after a bit has flipped, and how many slots were refused.
fn after_flip(device: &mut TestDevice, flash: &Saved, bit: usize, expected: &Network, reconstruct: bool) -> (bool, u8) {
    debug_assert!(bit < 8 * FLASH);
    device.restore(flash);
    device.flip(bit);
    device.power_on(Fault::None, 0, |dut| {
        let telemetry = telemetry(dut);
        let named = expected.blob.network().is_ok_and(|network| network.header().name == telemetry.network);
        (named && (!reconstruct || reconstructs(dut, expected)), telemetry.refused_slots)
    })
}

/// Flips a bit while a word is written, at every step of an upload.
pub(super) fn flipped_writes() -> Result<Row, DeviceError> {
    let (old, new) = (Network::new(1)?, Network::new(2)?);
    let (mut device, mut tally) = (with(&old, false), Tally::default());
    let before = device.save();
    device.power_on(Fault::None, 0, |dut| upload(dut, new.blob.bytes())).map_err(DeviceError::Refused)?;
    for step in 0..device.steps {
        device.restore(&before);
        let (runs, seen) = device.power_on(Fault::Flip(step), step, |dut| {
            let seen = upload(dut, new.blob.bytes()).is_err();
            (reconstructs(dut, if seen { &old } else { &new }), seen)
        });
        tally.try_one(seen);
        tally.blobs_lost += u64::from(!runs);
        let again =
            device.power_on(Fault::None, 0, |dut| upload(dut, new.blob.bytes()).is_ok() && reconstructs(dut, &new));
        tally.frames_lost += u64::from(!again);
    }
    Ok(tally.row(
        "a bit flips while it is written",
        "every step; unseen faults hit one copy of the mark, or bits that are written again",
    ))
}

/// Lets the flash report an error at every step of an upload, while the power stays on. What the device answers to the
/// commit holds now and after the next start.
pub(super) fn reported_errors() -> Result<Row, DeviceError> {
    let (old, new) = (Network::new(1)?, Network::new(2)?);
    let mut tally = Tally::default();
    for ecc in [false, true] {
        let mut device = with(&old, ecc);
        let before = device.save();
        device.power_on(Fault::None, 0, |dut| upload(dut, new.blob.bytes())).map_err(DeviceError::Refused)?;
        for (step, fault) in (0..device.steps).flat_map(|n| [(n, Fault::Reported(n)), (n, Fault::Failed(n))]) {
            device.restore(&before);
            let (runs, seen) = device.power_on(fault, step, |dut| {
                let seen = upload(dut, new.blob.bytes()).is_err();
                (reconstructs(dut, if seen { &old } else { &new }), seen)
            });
            let expected = if seen { &old } else { &new };
            let still = device.power_on(Fault::None, 0, |dut| reconstructs(dut, expected));
            tally.try_one(seen);
            tally.blobs_lost += u64::from(!runs || !still);
            let again =
                device.power_on(Fault::None, 0, |dut| upload(dut, new.blob.bytes()).is_ok() && reconstructs(dut, &new));
            tally.frames_lost += u64::from(!again);
        }
    }
    Ok(tally.row(
        "the flash reports an error, and the power stays on",
        "every step, done or with some of its bits changed, without and with error correction; one copy of the mark is \
         enough",
    ))
}

/// Sends invalid networks: each is refused with its reason, and the old network keeps running.
pub(super) fn bad_networks() -> Result<Row, DeviceError> {
    let (old, new) = (Network::new(1)?, Network::new(2)?);
    let (mut device, mut tally) = (with(&old, false), Tally::default());
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
        let (refused, runs) = device.power_on(Fault::None, 0, |dut| {
            let refused = matches!(
                upload(dut, bytes),
                Err(Refusal::Blob(_) | Refusal::NoRoom { .. } | Refusal::Incomplete { .. } | Refusal::Pipeline(_))
            );
            (refused, i % 16 != 0 || reconstructs(dut, &old))
        });
        let named = device.power_on(Fault::None, 0, |dut| telemetry(dut).network);
        let kept = old.blob.network().is_ok_and(|network| network.header().name == named);
        tally.try_one(refused);
        tally.blobs_lost += u64::from(!runs || !kept);
    }
    Ok(tally.row(
        "an invalid network arrives",
        "truncated at every length, a flipped bit in every byte, too long, too large",
    ))
}
