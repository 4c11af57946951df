//! MT9V032: 752 x 480 pixels of 6 um, global shutter, 10 bits; the sensor of the UCLA Miniscope V3.
//!
//! Registers: ON Semiconductor, "MT9V032 1/3-Inch Wide-VGA CMOS Digital Image Sensor", rev. 2015, table 8; where it is
//! silent on limits, the Linux driver `drivers/media/i2c/mt9v032.c`. Registers have 16 bits, high byte first.
//!
//! The sensor runs in snapshot mode: each pulse at its pin EXPOSURE starts one exposure, and its pin LED_OUT is high
//! during it.

use super::ImageSensor;
use core::fmt;
use embedded_hal::i2c::I2c;
use ommatidia_shared::device::{Steps, check};
use ommatidia_shared::wire::{CameraLimits, CameraSettings, SensorRegion, Setting, SettingError};

/// Address on the bus with both address pins high.
pub const ADDRESS: u8 = 0x5c;
/// Value of R0x00 in revision 3. In revisions 1 and 2 it is 0x1311.
pub const CHIP_VERSION: u16 = 0x1313;
const CHIP_VERSION_1: u16 = 0x1311;
/// Clock that the board gives, MHz.
pub const CLOCK_MHZ: u32 = 24;

/// Pixels of the array: rows, columns.
pub const ARRAY: [u16; 2] = [480, 752];
/// First row and column that are exposed to light.
const FIRST: [u16; 2] = [5, 1];
/// Length of the shortest row, pixel clocks.
const ROW_CLOCKS: u16 = 660;
/// Shortest and longest horizontal blanking, pixel clocks.
const BLANKING: [u16; 2] = [43, 1023];

/// Addresses of the registers that are used.
mod register {
    pub const CHIP_VERSION: u8 = 0x00;
    pub const COLUMN_START: u8 = 0x01;
    pub const ROW_START: u8 = 0x02;
    pub const WINDOW_HEIGHT: u8 = 0x03;
    pub const WINDOW_WIDTH: u8 = 0x04;
    pub const HORIZONTAL_BLANKING: u8 = 0x05;
    pub const VERTICAL_BLANKING: u8 = 0x06;
    pub const CHIP_CONTROL: u8 = 0x07;
    pub const TOTAL_SHUTTER_WIDTH: u8 = 0x0b;
    pub const RESET: u8 = 0x0c;
    pub const READ_MODE: u8 = 0x0d;
    pub const ANALOG_GAIN: u8 = 0x35;
    pub const ROW_NOISE_CORRECTION: u8 = 0x70;
    pub const AUTOMATIC: u8 = 0xaf;
}

/// R0x07: snapshot mode, parallel output, exposure and readout not one after the other.
const RUN: u16 = 3 << 3 | 1 << 7 | 1 << 8;
/// R0x0d: bits 8 and 9 must stay set.
const READ_MODE: u16 = 3 << 8;
/// Vertical blanking, rows: the default.
const VERTICAL_BLANKING: u16 = 45;
/// R0x0b: most rows of an exposure.
const EXPOSURE_ROWS: u32 = 32_767;
/// R0x35: sixteenths.
const ANALOG_GAIN: Steps = Steps { setting: Setting::AnalogGain, numer: 1000, denom: 16, counts: [16, 64] };
/// Longest interval between exposures that the device times, us.
const LONGEST_US: u32 = 1_000_000;

/// Why the sensor does not respond.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SensorError<E> {
    /// The bus failed.
    Bus(E),
    /// Another chip responds.
    Version {
        /// Value of its version register.
        found: u16,
    },
}

impl<E: fmt::Debug> fmt::Display for SensorError<E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bus(error) => write!(f, "sensor: the bus failed: {error:?}"),
            Self::Version { found } => write!(f, "sensor: expected version {CHIP_VERSION:#06x}, found {found:#06x}"),
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
pub struct Mt9v032<B> {
    bus: B,
}

