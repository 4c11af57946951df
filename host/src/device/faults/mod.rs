//! Faults put in on purpose, and what became of networks and frames: the table in `docs/faults.md`.
//!
//! All but the emulated board's are the same at every call, bit for bit: steps, not time, say when what happens.

mod bits;
mod board;
mod desk;
mod flash;
mod line;
mod page;
mod power;

pub use page::{complaints, page, table};

use super::{DeviceError, Firmware};
use serde::Serialize;

/// What became of one kind of fault.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Row {
    /// What happens.
    pub fault: String,
    /// How it was tried.
    pub how: String,
    /// How often.
    pub tried: u64,
    /// How often the device or the host saw it.
    pub seen: u64,
    /// Networks that were lost: none runs, or not the one whose commit was acknowledged.
    pub blobs_lost: u64,
    /// Frames that could not be reconstructed afterwards.
    pub frames_lost: u64,
    /// Reconstructions that differ from this machine's in any bit.
    pub wrong: u64,
}

/// Counts of one kind of fault.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    tried: u64,
    seen: u64,
    blobs_lost: u64,
    frames_lost: u64,
    wrong: u64,
}

impl Tally {
    fn try_one(&mut self, seen: bool) {
        self.tried += 1;
        self.seen += u64::from(seen);
    }

    fn add(&mut self, other: Self) {
        self.blobs_lost += other.blobs_lost;
        self.frames_lost += other.frames_lost;
        self.wrong += other.wrong;
    }

    fn row(self, fault: &str, how: &str) -> Row {
        let Self { tried, seen, blobs_lost, frames_lost, wrong } = self;
        Row { fault: fault.into(), how: how.into(), tried, seen, blobs_lost, frames_lost, wrong }
    }
}

/// Tries all faults that need no board.
///
/// # Errors
/// A network that is sound was refused.
pub fn try_here() -> Result<Vec<Row>, DeviceError> {
    let mut rows =
        vec![power::cut_uploads(false)?, power::cut_uploads(true)?, power::cut_twice()?, power::cut_starts()?];
    rows.extend(bits::rot()?);
    rows.extend([bits::flipped_writes()?, bits::bad_networks()?]);
    rows.extend(line::lines()?);
    Ok(rows)
}

/// Tries what only emulated boards have: each of `apps` is killed within uploads, each of `watchdogs` hangs.
///
/// # Errors
/// QEMU is missing.
pub fn try_boards(apps: &[Firmware], watchdogs: &[Firmware]) -> Result<Vec<Row>, DeviceError> {
    Ok(vec![board::killed(apps)?, board::hung(watchdogs)?])
}
