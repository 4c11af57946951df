//! Faults of an emulated board: the emulator is killed, or the program hangs.

use super::tally::{Row, Tally};
use super::test_device::Network;
use crate::device::client::Client;
use crate::device::error::DeviceError;
use crate::device::firmware::Firmware;
use crate::device::flash::runs;
use crate::device::flash::{flash, upload};
use crate::device::qemu::Qemu;
use crate::device::qemu::run_to_end;
use crate::device::run::run;
use crate::device::runtime::Runtime;
use crate::device::status::status;
use std::fs::File;
use std::io::Read;
use std::time::Duration;

const KILLS: u64 = 12;
/// More than the flash of any emulated board.
const FLASH_BYTES: u64 = 8 << 20;

/// Kills the emulator during an upload and restarts it with the same flash.
pub(super) fn killed(apps: &[Firmware]) -> Result<Row, DeviceError> {
    let mut tally = Tally::default();
    for app in apps {
        kill_uploads(app, &mut tally)?;
    }
    Ok(tally.row(
        "an emulated board is killed during an upload",
        "12 times on each of the three, at different moments; restarted with the same flash",
    ))
}

fn kill_uploads(app: &Firmware, tally: &mut Tally) -> Result<(), DeviceError> {
    let (old, new) = (Network::new(1)?, Network::new(2)?);
    let folder = tempfile::tempdir()?;
    let state = folder.path().join("flash");
    let runtime = Runtime::Qemu(app.clone());
    flash(&runtime, Some(&state), &old.blob, &mut |_| {})?;
    // The flash is the first part of the board's memory; what stands behind it in the file may be large, and is
    // scratch.
    let mut before = Vec::new();
    File::open(&state)?.take(FLASH_BYTES).read_to_end(&mut before)?;
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
        let again = run(&runtime, &new.blob, std::slice::from_ref(&new.frame).into(), Some(&state), &mut |_| {})?;
        tally.wrong += again.differing_bits.min(1);
    }
    Ok(())
}

/// Lets a program hang: the watchdog resets the board, and the next start reports the reason.
pub(super) fn hung(watchdogs: &[Firmware]) -> Result<Row, DeviceError> {
    let mut tally = Tally::default();
    for watchdog in watchdogs {
        tally.try_one(run_to_end(watchdog, None)?.contains("started by the watchdog"));
    }
    Ok(tally.row("the program hangs", "once on each of the three; the watchdog of the emulated board resets it"))
}

/// Lets a program meet a fault of the bus: first where it expects one, then where it does not; and a stack too deep.
/// After three starts that ended so the fourth finds that they keep doing it.
pub(super) fn faulting(images: &[Firmware]) -> Result<Row, DeviceError> {
    let mut tally = Tally::default();
    for image in images {
        let output = run_to_end(image, None)?;
        let expected = [
            "memory can be read: true",
            "nothing can be read: false",
            "start 3 by Fault",
            "start 4 by Fault",
            "keeps faulting",
        ];
        let seen = expected.iter().all(|line| output.contains(line));
        let seen = seen && ["read 0", "depth"].iter().all(|line| !output.contains(line));
        tally.try_one(seen);
        // A board that does not start again has lost its network.
        tally.blobs_lost += u64::from(!seen);
    }
    Ok(tally.row(
        "a word cannot be read, or the stack is too deep, and the program faults",
        "once on each of the three: a read that may fail says so, two other ones and a stack too deep reset the board, \
         the fourth start runs no network",
    ))
}