impl<B: I2c> Mt9v032<B> {
    /// Checks the version of the sensor and resets it. Its settings are those of [`ImageSensor::apply`].
    ///
    /// # Errors
    /// [`SensorError::Bus`] where the bus failed, [`SensorError::Version`] where another chip responds.
    pub fn new(bus: B) -> Result<Self, SensorError<B::Error>> {
        let mut sensor = Self { bus };
        let found = sensor.read(register::CHIP_VERSION)?;
        if found != CHIP_VERSION && found != CHIP_VERSION_1 {
            return Err(SensorError::Version { found });
        }
        sensor.write_all(&[(register::RESET, 1), (register::RESET, 0)])?;
        Ok(sensor)
    }

    /// The bus.
    pub fn into_bus(self) -> B {
        self.bus
    }

    fn read(&mut self, register: u8) -> Result<u16, B::Error> {
        let mut value = [0; 2];
        self.bus.write_read(ADDRESS, &[register], &mut value)?;
        Ok(u16::from_be_bytes(value))
    }

    fn write_all(&mut self, registers: &[(u8, u16)]) -> Result<(), B::Error> {
        registers.iter().try_for_each(|&(register, value)| {
            let [high, low] = value.to_be_bytes();
            self.bus.write(ADDRESS, &[register, high, low])
        })
    }
}

/// Length of a row, pixel clocks: short rows are filled up to the shortest that the converters keep pace with.
fn row_clocks(region: SensorRegion) -> u32 {
    let cols = region.cols.saturating_mul(region.bin);
    u32::from(cols) + u32::from(blanking(cols))
}

fn blanking(cols: u16) -> u16 {
    ROW_CLOCKS.saturating_sub(cols).clamp(BLANKING[0], BLANKING[1])
}

/// Rows of a frame, the blank ones included.
fn frame_rows(region: SensorRegion) -> u32 {
    u32::from(region.rows) * u32::from(region.bin) + u32::from(VERTICAL_BLANKING)
}

/// Exposures are counted in rows. Exposure and readout fit the interval.
fn exposure(region: SensorRegion, interval_us: u32) -> Steps {
    let row = row_clocks(region);
    let in_interval = (u64::from(interval_us) * u64::from(CLOCK_MHZ) / u64::from(row)) as u32;
    let most = in_interval.saturating_sub(frame_rows(region)).clamp(1, EXPOSURE_ROWS);
    Steps { setting: Setting::Exposure, numer: row, denom: CLOCK_MHZ, counts: [1, most] }
}

/// The device starts each exposure, so the interval is one of its clock.
fn interval(region: SensorRegion) -> Steps {
    let least = ((frame_rows(region) + 1) * row_clocks(region)).div_ceil(CLOCK_MHZ);
    Steps { setting: Setting::Interval, numer: 1, denom: 1, counts: [least, LONGEST_US] }
}

impl<B: I2c> ImageSensor for Mt9v032<B> {
    const NAME: &'static str = "MT9V032";
    type Error = B::Error;

    fn plan(wanted: CameraSettings) -> Result<CameraSettings, SettingError> {
        let region = wanted.region;
        let SensorRegion { row, col, rows, cols, bin } = region;
        if !matches!(bin, 1 | 2 | 4) {
            return Err(SettingError { setting: Setting::Bin, least: 1, most: 4, step: 1, found: bin.into() });
        }
        check(Setting::Rows, rows, [1, ARRAY[0] / bin], 1)?;
        // The transfer moves pixels by twos.
        check(Setting::Cols, cols, [2, ARRAY[1] / bin], 2)?;
        check(Setting::Row, row, [0, ARRAY[0] - rows * bin], 1)?;
        check(Setting::Col, col, [0, ARRAY[1] - cols * bin], 1)?;
        let interval_us = interval(region).nearest(wanted.interval_us)?;
        Ok(CameraSettings {
            exposure_us: exposure(region, interval_us).nearest(wanted.exposure_us)?,
            analog_gain_thousandths: ANALOG_GAIN.nearest(wanted.analog_gain_thousandths)?,
            interval_us,
            ..wanted
        })
    }

    fn limits(settings: &CameraSettings) -> CameraLimits {
        CameraLimits {
            array_rows: ARRAY[0],
            array_cols: ARRAY[1],
            exposure_us: exposure(settings.region, settings.interval_us).limits(),
            analog_gain_thousandths: ANALOG_GAIN.limits(),
            interval_us: interval(settings.region).limits(),
        }
    }

