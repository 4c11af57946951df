//! PYTHON480 (onsemi NOIP1SN0480A): 808 x 608 pixels of 4.8 um, global shutter, 10 bits; the sensor of the UCLA
//! Miniscope V4.
//!
//! onsemi gives the full register map only with the data sheet. What is here stands in two public programs for the
//! Miniscope V4 and is used where they agree:
//!
//! - the firmware of the wire-free V4, `PYTHON480.c` (github.com/Aharoni-Lab/Miniscope-v4-Wire-Free): clock management,
//!   power-up, units of exposure and frame length, codes of the gain, and the region in steps of four pixels (its
//!   `ROI_Configuration`);
//! - Open Ephys' `ConfigureUclaMiniscopeV4Camera.cs` (github.com/open-ephys/onix-bonsai-onix1): the same values for the
//!   registers 16, 32, 199 to 201 and 204, and the frame lengths of 10 to 30 frames a second.
//!
//! Two things are left out. The *required uploads* (registers 20 to 130 and 192 to 235, and the program of the
//! sequencer at 384 to 476) are onsemi's, and the public copies differ: the caller gives them. The triggered mode is in
//! neither source, so the sensor runs freely, and a start of its exposures by a pulse is refused.

use super::ImageSensor;
use super::serial_bus::Registers;
use core::fmt;
use ommatidia_shared::device::{Steps, check};
use ommatidia_shared::wire::{CameraLimits, CameraSettings, Limits, SensorRegion, Setting, SettingError, Trigger};

/// Pixels of the array: rows, columns.
pub const ARRAY: [u16; 2] = [608, 808];
/// Rows and columns are chosen by this many.
const BLOCK: u16 = 4;
/// Exposure and frame length are counted in tens of microseconds (666 periods of the clock after the PLL).
const TICK_US: u32 = 10;
/// Frame length of 30 frames a second, the fastest in the sources, and the longest that the register holds.
const FRAME_TICKS: [u32; 2] = [3300, 0xffff];
/// The least time between exposure and frame length in the sources, ticks.
const BETWEEN: u32 = 100;
/// Analogue gains, thousandths, and their codes.
const GAINS: [(u32, u16); 3] = [(1000, 0x00e1), (2000, 0x00e4), (3500, 0x0024)];

/// Addresses of the registers that are used.
mod register {
    pub const CHIP_ID: u16 = 0;
    pub const COLOUR: u16 = 2;
    pub const RESET_PLL: u16 = 8;
    pub const RESET_CLOCKS: u16 = 9;
    pub const RESET_ANALOG: u16 = 10;
    pub const PLL: u16 = 16;
    pub const PLL_CONFIGURATION: u16 = 17;
    pub const CLOCKS: u16 = 20;
    pub const PLL_LOCK: [u16; 2] = [26, 27];
    pub const CLOCK_GENERATOR: u16 = 32;
    pub const LOGIC: u16 = 34;
    pub const COLUMNS: u16 = 40;
    pub const IMAGE_CORE: u16 = 42;
    pub const CONVERTERS: u16 = 48;
    pub const BIAS: u16 = 64;
    pub const CHARGE_PUMP: u16 = 72;
    pub const LVDS: u16 = 112;
    pub const SEQUENCER: u16 = 192;
    pub const TICK: u16 = 199;
    pub const FRAME_LENGTH: u16 = 200;
    pub const EXPOSURE: u16 = 201;
    pub const GAIN: u16 = 204;
    pub const COLUMNS_READ: u16 = 256;
    pub const ROWS_READ: u16 = 257;
}

/// Register 192: the sequencer runs, or does not.
const SEQUENCER: [u16; 2] = [0x0802, 0x0803];
/// Register 199: periods of the clock in a tick.
const TICK_CLOCKS: u16 = 666;

/// Clock management, first part: the PLL is set and started.
const CLOCKS_1: [(u16, u16); 8] = [
    (register::COLOUR, 0x0000),
    (register::PLL_CONFIGURATION, 0x2113),
    (register::CLOCKS, 0x0000),
    (register::PLL_LOCK[0], 0x2280),
    (register::PLL_LOCK[1], 0x3d2d),
    (register::CLOCK_GENERATOR, 0x7014),
    (register::RESET_PLL, 0x0000),
    (register::PLL, 0x0003),
];
/// Clock management, second part: the clocks go to the logic.
const CLOCKS_2: [(u16, u16); 3] =
    [(register::RESET_CLOCKS, 0x0000), (register::CLOCK_GENERATOR, 0x7006), (register::LOGIC, 0x0001)];
/// Power-up of the analogue parts; the outputs are parallel, so LVDS stays off.
const POWER_UP: [(u16, u16); 8] = [
    (register::RESET_ANALOG, 0x0000),
    (register::CLOCK_GENERATOR, 0x7007),
    (register::COLUMNS, 0x0007),
    (register::IMAGE_CORE, 0x4113),
    (register::CONVERTERS, 0x0001),
    (register::BIAS, 0x0001),
    (register::CHARGE_PUMP, 0x0127),
    (register::LVDS, 0x0000),
];
/// Wait for the PLL, ms.
const PLL_MS: u32 = 10;

