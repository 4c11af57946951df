//! USART3, which the probe carries to the host as a serial port.

use core::convert::Infallible;
use embassy_stm32::usart::{BufferedInterruptHandler, BufferedUart, Config};
use embassy_stm32::{Peri, bind_interrupts, peripherals};
use embedded_io::{ErrorType, Read, Write};

bind_interrupts!(struct Interrupts {
    USART3 => BufferedInterruptHandler<peripherals::USART3>;
});

/// Bits a second; the fastest rate that the probe's port has as well.
const BAUD: u32 = 921_600;

/// The serial line. What is lost or damaged on it is lost: the host asks again.
pub struct Link(BufferedUart<'static>);

impl Link {
    /// Opens the line; `None` where the rate cannot be had.
    pub(super) fn new(
        uart: Peri<'static, peripherals::USART3>,
        rx: Peri<'static, peripherals::PD9>,
        tx: Peri<'static, peripherals::PD8>,
        [send, receive]: [&'static mut [u8]; 2],
    ) -> Option<Self> {
        let mut config = Config::default();
        config.baudrate = BAUD;
        BufferedUart::new(uart, rx, tx, send, receive, Interrupts, config).ok().map(Self)
    }
}

impl ErrorType for Link {
    type Error = Infallible;
}

impl Read for Link {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        loop {
            if let Ok(count) = self.0.read(buffer) {
                return Ok(count);
            }
        }
    }
}

impl Write for Link {
    fn write(&mut self, buffer: &[u8]) -> Result<usize, Infallible> {
        Ok(self.0.write(buffer).unwrap_or(buffer.len()))
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        let _ = self.0.flush();
        Ok(())
    }
}
