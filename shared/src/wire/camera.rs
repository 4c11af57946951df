//! What the messages say of a camera: settings, limits, and when each frame was exposed.

use core::fmt;
use heapless::String;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// What starts an exposure.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum Trigger {
    /// The clock of the device, once in each frame interval.
    #[default]
    Device,
    /// A pulse at the trigger input of the board.
    Input,
}

/// The rectangle of the pixel array that is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct SensorRegion {
    /// Its first row of the array.
    pub row: u16,
    /// Its first column of the array.
    pub col: u16,
    /// Rows of the frame.
    pub rows: u16,
    /// Columns of the frame.
    pub cols: u16,
    /// Rows and columns of the array that make one pixel of the frame.
    pub bin: u16,
}

impl SensorRegion {
    /// Pixels of the frame.
    pub const fn pixels(&self) -> usize {
        self.rows as usize * self.cols as usize
    }

    /// The region in the middle of an array of `rows` x `cols` pixels that gives this region's frame.
    pub const fn centred(self, rows: u16, cols: u16) -> Self {
        let row = rows.saturating_sub(self.rows.saturating_mul(self.bin)) / 2;
        let col = cols.saturating_sub(self.cols.saturating_mul(self.bin)) / 2;
        Self { row, col, ..self }
    }
}

/// Settings of a camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct CameraSettings {
    /// Exposure, us.
    pub exposure_us: u32,
    /// Analogue gain relative to the sensor's smallest, in thousandths.
    pub analog_gain_thousandths: u32,
    /// Time from the start of one exposure to the next where the device starts them, us. Starts lie on a grid of this
    /// step; a frame that nobody takes is a gap in it.
    pub interval_us: u32,
    /// Level of the excitation LED during exposures, in thousandths of the full current. It is dark between them.
    pub led_permille: u16,
    /// The pixels that are read.
    pub region: SensorRegion,
    /// What starts exposures.
    pub trigger: Trigger,
}

/// The settings that are to change; the others stay.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct CameraChange {
    /// Exposure, us.
    pub exposure_us: Option<u32>,
    /// Analogue gain, in thousandths.
    pub analog_gain_thousandths: Option<u32>,
    /// Time between the starts of exposures, us.
    pub interval_us: Option<u32>,
    /// Level of the excitation LED, in thousandths.
    pub led_permille: Option<u16>,
    /// The pixels that are read.
    pub region: Option<SensorRegion>,
    /// What starts exposures.
    pub trigger: Option<Trigger>,
}

impl CameraChange {
    /// The change that gives these settings, whatever they are now.
    pub const fn to(settings: CameraSettings) -> Self {
        let CameraSettings { exposure_us, analog_gain_thousandths, interval_us, led_permille, region, trigger } =
            settings;
        Self {
            exposure_us: Some(exposure_us),
            analog_gain_thousandths: Some(analog_gain_thousandths),
            interval_us: Some(interval_us),
            led_permille: Some(led_permille),
            region: Some(region),
            trigger: Some(trigger),
        }
    }

    /// The settings `now`, changed.
    pub fn of(self, now: CameraSettings) -> CameraSettings {
        CameraSettings {
            exposure_us: self.exposure_us.unwrap_or(now.exposure_us),
            analog_gain_thousandths: self.analog_gain_thousandths.unwrap_or(now.analog_gain_thousandths),
            interval_us: self.interval_us.unwrap_or(now.interval_us),
            led_permille: self.led_permille.unwrap_or(now.led_permille),
            region: self.region.unwrap_or(now.region),
            trigger: self.trigger.unwrap_or(now.trigger),
        }
    }
}

/// The least and the largest value that a setting can have.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Limits {
    /// The least.
    pub least: u32,
    /// The largest.
    pub most: u32,
}

/// What a camera can do, while its other settings are those in force.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct CameraLimits {
    /// Rows of the pixel array.
    pub array_rows: u16,
    /// Columns of the pixel array.
    pub array_cols: u16,
    /// Exposure, us.
    pub exposure_us: Limits,
    /// Analogue gain, thousandths.
    pub analog_gain_thousandths: Limits,
    /// Time between the starts of exposures, us.
    pub interval_us: Limits,
}

/// A camera and its settings.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct CameraStatus {
    /// Name of the sensor.
    pub sensor: String<24>,
    /// The settings in force: what the sensor was really set to.
    pub settings: CameraSettings,
    /// What it can do.
    pub limits: CameraLimits,
    /// Clock of the device, us since its start.
    pub now_us: u64,
    /// Frames that the sensor was to expose since the start.
    pub frames: u32,
    /// Of these, frames that the sensor did not deliver.
    pub failed_frames: u32,
    /// Time that the excitation LED was lit since the start, us.
    pub lit_us: u64,
}

/// How a frame of the camera was taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Capture {
    /// Number of its place in the grid of frames. A number that is left out is a frame that was not taken.
    pub number: u32,
    /// When the exposure started, on the clock of the device, us since its start.
    pub start_us: u64,
    /// The settings in force.
    pub settings: CameraSettings,
}

/// A setting of a camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum Setting {
    /// Exposure, us.
    Exposure,
    /// Analogue gain, thousandths.
    AnalogGain,
    /// Time between the starts of exposures, us.
    Interval,
    /// Level of the excitation LED, thousandths.
    Led,
    /// First row of the region.
    Row,
    /// First column of the region.
    Col,
    /// Rows of the region.
    Rows,
    /// Columns of the region.
    Cols,
    /// Pixels of the array in one of the frame, along each axis.
    Bin,
    /// What starts exposures.
    Trigger,
}

/// A setting that the camera cannot have.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct SettingError {
    /// Which.
    pub setting: Setting,
    /// The least that it can be, while the other settings are as asked for.
    pub least: u32,
    /// The largest.
    pub most: u32,
    /// It must be a multiple of this.
    pub step: u32,
    /// What was asked for.
    pub found: u32,
}

impl fmt::Display for SettingError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { setting, least, most, step, found } = *self;
        match setting {
            Setting::Exposure => {
                write!(f, "exposure: {found} us; from {least} to {most} us at this frame interval and region")
            }
            Setting::AnalogGain => {
                write!(f, "analogue gain: {found} thousandths; from {least} to {most} thousandths")
            }
            Setting::Interval => write!(
                f,
                "frame interval: {found} us; from {least} to {most} us with this exposure and region (a slower rate is \
                 one of the host's)"
            ),
            Setting::Led => write!(f, "LED: {found} thousandths; at most {most}"),
            Setting::Trigger => f.write_str("trigger: this board has no trigger input"),
            Setting::Bin => write!(f, "region: {found} pixels to one; 1, 2 or 4, at most {most}"),
            Setting::Row | Setting::Col | Setting::Rows | Setting::Cols => {
                let name = match setting {
                    Setting::Row => "first row",
                    Setting::Col => "first column",
                    Setting::Rows => "rows",
                    _ => "columns",
                };
                write!(f, "region: {name}: {found}; from {least} to {most}")?;
                if step > 1 { write!(f, " in steps of {step}") } else { Ok(()) }
            }
        }
    }
}

impl core::error::Error for SettingError {}
