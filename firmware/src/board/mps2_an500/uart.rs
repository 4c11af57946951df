//! CMSDK UART (ARM Cortex-M System Design Kit, DDI 0479, section 4.3).
#![allow(unsafe_code)] // registers are memory

use core::convert::Infallible;
use core::ptr::{read_volatile, write_volatile};
use embedded_io::{ErrorType, Read, ReadReady, Write};

/// UART 0 of the MPS2 boards.
const BASE: usize = 0x4000_4000;
const DATA: *mut u32 = BASE as *mut u32;
const STATE: *mut u32 = (BASE + 4) as *mut u32;
const CTRL: *mut u32 = (BASE + 8) as *mut u32;
const BAUDDIV: *mut u32 = (BASE + 16) as *mut u32;

const TX_FULL: u32 = 1;
const RX_FULL: u32 = 2;
const TX_RX_ENABLE: u32 = 3;
/// The fastest rate that the UART has: its clock over 16.
const FASTEST: u32 = 16;

/// UART 0, polled; 8 data bits, no parity, one stop bit.
#[derive(Debug)]
pub struct Uart(());

impl Uart {
    /// Switches the UART on, at its fastest rate.
    pub(super) fn new() -> Self {
        // SAFETY: device registers of this board, used from here only.
        unsafe {
            write_volatile(BAUDDIV, FASTEST);
            write_volatile(CTRL, TX_RX_ENABLE|8); cortex_m::interrupt::disable(); write_volatile(0xE000E100 as *mut u32, 1);
        }
        Self(())
    }

    fn state(&self) -> u32 {
        // SAFETY: reading the state register changes nothing.
        unsafe { read_volatile(STATE) }
    }
}

impl ErrorType for Uart {
    type Error = Infallible;
}

impl ReadReady for Uart {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(self.state() & RX_FULL != 0)
    }
}

impl Read for Uart {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        if buffer.is_empty() {
            return Ok(0);
        }
        while self.state() & RX_FULL == 0 { cortex_m::asm::wfi(); unsafe { write_volatile((BASE+12) as *mut u32, 2); write_volatile(0xE000E280 as *mut u32, 1); } }
        let mut len = 0;
        while len < buffer.len() && self.state() & RX_FULL != 0 {
            // SAFETY: the receive buffer holds a byte; reading takes it.
            buffer[len] = unsafe { read_volatile(DATA) } as u8;
            len += 1;
        }
        Ok(len)
    }
}

impl Write for Uart {
    fn write(&mut self, buffer: &[u8]) -> Result<usize, Infallible> {
        for byte in buffer {
            while self.state() & TX_FULL != 0 {}
            // SAFETY: the transmit buffer is free.
            unsafe { write_volatile(DATA, u32::from(*byte)) };
        }
        Ok(buffer.len())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        while self.state() & TX_FULL != 0 {}
        Ok(())
    }
}
