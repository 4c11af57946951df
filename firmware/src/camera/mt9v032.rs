//! MT9V032: 752 x 480 pixels of 6 um, global shutter, 10 bits; the sensor of the UCLA Miniscope V3.
//!
//! Registers: ON Semiconductor, "MT9V032 1/3-Inch Wide-VGA CMOS Digital Image Sensor", rev. 2015, table 8; where it is
//! silent on limits, the Linux driver `drivers/media/i2c/mt9v032.c`. Registers have 16 bits, high byte first.

use core::fmt;
use embedded_hal::i2c::I2c;

/// Address on the bus with both address pins high.
pub const ADDRESS: u8 = 0x5c;
/// Value of R0x00 in revision 3. In revisions 1 and 2 it is 0x1311.
pub const CHIP_VERSION: u16 = 0x1313;
const CHIP_VERSION_1: u16 = 0x1311;

/// Pixels of the array.
const ARRAY: [u16; 2] = [480, 752];
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

/// R0x07: master mode, parallel output, exposure and readout at the same time.
const RUN: u16 = 1 << 3 | 1 << 7 | 1 << 8;
/// R0x0d: bits 8 and 9 must stay set.
const READ_MODE: u16 = 3 << 8;
/// Vertical blanking, rows: the default.
const VERTICAL_BLANKING: u16 = 45;

/// Why the sensor refuses a setting or does not respond.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SensorError<E> {
    /// The bus failed.
    Bus(E),
    /// Another chip responds.
    Version {
        /// Value of its version register.
        found: u16,
    },
    /// The window does not fit the pixel array.
    Window {
        /// Window given.
        found: Window,
    },
    /// Exposure or gain are outside their limits.
    Setting {
        /// Largest allowed value.
        largest: u16,
        /// Value given.
        found: u16,
    },
}

impl<E: fmt::Debug> fmt::Display for SensorError<E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bus(error) => write!(f, "sensor: the bus failed: {error:?}"),
            Self::Version { found } => write!(f, "sensor: expected version {CHIP_VERSION:#06x}, found {found:#06x}"),
            Self::Window { found } => {
                let Window { rows, cols, bin } = found;
                write!(
                    f,
                    "sensor: {rows} x {cols} pixels binned by {bin}: expected at most 480 x 752, bins of 1, 2 or 4"
                )
            }
            Self::Setting { largest, found } => write!(f, "sensor: expected at most {largest}, found {found}"),
        }
    }
}

impl<E: fmt::Debug> core::error::Error for SensorError<E> {}

impl<E> From<E> for SensorError<E> {
    fn from(error: E) -> Self {
        Self::Bus(error)
    }
}

/// The part of the pixel array that is read, in its middle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// Rows of the frame.
    pub rows: u16,
    /// Columns of the frame.
    pub cols: u16,
    /// Rows and columns of the array that are averaged to one pixel of the frame: 1, 2 or 4.
    pub bin: u16,
}

impl Window {
    /// Pixels of the frame.
    pub const fn pixels(&self) -> usize {
        self.rows as usize * self.cols as usize
    }

    /// Rows and columns of the array that are read; `None` where they do not fit.
    fn on_array(self) -> Option<[u16; 2]> {
        let Self { rows, cols, bin } = self;
        let fits = |n: u16, most: u16| n.checked_mul(bin).filter(|n| (1..=most).contains(n));
        if matches!(bin, 1 | 2 | 4) { Some([fits(rows, ARRAY[0])?, fits(cols, ARRAY[1])?]) } else { None }
    }
}

/// The sensor on its bus.
#[derive(Debug)]
pub struct Mt9v032<B> {
    bus: B,
}

impl<B: I2c> Mt9v032<B> {
    /// Resets the sensor, checks its version, and disables everything that changes frames by itself: automatic
    /// exposure, automatic gain, and the correction of row noise, which the calibration measures.
    ///
    /// # Errors
    /// [`SensorError::Bus`] where the bus failed, [`SensorError::Version`] where another chip responds.
    pub fn new(bus: B) -> Result<Self, SensorError<B::Error>> {
        let mut sensor = Self { bus };
        let found = sensor.read(register::CHIP_VERSION)?;
        if found != CHIP_VERSION && found != CHIP_VERSION_1 {
            return Err(SensorError::Version { found });
        }
        let registers = [
            (register::RESET, 1),
            (register::RESET, 0),
            (register::CHIP_CONTROL, 0),
            (register::AUTOMATIC, 0),
            (register::ROW_NOISE_CORRECTION, 0),
            (register::VERTICAL_BLANKING, VERTICAL_BLANKING),
        ];
        sensor.write_all(&registers)?;
        Ok(sensor)
    }

