//! Faults of an emulated board: the emulator is killed, the program hangs.

use super::desk::Network;
use super::{Row, Tally};
use crate::device::flash::runs;
use crate::device::qemu::run_to_end;
use crate::device::{Client, DeviceError, Firmware, Qemu, Runtime, flash, run, status, upload};
use std::time::Duration;

const KILLS: u64 = 12;

/// The emulator is killed at some moment of an upload, and started again with the same flash.
pub(super) fn killed(app: &Firmware) -> Result<Row, DeviceError> {
    let (old, new) = (Network::new(1)?, Network::new(2)?);
    let folder = tempfile::tempdir()?;
    let state = folder.path().join("flash");
    let runtime = Runtime::Qemu(app.clone());
    flash(&runtime, Some(&state), &old.blob, &mut |_| {})?;
    let before = std::fs::read(&state)?;
    let mut tally = Tally::default();
    for kill in 0..KILLS {
        std::fs::write(&state, &before)?;
        let (mut client, info) = Client::connect(Qemu::start(app, None, Some(&state))?)?;
        // After so many chunks, and some moment more: the kill falls between, or into, writes.
        let chunks = kill % 3;
        let killer = client.line().killer();
        let mut sent = 0;
        let result = upload(&mut client, &info, &new.blob, &mut |_| {
            sent += 1;
            if sent > chunks {
                let killer = killer.clone();
                let moment = Duration::from_micros(300 * (kill / 3) + 100);
                std::thread::spawn(move || {
                    std::thread::sleep(moment);
                    killer.kill();
                });
            }
        });
        drop(client);
        tally.try_one(true);
        let (_, telemetry) = status(&runtime, Some(&state))?;
        let runs_old = runs(&telemetry, &old.blob);
        let runs_new = runs(&telemetry, &new.blob);
        let kept = runs_new || (runs_old && result.is_err());
        tally.blobs_lost += u64::from(!kept);
        let again = run(&runtime, &new.blob, std::slice::from_ref(&new.frame), Some(&state), &mut |_| {})?;
        tally.wrong += again.differing_bits.min(1);
    }
    Ok(tally.row(
        "the emulated board is killed within an upload",
        "at different moments; started again with the same flash",
    ))
}

/// A program hangs; the watchdog resets the board, and the next start tells why.
pub(super) fn hung(watchdog: &Firmware) -> Result<Row, DeviceError> {
    let printed = run_to_end(watchdog, None)?;
    let mut tally = Tally::default();
    tally.try_one(printed.contains("started by the watchdog"));
    Ok(tally.row("the program hangs", "the watchdog of the emulated board resets it"))
}
