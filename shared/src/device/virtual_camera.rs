//! A camera without a sensor: for boards under an emulator and for the workstation.

use super::io::{Camera, FrameSource, IoError, RamFrame};
use super::steps::{Steps, check};
use crate::wire::{CameraLimits, CameraSettings, SensorRegion, Setting, SettingError, Trigger};

/// Rows and columns of the pixel array.
const ARRAY: [u16; 2] = [480, 752];
/// Time of one row, in which exposures are counted, us.
const ROW_US: u32 = 20;
/// Time between two pulses at the trigger input, us.
pub const PULSES_US: u64 = 250_000;
/// Dark level, DN.
const BLACK_DN: u64 = 64;
/// Largest code of a pixel, DN.
const LARGEST_DN: u64 = 4095;
const ANALOG_GAIN: Steps = Steps { setting: Setting::AnalogGain, numer: 1000, denom: 16, counts: [16, 64] };
/// The current of the LED has 8 bits.
const LED: Steps = Steps { setting: Setting::Led, numer: 1000, denom: 255, counts: [0, 255] };

/// A camera that shows a moving pattern. Its timing, its limits and its response to exposure, gain and light are those
/// of a sensor with 480 x 752 pixels and rows of 20 us; a pulse comes to its trigger input every 250 ms.
#[derive(Debug)]
pub struct VirtualCamera<'m> {
    frame: RamFrame<'m>,
    /// Whether there is a camera; without one, frames come from the host alone.
    present: bool,
    settings: CameraSettings,
    clock: Clock,
    /// Level of the LED.
    lit_permille: u16,
    /// Level at the start of the exposure.
    exposed_permille: u16,
    /// When the exposure started.
    began_us: Option<u64>,
    /// Number of exposures.
    exposures: u32,
    /// Number of the pulse that was seen last.
    pulse: u64,
}

/// The clock of a virtual camera.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    /// Microseconds since the start.
    pub now_us: fn() -> u64,
    /// Called again and again during waits.
    pub pause: fn(),
}

impl<'m> VirtualCamera<'m> {
    /// A camera whose frames go to `memory`, with `rows` x `cols` pixels at first.
    pub fn new(memory: &'m mut [u16], [rows, cols]: [u16; 2], clock: Clock) -> Self {
        let settings = CameraSettings {
            exposure_us: 10_000,
            analog_gain_thousandths: 1000,
            interval_us: 20_000,
            led_permille: 0,
            region: SensorRegion { row: 0, col: 0, rows, cols, bin: 1 }.centred(ARRAY[0], ARRAY[1]),
            trigger: Trigger::Device,
        };
        Self {
            frame: RamFrame::new(memory),
            present: rows > 0 && cols > 0,
            settings,
            clock,
            lit_permille: 0,
            exposed_permille: 0,
            began_us: None,
            exposures: 0,
            pulse: 0,
        }
    }

    /// The memory of its frames, with whatever it holds.
    pub fn into_memory(self) -> &'m mut [u16] {
        self.frame.into_memory()
    }

    /// Time to read a frame of a region, us.
    fn readout_us(region: SensorRegion) -> u32 {
        u32::from(region.rows) * u32::from(region.bin) * ROW_US
    }

    fn exposure(region: SensorRegion, interval_us: u32) -> Steps {
        let most = interval_us.saturating_sub(Self::readout_us(region)) / ROW_US;
        Steps { setting: Setting::Exposure, numer: ROW_US, denom: 1, counts: [1, most.max(1)] }
    }

    /// The frame and the exposure have to fit.
    fn interval(region: SensorRegion) -> Steps {
        let least = Self::readout_us(region) / ROW_US + 1;
        Steps { setting: Setting::Interval, numer: ROW_US, denom: 1, counts: [least, 1_000_000 / ROW_US] }
    }
}

impl FrameSource for VirtualCamera<'_> {
    fn capacity(&self) -> usize {
        self.frame.capacity()
    }

    fn camera(&mut self) -> Option<&mut dyn Camera> {
        if self.present { Some(self) } else { None }
    }

    fn begin(&mut self, pixels: usize) -> Result<(), IoError> {
        self.frame.begin(pixels)
    }

    fn write(&mut self, offset: usize, bytes: &[u8]) -> Result<(), IoError> {
        self.frame.write(offset, bytes)
    }

    fn frame(&mut self) -> Result<&[u16], IoError> {
        self.frame.frame()
    }
}

