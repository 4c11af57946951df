//! Power failures at every step of the flash.

use super::flash::Fault;
use super::tally::{Row, Tally};
use super::test_device::{Network, TestDevice, reconstructs, telemetry, upload};
use crate::device::error::DeviceError;
use ommatidia_session::rng;
use rand::RngExt;

/// Trials in which the power fails twice, at two random steps.
const TWICE: u64 = 2000;

/// Interrupts an upload at every step; `torn`: within the step; `ecc`: a torn word cannot be read.
pub(super) fn cut_uploads(torn: bool, ecc: bool) -> Result<Row, DeviceError> {
    let (old, new) = (Network::new(1)?, Network::new(2)?);
    let (mut device, mut tally) = (with(&old, ecc), Tally::default());
    let before = device.save();
    device.power_on(Fault::None, 0, |dut| upload(dut, new.blob.bytes())).map_err(DeviceError::Refused)?;
    for step in 0..device.steps {
        device.restore(&before);
        let fault = if torn { Fault::Torn(step) } else { Fault::Cut(step) };
        let committed = device.power_on(fault, step, |dut| upload(dut, new.blob.bytes()).is_ok());
        tally.try_one(device.cut);
        tally.add(survives(&mut device, &old, &new, committed));
    }
    let fault = match (torn, ecc) {
        (false, _) => "power fails before a step of an upload",
        (true, false) => "power fails within a step of an upload",
        (true, true) => "the same, flash with error correction",
    };
    let how = "every word that it writes and every sector that it erases";
    let how =
        if ecc { format!("{how}; words of 32 bytes, seven torn words in eight cannot be read") } else { how.into() };
    Ok(tally.row(fault, &how))
}

/// Interrupts an upload after starts that ended in faults: no network runs then, and the newest one must be kept.
pub(super) fn cut_after_faults() -> Result<Row, DeviceError> {
    let [older, newest, new] = [Network::new(1)?, Network::new(2)?, Network::new(3)?];
    let mut tally = Tally::default();
    let mut once = TestDevice::new(false);
    once.power_on(Fault::None, 0, |dut| upload(dut, older.blob.bytes())).map_err(DeviceError::Refused)?;
    // The next network lies in the first slot of the one device, and in the second of the other.
    for mut device in [with(&older, false), once] {
        device.power_on(Fault::None, 0, |dut| upload(dut, newest.blob.bytes())).map_err(DeviceError::Refused)?;
        let before = device.save();
        device.faulting = true;
        device.power_on(Fault::None, 0, |dut| upload(dut, new.blob.bytes())).map_err(DeviceError::Refused)?;
        for step in 0..device.steps {
            device.restore(&before);
            device.faulting = true;
            let committed = device.power_on(Fault::Torn(step), step, |dut| upload(dut, new.blob.bytes()).is_ok());
            tally.try_one(device.cut);
            device.faulting = false;
            tally.add(survives(&mut device, &newest, &new, committed));
        }
    }
    Ok(tally.row(
        "power fails within a step of an upload after three starts that ended in faults",
        "every word that it writes and every sector that it erases, with the newest network in either slot",
    ))
}

/// Interrupts an upload, and then the next start or the second upload.
pub(super) fn cut_twice(ecc: bool) -> Result<Row, DeviceError> {
    let (old, new) = (Network::new(1)?, Network::new(2)?);
    let (mut device, mut tally) = (with(&old, ecc), Tally::default());
    let before = device.save();
    device.power_on(Fault::None, 0, |dut| upload(dut, new.blob.bytes())).map_err(DeviceError::Refused)?;
    let steps = device.steps;
    for seed in 0..TWICE {
        device.restore(&before);
        let mut rng = rng::stream(seed, "cut twice", 0);
        let mut committed = false;
        for _ in 0..2 {
            // Every fourth cut is at the beginning, where the old mark is erased.
            let last = if rng.random_range(0..4) == 0 { 8 } else { steps };
            let fault = Fault::Torn(rng.random_range(0..last));
            committed |= device.power_on(fault, rng.random(), |dut| upload(dut, new.blob.bytes()).is_ok());
        }
        tally.try_one(device.cut);
        tally.add(survives(&mut device, &old, &new, committed));
    }
    let fault =
        if ecc { "the same, flash with error correction" } else { "power fails twice, within steps of uploads" };
    Ok(tally.row(fault, "random steps"))
}

/// Starts without end: none takes a step of the flash, so that the power may fail in any of them.
pub(super) fn starts() -> Result<Row, DeviceError> {
    let network = Network::new(1)?;
    let (mut device, mut tally) = (with(&network, true), Tally::default());
    for step in 0..400 {
        let runs = device.power_on(Fault::Torn(step % 4), step, |dut| telemetry(dut).slots[0].is_some());
        tally.try_one(device.cut);
        tally.blobs_lost += u64::from(!runs || device.steps > 0);
    }
    Ok(tally.row("power fails during a start", "400 starts; a start writes nothing, so nothing can be torn"))
}

/// A device that runs `network`, uploaded twice.
pub(super) fn with(network: &Network, ecc: bool) -> TestDevice {
    let mut device = TestDevice::new(ecc);
    for _ in 0..2 {
        // It cannot be refused; if it were, every trial would fail.
        let _ = device.power_on(Fault::None, 0, |dut| upload(dut, network.blob.bytes()));
    }
    device
}

/// After a start: one of the networks runs, the new one if its commit was acknowledged; and a new upload of it
/// succeeds.
fn survives(device: &mut TestDevice, old: &Network, new: &Network, committed: bool) -> Tally {
    let mut tally = Tally::default();
    let runs = device.power_on(Fault::None, 0, |dut| {
        let runs_new = reconstructs(dut, new);
        if runs_new { Some(true) } else { reconstructs(dut, old).then_some(false) }
    });
    tally.blobs_lost += u64::from(runs.is_none() || (committed && runs == Some(false)));
    let again = device.power_on(Fault::None, 0, |dut| upload(dut, new.blob.bytes()).is_ok() && reconstructs(dut, new));
    tally.frames_lost += u64::from(!again);
    tally
}
