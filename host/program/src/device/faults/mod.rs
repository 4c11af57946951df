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
    let mut rows =
        vec![power::cut_uploads(false)?, power::cut_uploads(true)?, power::cut_twice()?, power::cut_starts()?];
    rows.extend(bits::bit_rot()?);
    rows.extend([bits::flipped_writes()?, bits::bad_networks()?]);
    rows.extend(line::lines()?);
    Ok(rows)
}

/// Injects the faults that need emulated boards: each of `apps` is killed during uploads, and each of `watchdogs`
/// hangs.
///
/// # Errors
/// QEMU is missing, or a board fails otherwise.
pub fn try_boards(apps: &[Firmware], watchdogs: &[Firmware]) -> Result<Vec<Row>, DeviceError> {
    Ok(vec![board::killed(apps)?, board::hung(watchdogs)?])
}