    /// Starts to deliver frames of `window`.
    ///
    /// # Errors
    /// [`SensorError::Window`] where it does not fit the array, [`SensorError::Bus`] where the bus failed.
    pub fn start(&mut self, window: Window) -> Result<(), SensorError<B::Error>> {
        let [rows, cols] = window.on_array().ok_or(SensorError::Window { found: window })?;
        let log2 = window.bin.trailing_zeros() as u16;
        let registers = [
            (register::CHIP_CONTROL, 0),
            (register::READ_MODE, READ_MODE | log2 << 2 | log2),
            (register::COLUMN_START, FIRST[1] + (ARRAY[1] - cols) / 2),
            (register::ROW_START, FIRST[0] + (ARRAY[0] - rows) / 2),
            (register::WINDOW_WIDTH, cols),
            (register::WINDOW_HEIGHT, rows),
            // Short rows are filled up to the shortest that the converters keep pace with.
            (register::HORIZONTAL_BLANKING, ROW_CLOCKS.saturating_sub(cols).clamp(BLANKING[0], BLANKING[1])),
            (register::CHIP_CONTROL, RUN),
        ];
        Ok(self.write_all(&registers)?)
    }

    /// Sets the exposure, in rows. A row takes the columns of the window and the blanking, pixel clocks.
    ///
    /// # Errors
    /// [`SensorError::Setting`] where `rows` is not from 1 to 32,767, [`SensorError::Bus`] where the bus failed.
    pub fn expose(&mut self, rows: u16) -> Result<(), SensorError<B::Error>> {
        self.set(register::TOTAL_SHUTTER_WIDTH, rows, [1, 32_767])
    }

    /// Sets the analog gain in sixteenths, 16 to 64.
    ///
    /// # Errors
    /// [`SensorError::Setting`] where the gain is outside its limits, [`SensorError::Bus`] where the bus failed.
    pub fn amplify(&mut self, sixteenths: u16) -> Result<(), SensorError<B::Error>> {
        self.set(register::ANALOG_GAIN, sixteenths, [16, 64])
    }

    /// The bus.
    pub fn into_bus(self) -> B {
        self.bus
    }

    fn set(&mut self, register: u8, value: u16, [least, largest]: [u16; 2]) -> Result<(), SensorError<B::Error>> {
        if !(least..=largest).contains(&value) {
            return Err(SensorError::Setting { largest, found: value });
        }
        Ok(self.write_all(&[(register, value)])?)
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
        let registers = [(0x0c, 1), (0x0c, 0), (0x07, 0), (0xaf, 0), (0x70, 0), (0x06, 45)];
        [vec![version(CHIP_VERSION)], writes(&registers)].concat()
    }

    #[test]
    fn the_sensor_is_reset_and_left_without_automatics() {
        let mut bus = Mock::new(&opening());
        Mt9v032::new(&mut bus).unwrap();
        bus.done();
    }

    #[test]
    fn a_window_lies_in_the_middle_and_its_rows_are_long_enough() {
        // 214 rows and columns of the array: rows 138 to 351 of 5 to 484, columns 270 to 483 of 1 to 752; 214 + 446 =
        // 660 clocks.
        let plain = [(7, 0), (0x0d, 0x300), (1, 270), (2, 138), (4, 214), (3, 214), (5, 446), (7, 0x188)];
        // 428 of them, averaged by twos: 428 + 232 = 660 clocks.
        let binned = [(7, 0), (0x0d, 0x305), (1, 163), (2, 31), (4, 428), (3, 428), (5, 232), (7, 0x188)];
        // All columns: more than 660 clocks, and the least blanking.
        let wide = [(7, 0), (0x0d, 0x300), (1, 1), (2, 5), (4, 752), (3, 480), (5, 43), (7, 0x188)];
        let mut bus = Mock::new(&[opening(), writes(&plain), writes(&binned), writes(&wide)].concat());
        let mut sensor = Mt9v032::new(&mut bus).unwrap();
        sensor.start(Window { rows: 214, cols: 214, bin: 1 }).unwrap();
        sensor.start(Window { rows: 214, cols: 214, bin: 2 }).unwrap();
        sensor.start(Window { rows: 480, cols: 752, bin: 1 }).unwrap();
        bus.done();
    }

    #[test]
    fn exposure_and_gain_have_limits() {
        let mut bus = Mock::new(&[opening(), writes(&[(0x0b, 480), (0x35, 64)])].concat());
        let mut sensor = Mt9v032::new(&mut bus).unwrap();
        sensor.expose(480).unwrap();
        sensor.amplify(64).unwrap();
        assert_eq!(sensor.expose(0), Err(SensorError::Setting { largest: 32_767, found: 0 }));
        assert_eq!(sensor.expose(40_000), Err(SensorError::Setting { largest: 32_767, found: 40_000 }));
        assert_eq!(sensor.amplify(65), Err(SensorError::Setting { largest: 64, found: 65 }));
        bus.done();
    }

    #[test]
    fn another_chip_and_windows_beyond_the_array_are_refused() {
        let mut bus = Mock::new(&[version(0x2481)]);
        assert_eq!(Mt9v032::new(&mut bus).unwrap_err(), SensorError::Version { found: 0x2481 });
        bus.done();
        let mut bus = Mock::new(&opening());
        let mut sensor = Mt9v032::new(&mut bus).unwrap();
        for (rows, cols, bin) in
            [(481, 10, 1), (10, 753, 1), (0, 10, 1), (241, 10, 2), (10, 10, 3), (65_535, 65_535, 4)]
        {
            let found = Window { rows, cols, bin };
            assert_eq!(sensor.start(found), Err(SensorError::Window { found }));
        }
        bus.done();
    }
}
