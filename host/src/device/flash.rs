//! Uploads a network into the flash of a device.

use super::client::Client;
use super::error::DeviceError;
use super::runtime::Runtime;
use super::transport::Transport;
use crate::network_file::NetworkFile;
use ommatidia_shared::blob::BlobError;
use ommatidia_shared::wire::{Info, Refusal, SlotReport, Telemetry};
use std::path::Path;
use std::time::{Duration, Instant};

/// How often an upload is tried after the line or the flash failed.
const ATTEMPTS: u32 = 3;

/// Result of an upload.
#[derive(Clone, Debug)]
pub struct FlashReport {
    /// Board, as the device reports it.
    pub board: String,
    /// The slot of the network, and its commit mark.
    pub slot: SlotReport,
    /// Number of uploads; 0 if the network was in the flash already.
    pub attempts: u32,
    /// Wall time.
    pub took: Duration,
    /// Telemetry of the device afterwards.
    pub telemetry: Telemetry,
}

/// Sends a network to the inactive slot of the device, commits it, and checks that it runs. The flash of an emulated
/// device is the file `state`. `progress` is called with the share that has arrived, 0 to 1.
///
/// # Errors
/// The device cannot be started, refuses the network, or stops answering in every attempt. It then runs its old
/// network.
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

/// As [`flash`], over an open connection.
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

/// Whether the device runs this network, judged by the length and the checksum of its file.
pub(super) fn runs(telemetry: &Telemetry, blob: &NetworkFile) -> bool {
    let file = blob.bytes();
    let crc = file.last_chunk().map(|crc| u32::from_le_bytes(*crc));
    active(telemetry).is_some_and(|slot| slot.mark.len as usize == file.len() && Some(slot.mark.crc) == crc)
}

fn active(telemetry: &Telemetry) -> Option<SlotReport> {
    telemetry.slots.into_iter().flatten().find(|slot| slot.runs)
}
