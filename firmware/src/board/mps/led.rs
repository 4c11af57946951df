//! User LED 0 (FPGAIO block: ARM DAI 0500, table 4-6; the same register on all boards of the family).
#![allow(unsafe_code)] // registers are memory

use super::map::MAP;
use core::convert::Infallible;
use core::ptr::{read_volatile, write_volatile};
use embedded_hal::digital::{ErrorType, OutputPin};

const FPGAIO_LED: *mut u32 = MAP.leds as *mut u32;
const LED_0: u32 = 1;

/// User LED 0.
#[derive(Debug)]
pub struct Led(());

impl Led {
    pub(super) fn new() -> Self {
        Self(())
    }
}

impl ErrorType for Led {
    type Error = Infallible;
}

impl OutputPin for Led {
    fn set_low(&mut self) -> Result<(), Infallible> {
        // SAFETY: a device register of this board, used from here only.
        unsafe { write_volatile(FPGAIO_LED, read_volatile(FPGAIO_LED) & !LED_0) };
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        // SAFETY: as above.
        unsafe { write_volatile(FPGAIO_LED, read_volatile(FPGAIO_LED) | LED_0) };
        Ok(())
    }
}