/// Why the sensor does not respond.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SensorError<E> {
    /// The bus failed.
    Bus(E),
    /// All bits of the chip's number are equal, as on a bus without a sensor.
    Absent {
        /// Value of register 0.
        found: u16,
    },
}

impl<E: fmt::Debug> fmt::Display for SensorError<E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bus(error) => write!(f, "sensor: the bus failed: {error:?}"),
            Self::Absent { found } => write!(f, "sensor: no chip answers: its number reads {found:#06x}"),
        }
    }
}

impl<E: fmt::Debug> core::error::Error for SensorError<E> {}

impl<E> From<E> for SensorError<E> {
    fn from(error: E) -> Self {
        Self::Bus(error)
    }
}

/// The sensor on its bus.
#[derive(Debug)]
pub struct Python480<R> {
    registers: R,
}

impl<R: Registers> Python480<R> {
    /// Powers the sensor up after a reset: clocks, onsemi's required `uploads` (register, value), analogue parts. It
    /// delivers no frames yet.
    ///
    /// # Errors
    /// [`SensorError::Bus`] where the bus failed, [`SensorError::Absent`] where no chip answers.
    pub fn new(registers: R, uploads: &[(u16, u16)]) -> Result<Self, SensorError<R::Error>> {
        let mut sensor = Self { registers };
        let found = sensor.registers.read(register::CHIP_ID)?;
        if found == 0 || found == u16::MAX {
            return Err(SensorError::Absent { found });
        }
        sensor.write_all(&CLOCKS_1)?;
        sensor.registers.wait_ms(PLL_MS);
        sensor.write_all(&CLOCKS_2)?;
        sensor.write_all(uploads)?;
        sensor.write_all(&POWER_UP)?;
        Ok(sensor)
    }

    /// The bus.
    pub fn into_registers(self) -> R {
        self.registers
    }

    fn write_all(&mut self, registers: &[(u16, u16)]) -> Result<(), R::Error> {
        registers.iter().try_for_each(|&(register, value)| self.registers.write(register, value))
    }
}

fn interval() -> Steps {
    Steps { setting: Setting::Interval, numer: TICK_US, denom: 1, counts: FRAME_TICKS }
}

fn exposure(interval_us: u32) -> Steps {
    let most = (interval_us / TICK_US).saturating_sub(BETWEEN).max(1);
    Steps { setting: Setting::Exposure, numer: TICK_US, denom: 1, counts: [1, most] }
}

/// The nearest gain and its code.
fn gain(thousandths: u32) -> (u32, u16) {
    GAINS.into_iter().min_by_key(|(gain, _)| gain.abs_diff(thousandths)).unwrap_or(GAINS[0])
}

/// First and last block of four, in one register.
fn blocks(first: u16, count: u16) -> u16 {
    let (first, count) = (first / BLOCK, count / BLOCK);
    first | first.saturating_add(count).saturating_sub(1) << 8
}

impl<R: Registers> ImageSensor for Python480<R> {
    const NAME: &'static str = "PYTHON480";
    type Error = R::Error;

    fn plan(wanted: CameraSettings) -> Result<CameraSettings, SettingError> {
        let SensorRegion { row, col, rows, cols, bin } = wanted.region;
        check(Setting::Bin, bin, [1, 1], 1)?;
        check(Setting::Rows, rows, [BLOCK, ARRAY[0]], BLOCK)?;
        check(Setting::Cols, cols, [BLOCK, ARRAY[1]], BLOCK)?;
        check(Setting::Row, row, [0, ARRAY[0] - rows], BLOCK)?;
        check(Setting::Col, col, [0, ARRAY[1] - cols], BLOCK)?;
        if wanted.trigger != Trigger::Device {
            return Err(SettingError { setting: Setting::Trigger, least: 0, most: 0, step: 1, found: 1 });
        }
        let (least, most, found) = (GAINS[0].0, GAINS[GAINS.len() - 1].0, wanted.analog_gain_thousandths);
        if !(least..=most).contains(&found) {
            return Err(SettingError { setting: Setting::AnalogGain, least, most, step: 1, found });
        }
        let interval_us = interval().nearest(wanted.interval_us)?;
        Ok(CameraSettings {
            exposure_us: exposure(interval_us).nearest(wanted.exposure_us)?,
            analog_gain_thousandths: gain(found).0,
            interval_us,
            ..wanted
        })
    }

    fn limits(settings: &CameraSettings) -> CameraLimits {
        CameraLimits {
            array_rows: ARRAY[0],
            array_cols: ARRAY[1],
            exposure_us: exposure(settings.interval_us).limits(),
            analog_gain_thousandths: Limits { least: GAINS[0].0, most: GAINS[GAINS.len() - 1].0 },
            interval_us: interval().limits(),
        }
    }

