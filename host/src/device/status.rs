//! Status of a device.

use super::client::Client;
use super::error::DeviceError;
use super::runtime::Runtime;
use ommatidia_shared::wire::{Info, Telemetry};
use std::path::Path;

/// Identity and telemetry of the device.
///
/// # Errors
/// The device cannot be started or stops answering.
pub fn status(runtime: &Runtime, state: Option<&Path>) -> Result<(Info, Telemetry), DeviceError> {
    let (mut client, info) = Client::connect(runtime.start(None, state)?)?;
    let telemetry = client.telemetry()?;
    client.quit().wait()?;
    Ok((info, telemetry))
}

/// Share of the time since the start that the core was awake, 0 to 1; `None` on boards without a clock.
pub fn active_fraction(telemetry: &Telemetry) -> Option<f64> {
    let activity = telemetry.activity.filter(|activity| activity.total_ms > 0)?;
    Some(1.0 - f64::from(activity.asleep_ms) / f64::from(activity.total_ms))
}