impl Camera for VirtualCamera<'_> {
    fn sensor(&self) -> &'static str {
        "virtual"
    }

    fn settings(&self) -> CameraSettings {
        self.settings
    }

    fn limits(&self) -> CameraLimits {
        let CameraSettings { region, interval_us, .. } = self.settings;
        CameraLimits {
            array_rows: ARRAY[0],
            array_cols: ARRAY[1],
            exposure_us: Self::exposure(region, interval_us).limits(),
            analog_gain_thousandths: ANALOG_GAIN.limits(),
            interval_us: Self::interval(region).limits(),
        }
    }

    fn plan(&self, wanted: CameraSettings) -> Result<CameraSettings, SettingError> {
        let region = wanted.region;
        let SensorRegion { row, col, rows, cols, bin } = region;
        if !matches!(bin, 1 | 2 | 4) {
            return Err(SettingError { setting: Setting::Bin, least: 1, most: 4, step: 1, found: bin.into() });
        }
        check(Setting::Rows, rows, [1, ARRAY[0] / bin], 1)?;
        check(Setting::Cols, cols, [1, ARRAY[1] / bin], 1)?;
        check(Setting::Row, row, [0, ARRAY[0] - rows * bin], 1)?;
        check(Setting::Col, col, [0, ARRAY[1] - cols * bin], 1)?;
        let interval_us = Self::interval(region).nearest(wanted.interval_us)?;
        let led_permille = LED.nearest(wanted.led_permille.into())? as u16;
        Ok(CameraSettings {
            exposure_us: Self::exposure(region, interval_us).nearest(wanted.exposure_us)?,
            analog_gain_thousandths: ANALOG_GAIN.nearest(wanted.analog_gain_thousandths)?,
            interval_us,
            led_permille,
            region,
            trigger: wanted.trigger,
        })
    }

    fn apply(&mut self, settings: CameraSettings) -> Result<(), IoError> {
        self.settings = settings;
        Ok(())
    }

    fn now_us(&self) -> u64 {
        (self.clock.now_us)()
    }

    fn light(&mut self, permille: u16) {
        self.lit_permille = permille;
    }

    fn triggered(&mut self) -> bool {
        let pulse = self.now_us() / PULSES_US;
        core::mem::replace(&mut self.pulse, pulse) != pulse
    }

    fn expose(&mut self) -> Result<(), IoError> {
        self.began_us = Some(self.now_us());
        self.exposed_permille = self.lit_permille;
        Ok(())
    }

    fn ready(&mut self) -> Result<bool, IoError> {
        let CameraSettings { exposure_us, region, .. } = self.settings;
        let began = self.began_us.ok_or(IoError::Failed)?;
        let takes_us = u64::from(exposure_us) + u64::from(Self::readout_us(region));
        if self.now_us().saturating_sub(began) < takes_us {
            return Ok(false);
        }
        self.began_us = None;
        let response = Response::of(&self.settings, self.exposed_permille);
        let frame = self.frame.fill(region.pixels())?;
        for (i, code) in frame.iter_mut().enumerate() {
            *code = response.code(self.exposures, i);
        }
        self.exposures = self.exposures.wrapping_add(1);
        Ok(true)
    }

    fn abandon(&mut self) {
        self.began_us = None;
    }

    fn pause(&self) {
        (self.clock.pause)();
    }
}

/// What a virtual camera makes of light.
#[derive(Clone, Copy, Debug)]
pub struct Response(u64);

impl Response {
    /// Ten milliseconds at gain 1 in the dark are the unit. The LED doubles the light at its full current.
    pub fn of(settings: &CameraSettings, led_permille: u16) -> Self {
        let gain = u64::from(settings.analog_gain_thousandths) * (1000 + u64::from(led_permille));
        Self(u64::from(settings.exposure_us) * gain / 10_000)
    }

    /// The code of pixel `i` in exposure `n`, DN.
    pub fn code(self, n: u32, i: usize) -> u16 {
        let pattern = (i as u64 * 7919 + u64::from(n) * 613) % 4000;
        (BLACK_DN + pattern * self.0 / 1_000_000).min(LARGEST_DN) as u16
    }
}
