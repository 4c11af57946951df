//! USART3, which the debug probe presents to the host as a serial port.

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

/// Rate, bit/s: the fastest that the port of the probe supports.
const BAUD: u32 = 921_600;

/// The serial line, and the watchdog that it feeds while it waits. Lost or damaged bytes are not recovered: the host
/// repeats its request.
pub struct Link(BufferedUart<'static>, Dog);

impl Link {
    /// Opens the line. `None` where the rate is not possible.
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
    /// Sleeps until a byte was received. The tick wakes the core in between, to feed the watchdog.
    fn sleep_until_received(&mut self) {
        // The read reports an error.
        while !self.0.read_ready().unwrap_or(true) {
            interrupt::disable();
            // This finds a byte that has come since. A later one wakes the core although its interrupt is masked.
            if !self.0.read_ready().unwrap_or(true) {
                let before = clock::now();
                asm::wfi();
                clock::slept(before);
            }
            // SAFETY: interrupts were enabled before, and nothing here relies on their being masked.
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
