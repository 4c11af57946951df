//! What runs the device's program, and the choice of it.

use super::{DeviceError, Firmware, LoopbackConfig, find_qemu};
use std::path::Path;

/// What runs the device's program.
#[derive(Clone, Debug)]
pub enum Runtime {
    /// QEMU runs the firmware.
    Qemu(Firmware),
    /// This process runs the firmware's logic.
    Host(LoopbackConfig),
}

/// What the user wants it to run on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wanted {
    /// QEMU, or an error.
    Qemu,
    /// This process.
    Host,
    /// QEMU where it and the firmware can be had, else this process.
    Best,
}

impl Runtime {
    /// What was wanted, and why it is not QEMU where that was only the second choice. Builds the firmware unless `image` names it.
    ///
    /// # Errors
    /// QEMU or the firmware was asked for and is not there, or the firmware does not build.
    pub fn choose(wanted: Wanted, image: Option<&Path>) -> Result<(Self, Option<String>), DeviceError> {
        let here = Self::Host(LoopbackConfig::default());
        if wanted == Wanted::Host {
            return Ok((here, None));
        }
        let found = match find_qemu() {
            None => Err(DeviceError::NoQemu),
            Some(_) => image.map_or_else(|| Firmware::build("app"), Firmware::given),
        };
        match found {
            Ok(firmware) => Ok((Self::Qemu(firmware), None)),
            Err(why @ (DeviceError::NoQemu | DeviceError::NoFirmware { .. }))
                if wanted == Wanted::Best && image.is_none() =>
            {
                Ok((here, Some(why.to_string())))
            }
            Err(why) => Err(why),
        }
    }
}
