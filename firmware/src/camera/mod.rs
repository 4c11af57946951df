//! Image sensors over `embedded-hal`.

pub mod mt9v032;
pub mod python480;
pub mod serial_bus;

pub use mt9v032::Mt9v032;
pub use python480::Python480;

use ommatidia_shared::wire::{CameraLimits, CameraSettings, SettingError};

/// The registers of an image sensor. Light and trigger belong to the board.
pub trait ImageSensor {
    /// Name of the sensor.
    const NAME: &'static str;
    /// Errors of its bus.
    type Error;

    /// The nearest settings that the sensor has.
    ///
    /// # Errors
    /// The setting that the sensor cannot have, and its limits.
    fn plan(wanted: CameraSettings) -> Result<CameraSettings, SettingError>;

    /// What the sensor can do, while its other settings are these.
    fn limits(settings: &CameraSettings) -> CameraLimits;

    /// Longest time from the pulse that starts an exposure until it begins, us.
    fn latency_us(settings: &CameraSettings) -> u32 {
        let _ = settings;
        0
    }

    /// Sets the sensor to settings from [`Self::plan`], whatever it was set to.
    ///
    /// # Errors
    /// Those of its bus.
    fn apply(&mut self, settings: &CameraSettings) -> Result<(), Self::Error>;
}