    fn apply(&mut self, settings: &CameraSettings) -> Result<(), R::Error> {
        let SensorRegion { row, col, rows, cols, .. } = settings.region;
        self.write_all(&[
            (register::SEQUENCER, SEQUENCER[0]),
            (register::TICK, TICK_CLOCKS),
            (register::FRAME_LENGTH, interval().count(settings.interval_us) as u16),
            (register::EXPOSURE, exposure(settings.interval_us).count(settings.exposure_us) as u16),
            (register::GAIN, gain(settings.analog_gain_thousandths).1),
            (register::COLUMNS_READ, blocks(col, cols)),
            (register::ROWS_READ, blocks(row, rows)),
            (register::SEQUENCER, SEQUENCER[1]),
        ])
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use core::convert::Infallible;
    use std::vec::Vec;

    /// Registers that remember what was written.
    #[derive(Debug, Default)]
    struct Written {
        chip: u16,
        writes: Vec<(u16, u16)>,
        waits_ms: Vec<(usize, u32)>,
    }

    impl Registers for &mut Written {
        type Error = Infallible;

        fn write(&mut self, register: u16, value: u16) -> Result<(), Infallible> {
            self.writes.push((register, value));
            Ok(())
        }

        fn read(&mut self, register: u16) -> Result<u16, Infallible> {
            assert_eq!(register, 0);
            Ok(self.chip)
        }

        fn wait_ms(&mut self, ms: u32) {
            self.waits_ms.push((self.writes.len(), ms));
        }
    }

    type Sensor<'a> = Python480<&'a mut Written>;

    /// The Miniscope V4 at 30 frames a second: 608 x 608 pixels.
    fn v4() -> CameraSettings {
        CameraSettings {
            exposure_us: 30_000,
            analog_gain_thousandths: 1000,
            interval_us: 33_000,
            led_permille: 0,
            region: SensorRegion { row: 0, col: 0, rows: 608, cols: 608, bin: 1 }.centred(608, 808),
            trigger: Trigger::Device,
        }
    }

    #[test]
    fn the_settings_of_the_miniscope_are_its_registers() {
        let mut registers = Written { chip: 0x1234, ..Written::default() };
        let mut sensor = Python480::new(&mut registers, &[(43, 0x0518)]).unwrap();
        sensor.apply(&Sensor::plan(v4()).unwrap()).unwrap();
        assert_eq!(registers.waits_ms, [(8, 10)], "the PLL locks before the clocks are used");
        let (start, set) = registers.writes.split_at(20);
        assert_eq!(start[7..12], [(16, 3), (9, 0), (32, 0x7006), (34, 1), (43, 0x0518)]);
        assert_eq!(start[12..14], [(10, 0), (32, 0x7007)]);
        // Frame length and exposure are those that Open Ephys writes; columns 100 to 707 are the blocks 25 to 176.
        let written = [
            (192, 0x0802),
            (199, 666),
            (200, 3300),
            (201, 3000),
            (204, 0x00e1),
            (256, 0xb019),
            (257, 0x9700),
            (192, 0x0803),
        ];
        assert_eq!(set, written);
    }

    #[test]
    fn gains_are_three_and_times_are_tens_of_microseconds() {
        let gains = [1000, 1499, 1501, 2700, 2800, 3500].map(|thousandths| {
            Sensor::plan(CameraSettings { analog_gain_thousandths: thousandths, ..v4() })
                .unwrap()
                .analog_gain_thousandths
        });
        assert_eq!(gains, [1000, 1000, 2000, 2000, 3500, 3500]);
        let set = Sensor::plan(CameraSettings { exposure_us: 12_344, interval_us: 50_006, ..v4() }).unwrap();
        assert_eq!((set.exposure_us, set.interval_us), (12_340, 50_010));
        assert_eq!(Sensor::plan(set), Ok(set));
    }

    #[test]
    fn what_the_sensor_cannot_do_is_refused_with_its_limit() {
        let refused = |change: fn(&mut CameraSettings)| {
            let mut wanted = v4();
            change(&mut wanted);
            let SettingError { setting, least, most, step, found } = Sensor::plan(wanted).unwrap_err();
            (setting, least, most, step, found)
        };
        assert_eq!(refused(|s| s.exposure_us = 32_500), (Setting::Exposure, 10, 32_000, 1, 32_500));
        assert_eq!(refused(|s| s.interval_us = 16_667), (Setting::Interval, 33_000, 655_350, 1, 16_667));
        assert_eq!(refused(|s| s.analog_gain_thousandths = 4000), (Setting::AnalogGain, 1000, 3500, 1, 4000));
        assert_eq!(refused(|s| s.region.rows = 606), (Setting::Rows, 4, 608, 4, 606));
        assert_eq!(refused(|s| s.region.col = 204), (Setting::Col, 0, 200, 4, 204));
        assert_eq!(refused(|s| s.region.bin = 2), (Setting::Bin, 1, 1, 1, 2));
        assert_eq!(refused(|s| s.trigger = Trigger::Input).0, Setting::Trigger);
    }

    #[test]
    fn a_bus_without_a_sensor_is_noticed() {
        for chip in [0, u16::MAX] {
            let mut registers = Written { chip, ..Written::default() };
            assert_eq!(Python480::new(&mut registers, &[]).unwrap_err(), SensorError::Absent { found: chip });
            assert!(registers.writes.is_empty());
        }
    }
}
