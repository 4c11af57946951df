//! Fault injection: power cuts, flipped bits, bad lines, killed boards. The results are the table in `docs/faults.md`.
//!
//! All faults except those of emulated boards are deterministic: they happen at a step of the flash or at a byte of the
//! line, not at a time.

mod bits;
mod board;
mod flash;
mod line;
mod page;
mod power;
mod tally;
mod test_device;

pub use page::{START, complaints, page, table};
pub use tally::Row;

use super::error::DeviceError;
use super::firmware::Firmware;

/// Injects all faults that need no board.
///
/// # Errors
/// A valid network was refused.
pub fn try_here() -> Result<Vec<Row>, DeviceError> {
    let mut rows = vec![power::cut_uploads(false, false)?, power::cut_uploads(true, false)?];
    rows.extend([power::cut_uploads(true, true)?, power::cut_after_faults()?]);
    rows.extend([power::cut_twice(false)?, power::cut_twice(true)?, power::starts()?]);
    rows.extend(bits::bit_rot()?);
    rows.push(bits::spoilt_words()?);
    rows.extend([bits::flipped_writes()?, bits::reported_errors()?, bits::bad_networks()?]);
    rows.extend(line::lines()?);
    Ok(rows)
}

/// Injects the faults that need emulated boards: each of `apps` is killed during uploads, each of `watchdogs`
/// hangs, and each of `faults` reads what cannot be read.
///
/// # Errors
/// QEMU is missing, or a board fails otherwise.
pub fn try_boards(apps: &[Firmware], watchdogs: &[Firmware], faults: &[Firmware]) -> Result<Vec<Row>, DeviceError> {
    Ok(vec![board::killed(apps)?, board::hung(watchdogs)?, board::faulting(faults)?])
}
