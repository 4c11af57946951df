//! USART3, which the probe carries to the host as a serial port.

use super::{Dog, clock};
use core::convert::Infallible;
use cortex_m::{asm, interrupt};
use embassy_stm32::usart::{BufferedInterruptHandler, BufferedUart, Config};
use embassy_stm32::{Peri, bind_interrupts, peripherals};
use embedded_io::{ErrorType, Read, ReadReady, Write};
use ommatidia_shared::device::Watchdog;

bind_interrupts!(struct Interrupts {
    USART3 => BufferedInterruptHandler<peripherals::USART3>;
});

/// Bits a second; the fastest rate that the probe's port has as well.
const BAUD: u32 = 921_600;

/// The serial line, and the watchdog that is fed while nothing comes. What is lost or damaged on the line is lost: the host asks again.
pub struct Link(BufferedUart<'static>, Dog);

impl Link {
    /// Opens the line; `None` where the rate cannot be had.
    pub(super) fn new(
        uart: Peri<'static, peripherals::USART3>,
        rx: Peri<'static, peripherals::PD9>,
        tx: Peri<'static, peripherals::PD8>,
        [send, receive]: [&'static mut [u8]; 2],
        watchdog: Dog,
    ) -> Option<Self> {
        let mut config = Config::default();
        config.baudrate = BAUD;
        BufferedUart::new(uart, rx, tx, send, receive, Interrupts, config).ok().map(|uart| Self(uart, watchdog))
    }
}

impl ErrorType for Link {
    type Error = Infallible;
}

impl Link {
    /// Sleeps until the receive interrupt, or the tick. Waiting is no hang: the watchdog is fed.
    fn sleep_until_received(&mut self) {
        // An error is told by the read.
        while !self.0.read_ready().unwrap_or(true) {
            interrupt::disable();
            // A byte that has come since is seen here; one that comes from here on wakes the core, masked as its interrupt is.
            if !self.0.read_ready().unwrap_or(true) {
                let before = clock::now();
                asm::wfi();
                clock::slept(before);
            }
            // SAFETY: they were not masked before; nothing here relies on it.
            #[allow(unsafe_code)]
            unsafe {
                interrupt::enable();
            }
            self.1.feed();
        }
    }
}

impl Read for Link {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        loop {
            self.sleep_until_received();
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
