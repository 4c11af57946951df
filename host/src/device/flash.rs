//! A network into the flash of a device, and how the device is.

use super::{Client, DeviceError, Runtime, Transport};
use crate::network_file::NetworkFile;
use ommatidia_shared::blob::BlobError;
use ommatidia_shared::wire::{Info, Refusal, SlotReport, Telemetry};
use std::path::Path;
use std::time::{Duration, Instant};

/// How often an upload is begun anew after the line or the flash failed.
const ATTEMPTS: u32 = 3;

/// What became of a network file.
#[derive(Clone, Debug)]
pub struct FlashReport {
    /// Board that the device says it is.
    pub board: String,
    /// The slot that the file is in, and its mark.
    pub slot: SlotReport,
    /// Uploads that it took; 0 where the file was there already.
    pub attempts: u32,
    /// Wall time.
    pub took: Duration,
    /// Figures of the device afterwards.
    pub telemetry: Telemetry,
}

/// Sends a network to the slot of the device that does not run, has it checked and committed, and asks whether it runs.
///
/// # Errors
/// The device cannot be started, refuses the network, or falls silent again and again. It then runs what it ran before.
pub fn flash(
    runtime: &Runtime,
    state: Option<&Path>,
    blob: &NetworkFile,
    progress: &mut dyn FnMut(f64),
) -> Result<FlashReport, DeviceError> {
    let (mut client, info) = Client::connect(runtime.start(None, state)?)?;
    let report = upload(&mut client, &info, blob, progress)?;
    client.quit().wait()?;
    Ok(report)
}

/// The same over a line that is open.
///
/// # Errors
/// As [`flash`].
pub fn upload<T: Transport>(
    client: &mut Client<T>,
    info: &Info,
    blob: &NetworkFile,
    progress: &mut dyn FnMut(f64),
) -> Result<FlashReport, DeviceError> {
    let start = Instant::now();
    let mut attempts = 0;
    loop {
        let telemetry = client.telemetry()?;
        if let Some(slot) = active(&telemetry).filter(|_| runs(&telemetry, blob)) {
            return Ok(FlashReport {
                board: info.board.as_str().into(),
                slot,
                attempts,
                took: start.elapsed(),
                telemetry,
            });
        }
        if attempts == ATTEMPTS {
            return Err(DeviceError::NotCommitted { found: active(&telemetry) });
        }
        attempts += 1;
        let total = blob.bytes().len() as f64;
        match client.send_blob(blob.bytes(), &mut |bytes| progress(bytes as f64 / total)) {
            Err(DeviceError::Silent { .. }) if attempts < ATTEMPTS => client.hello().map(|_| ())?,
            // A network that is damaged in the flash was whole in memory: written again, it may be whole there too.
            Err(DeviceError::Refused(Refusal::Storage | Refusal::Blob(BlobError::Crc { .. })))
                if attempts < ATTEMPTS => {}
            other => other?,
        }
    }
}

/// Who the device is, and its figures.
///
/// # Errors
/// The device cannot be started or falls silent.
pub fn status(runtime: &Runtime, state: Option<&Path>) -> Result<(Info, Telemetry), DeviceError> {
    let (mut client, info) = Client::connect(runtime.start(None, state)?)?;
    let telemetry = client.telemetry()?;
    client.quit().wait()?;
    Ok((info, telemetry))
}

/// Whether a network is what the device runs: the length and the checksum of its file are.
pub(super) fn runs(telemetry: &Telemetry, blob: &NetworkFile) -> bool {
    let file = blob.bytes();
    let crc = file.last_chunk().map(|crc| u32::from_le_bytes(*crc));
    active(telemetry).is_some_and(|slot| slot.mark.len as usize == file.len() && Some(slot.mark.crc) == crc)
}

fn active(telemetry: &Telemetry) -> Option<SlotReport> {
    telemetry.slots.into_iter().flatten().find(|slot| slot.runs)
}