    /// An exposure begins with a row, up to two rows after the pulse. A microsecond more is for the pulse itself.
    fn latency_us(settings: &CameraSettings) -> u32 {
        (2 * row_clocks(settings.region)).div_ceil(CLOCK_MHZ) + 1
    }

    /// Writes every register that differs from what it is after a reset, so that a sensor that was without power for a
    /// moment is as it was. What changes frames by itself is off: automatic exposure, automatic gain, and the
    /// correction of row noise, which the calibration measures.
    fn apply(&mut self, settings: &CameraSettings) -> Result<(), B::Error> {
        let SensorRegion { row, col, rows, cols, bin } = settings.region;
        let (rows, cols, log2) = (rows * bin, cols * bin, bin.trailing_zeros() as u16);
        let exposure = exposure(settings.region, settings.interval_us).count(settings.exposure_us);
        self.write_all(&[
            (register::CHIP_CONTROL, 0),
            (register::AUTOMATIC, 0),
            (register::ROW_NOISE_CORRECTION, 0),
            (register::VERTICAL_BLANKING, VERTICAL_BLANKING),
            (register::READ_MODE, READ_MODE | log2 << 2 | log2),
            (register::COLUMN_START, FIRST[1] + col),
            (register::ROW_START, FIRST[0] + row),
            (register::WINDOW_WIDTH, cols),
            (register::WINDOW_HEIGHT, rows),
            (register::HORIZONTAL_BLANKING, blanking(cols)),
            (register::TOTAL_SHUTTER_WIDTH, exposure as u16),
            (register::ANALOG_GAIN, ANALOG_GAIN.count(settings.analog_gain_thousandths) as u16),
            (register::CHIP_CONTROL, RUN),
        ])
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use embedded_hal_mock::eh1::i2c::{Mock, Transaction};
    use std::vec;
    use std::vec::Vec;

    fn version(value: u16) -> Transaction {
        Transaction::write_read(ADDRESS, vec![0], value.to_be_bytes().to_vec())
    }

    fn writes(registers: &[(u8, u16)]) -> Vec<Transaction> {
        let write = |&(register, value): &(u8, u16)| {
            let [high, low] = value.to_be_bytes();
            Transaction::write(ADDRESS, vec![register, high, low])
        };
        registers.iter().map(write).collect()
    }

    /// The transactions of [`Mt9v032::new`].
    fn opening() -> Vec<Transaction> {
        [vec![version(CHIP_VERSION)], writes(&[(0x0c, 1), (0x0c, 0)])].concat()
    }

    #[test]
    fn the_sensor_is_reset() {
        let mut bus = Mock::new(&opening());
        Mt9v032::new(&mut bus).unwrap();
        bus.done();
    }

    type Sensor<'a> = Mt9v032<&'a mut Mock>;

    fn settings(rows: u16, cols: u16, bin: u16) -> CameraSettings {
        CameraSettings {
            exposure_us: 10_000,
            analog_gain_thousandths: 1000,
            interval_us: 50_000,
            led_permille: 0,
            region: SensorRegion { row: 0, col: 0, rows, cols, bin }.centred(ARRAY[0], ARRAY[1]),
            trigger: Default::default(),
        }
    }

    #[test]
    fn a_region_and_its_exposure_become_registers() {
        // Rows of 660 clocks of 24 MHz, 27.5 us: 10 ms are 364 of them. 214 rows and columns of the array: rows 138 to
        // 351 of 5 to 484, columns 270 to 483 of 1 to 752; 214 + 446 = 660 clocks.
        let plain = [
            (7, 0),
            (0xaf, 0),
            (0x70, 0),
            (6, 45),
            (0x0d, 0x300),
            (1, 270),
            (2, 138),
            (4, 214),
            (3, 214),
            (5, 446),
            (0x0b, 364),
            (0x35, 16),
            (7, 0x198),
        ];
        // 428 of them, averaged by twos: 428 + 232 = 660 clocks.
        let binned = [
            (7, 0),
            (0xaf, 0),
            (0x70, 0),
            (6, 45),
            (0x0d, 0x305),
            (1, 163),
            (2, 31),
            (4, 428),
            (3, 428),
            (5, 232),
            (0x0b, 364),
            (0x35, 16),
            (7, 0x198),
        ];
        // All columns: 752 and the least blanking, 795 clocks, 33.1 us: 302 rows.
        let wide = [
            (7, 0),
            (0xaf, 0),
            (0x70, 0),
            (6, 45),
            (0x0d, 0x300),
            (1, 1),
            (2, 5),
            (4, 752),
            (3, 480),
            (5, 43),
            (0x0b, 302),
            (0x35, 16),
            (7, 0x198),
        ];
        let mut bus = Mock::new(&[opening(), writes(&plain), writes(&binned), writes(&wide)].concat());
        let mut sensor = Mt9v032::new(&mut bus).unwrap();
        for (rows, cols, bin) in [(214, 214, 1), (214, 214, 2), (480, 752, 1)] {
            sensor.apply(&Sensor::plan(settings(rows, cols, bin)).unwrap()).unwrap();
        }
        bus.done();
    }

    #[test]
    fn what_is_set_is_what_the_registers_can_hold() {
        let wanted = CameraSettings { exposure_us: 5000, analog_gain_thousandths: 1999, ..settings(214, 214, 2) };
        let set = Sensor::plan(wanted).unwrap();
        // 182 rows of 27.5 us; 32 sixteenths.
        assert_eq!((set.exposure_us, set.analog_gain_thousandths, set.interval_us), (5005, 2000, 50_000));
        assert_eq!(Sensor::plan(set), Ok(set), "settings in force can be asked for again");
        // 428 rows and 45 blank ones are 13,007.5 us; the exposure has the rest of the interval.
        let limits = Sensor::limits(&set);
        assert_eq!((limits.exposure_us.least, limits.exposure_us.most), (28, 36_988));
        assert_eq!((limits.interval_us.least, limits.interval_us.most), (13_035, 1_000_000));
    }

    #[test]
    fn an_exposure_may_begin_two_rows_after_its_pulse() {
        // Rows of 27.5 us, and of 795 clocks.
        assert_eq!([settings(214, 214, 1), settings(480, 752, 1)].map(|s| Sensor::latency_us(&s)), [56, 68]);
    }

    #[test]
    fn what_the_sensor_cannot_do_is_refused_with_its_limit() {
        let refused = |change: fn(&mut CameraSettings)| {
            let mut wanted = settings(214, 214, 2);
            change(&mut wanted);
            let SettingError { setting, least, most, found, .. } = Sensor::plan(wanted).unwrap_err();
            (setting, least, most, found)
        };
        assert_eq!(refused(|s| s.exposure_us = 0), (Setting::Exposure, 28, 36_988, 0));
        assert_eq!(refused(|s| s.exposure_us = 40_000), (Setting::Exposure, 28, 36_988, 40_000));
        assert_eq!(refused(|s| s.analog_gain_thousandths = 4001), (Setting::AnalogGain, 1000, 4000, 4001));
        assert_eq!(refused(|s| s.interval_us = 10_000), (Setting::Interval, 13_035, 1_000_000, 10_000));
        assert_eq!(refused(|s| s.interval_us = 20_000), (Setting::Exposure, 28, 6985, 10_000));
        assert_eq!(refused(|s| s.region.rows = 241), (Setting::Rows, 1, 240, 241));
        assert_eq!(refused(|s| s.region.cols = 378), (Setting::Cols, 2, 376, 378));
        assert_eq!(refused(|s| s.region.cols = 213), (Setting::Cols, 2, 376, 213));
        assert_eq!(refused(|s| s.region.row = 53), (Setting::Row, 0, 52, 53));
        assert_eq!(refused(|s| s.region.col = 325), (Setting::Col, 0, 324, 325));
        assert_eq!(refused(|s| s.region.bin = 3), (Setting::Bin, 1, 4, 3));
        assert_eq!(refused(|s| s.region.bin = u16::MAX).0, Setting::Bin);
    }

    #[test]
    fn another_chip_is_refused() {
        let mut bus = Mock::new(&[version(0x2481)]);
        assert_eq!(Mt9v032::new(&mut bus).unwrap_err(), SensorError::Version { found: 0x2481 });
        bus.done();
    }
}
