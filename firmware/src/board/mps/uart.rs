//! CMSDK UART (ARM Cortex-M System Design Kit, DDI 0479, section 4.3).
#![allow(unsafe_code)] // registers are memory

use super::map::MAP;
use super::{Dog, clock};
use core::convert::Infallible;
use core::ptr::{read_volatile, write_volatile};
use cortex_m::asm;
use cortex_m::interrupt::{self, InterruptNumber};
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{NVIC, Peripherals, SCB};
use embedded_io::{ErrorType, Read, ReadReady, Write};
use ommatidia_shared::device::Watchdog;

const BASE: usize = MAP.uart;
const DATA: *mut u32 = BASE as *mut u32;
const STATE: *mut u32 = (BASE + 4) as *mut u32;
const CTRL: *mut u32 = (BASE + 8) as *mut u32;
const INTCLEAR: *mut u32 = (BASE + 12) as *mut u32;
const BAUDDIV: *mut u32 = (BASE + 16) as *mut u32;

const TX_FULL: u32 = 1;
const RX_FULL: u32 = 2;
const ENABLE_TX_RX: u32 = 3;
const ENABLE_RX_INTERRUPT: u32 = 1 << 3;
const CLEAR_RX_INTERRUPT: u32 = 2;
/// The fastest rate that the UART has: its clock over 16.
const FASTEST: u32 = 16;
/// The longest time between two ticks, 0.67 s.
const TICK_CYCLES: u32 = 0x00ff_ffff;

/// The interrupt: UART 0 has received.
#[derive(Clone, Copy)]
struct Received;

// SAFETY: the number is that of the board's vector table.
unsafe impl InterruptNumber for Received {
    fn number(self) -> u16 {
        MAP.received
    }
}

/// UART 0: 8 data bits, no parity, one stop bit.
///
/// Between bytes the core sleeps until the receive interrupt or the tick is pending. Interrupts only wake the core:
/// they stay masked, so no handler runs. Under QEMU this leaves processor time to the thread that delivers the bytes.
/// The tick wakes the core to feed the watchdog while it waits.
#[derive(Debug)]
pub struct Uart {
    watchdog: Dog,
}

impl Uart {
    /// Enables the UART at its fastest rate, and the tick.
    pub(super) fn new(watchdog: Dog) -> Self {
        interrupt::disable();
        // SAFETY: the tick is used from here only.
        let mut tick = unsafe { Peripherals::steal() }.SYST;
        tick.set_clock_source(SystClkSource::Core);
        tick.set_reload(TICK_CYCLES);
        tick.clear_current();
        tick.enable_counter();
        tick.enable_interrupt();
        // SAFETY: device registers of this board, used from here only; the unmasked interrupt is never taken.
        unsafe {
            write_volatile(BAUDDIV, FASTEST);
            write_volatile(CTRL, ENABLE_TX_RX | ENABLE_RX_INTERRUPT);
            NVIC::unmask(Received);
        }
        Self { watchdog }
    }

    fn state(&self) -> u32 {
        // SAFETY: reading the state register changes nothing.
        unsafe { read_volatile(STATE) }
    }

    fn sleep_until_received(&mut self) {
        while self.state() & RX_FULL == 0 {
            let before = clock::now();
            asm::wfi();
            clock::slept(before);
            self.watchdog.feed();
            SCB::clear_pendst();
            // SAFETY: clears the cause, then the pending mark; a byte that comes between sets both again.
            unsafe { write_volatile(INTCLEAR, CLEAR_RX_INTERRUPT) };
            NVIC::unpend(Received);
        }
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
        self.sleep_until_received();
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
