//! The power goes, at every step that the flash takes.

use super::desk::{Desk, Network, reconstructs, telemetry, upload};
use super::flash::Fault;
use super::{Row, Tally};
use crate::device::DeviceError;
use crate::rng;
use rand::RngExt;

/// How often the power goes twice, at two random steps.
const TWICE: u64 = 2000;

/// An upload is cut off at every step.
pub(super) fn cut_uploads(torn: bool) -> Result<Row, DeviceError> {
    let (old, new) = (Network::new(1)?, Network::new(2)?);
    let (mut desk, mut tally) = (with(&old), Tally::default());
    let before = desk.save();
    desk.life(Fault::None, 0, |device| upload(device, new.blob.bytes())).map_err(DeviceError::Refused)?;
    for step in 0..desk.steps {
        desk.restore(&before);
        let fault = if torn { Fault::Torn(step) } else { Fault::Cut(step) };
        let committed = desk.life(fault, step, |device| upload(device, new.blob.bytes()).is_ok());
        tally.try_one(desk.cut);
        tally.add(survives(&mut desk, &old, &new, committed));
    }
    let fault = if torn { "power goes within a step of an upload" } else { "power goes before a step of an upload" };
    Ok(tally.row(fault, "every word written and every sector erased of it"))
}

/// An upload is cut off, and so is the next life of the device, in its start or in the second upload.
pub(super) fn cut_twice() -> Result<Row, DeviceError> {
    let (old, new) = (Network::new(1)?, Network::new(2)?);
    let (mut desk, mut tally) = (with(&old), Tally::default());
    let before = desk.save();
    desk.life(Fault::None, 0, |device| upload(device, new.blob.bytes())).map_err(DeviceError::Refused)?;
    let steps = desk.steps;
    for seed in 0..TWICE {
        desk.restore(&before);
        let mut rng = rng::stream(seed, "cut twice", 0);
        let mut committed = false;
        for _ in 0..2 {
            // Every fourth cut is in the start itself.
            let last = if rng.random_range(0..4) == 0 { 8 } else { steps };
            let fault = Fault::Torn(rng.random_range(0..last));
            committed |= desk.life(fault, rng.random(), |device| upload(device, new.blob.bytes()).is_ok());
        }
        tally.try_one(desk.cut);
        tally.add(survives(&mut desk, &old, &new, committed));
    }
    Ok(tally.row("power goes twice, within steps of uploads or starts", "random steps"))
}

/// Starts are cut off at every step, over three turns of the sectors that count them; the count never falls back.
pub(super) fn cut_starts() -> Result<Row, DeviceError> {
    let network = Network::new(1)?;
    let (mut desk, mut tally) = (with(&network), Tally::default());
    let mut count = 0;
    for start in 0..400 {
        let before = desk.save();
        desk.life(Fault::None, 0, |_| ());
        for step in 0..desk.steps {
            desk.restore(&before);
            desk.life(Fault::Torn(step), 400 * step + start, |_| ());
            tally.try_one(desk.cut);
            let (starts, runs) =
                desk.life(Fault::None, 0, |device| (telemetry(device).starts, telemetry(device).slots[0].is_some()));
            tally.blobs_lost += u64::from(starts <= count || !runs);
        }
        desk.restore(&before);
        count = desk.life(Fault::None, 0, |device| telemetry(device).starts);
    }
    Ok(tally.row("power goes within a step of a start", "every step of 400 starts"))
}

/// A device that runs `network`, the second that it was given.
pub(super) fn with(network: &Network) -> Desk {
    let mut desk = Desk::new();
    for _ in 0..2 {
        // It cannot be refused; if it were, every trial would tell.
        let _ = desk.life(Fault::None, 0, |device| upload(device, network.blob.bytes()));
    }
    desk
}

/// After a start: one of the networks runs, the new one if its commit was acknowledged; and a new upload of it succeeds.
fn survives(desk: &mut Desk, old: &Network, new: &Network, committed: bool) -> Tally {
    let mut tally = Tally::default();
    let runs = desk.life(Fault::None, 0, |device| {
        let runs_new = reconstructs(device, new);
        if runs_new { Some(true) } else { reconstructs(device, old).then_some(false) }
    });
    tally.blobs_lost += u64::from(runs.is_none() || (committed && runs == Some(false)));
    let again =
        desk.life(Fault::None, 0, |device| upload(device, new.blob.bytes()).is_ok() && reconstructs(device, new));
    tally.frames_lost += u64::from(!again);
    tally
}
