//! The camera of a device.

use super::client::Client;
use super::error::DeviceError;
use super::runtime::Runtime;
use ommatidia_shared::wire::{CameraChange, CameraStatus, Info};
use std::path::Path;

/// Changes settings of the device's camera; with none to change, only asks. Returns the settings in force.
///
/// # Errors
/// The device cannot be started, has no camera, refuses a setting, or stops answering.
pub fn camera(
    runtime: &Runtime,
    state: Option<&Path>,
    change: CameraChange,
) -> Result<(Info, CameraStatus), DeviceError> {
    let (mut client, info) = Client::connect(runtime.start(None, state)?)?;
    if !info.live {
        return Err(DeviceError::NoCamera { board: runtime.place().board(&info.board) });
    }
    let status = client.camera(change)?;
    client.quit().wait()?;
    Ok((info, status))
}
