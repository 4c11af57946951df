//! I2C1 with a limit to every wait (ST RM0433, chapter 47). The driver of embassy-stm32 sets up pins and timing;
//! without its time driver it waits without end for a bus that is stuck, or whose sensor has no power.

use super::clock;
use embassy_stm32::Peri;
use embassy_stm32::gpio::{Input, Pull};
use embassy_stm32::i2c::{Config, I2c as Driver, Master};
use embassy_stm32::mode::Blocking;
use embassy_stm32::pac::I2C1;
use embassy_stm32::pac::i2c::regs::Isr;
use embassy_stm32::pac::i2c::vals::{Autoend, Dir};
use embassy_stm32::peripherals as p;
use embedded_hal::i2c::{ErrorKind, ErrorType, I2c, Operation};

/// Longest time for one transaction, us. The longest of a sensor, five bytes at 100 kHz, takes half a millisecond.
const LONGEST_US: u32 = 10_000;
/// Cycles in which the pull-ups charge the lines: at least 100 us.
const RISE: u32 = 48_000;

/// The bus.
pub(super) struct Bus {
    /// Keeps pins and clock configured.
    _driver: Driver<'static, Blocking, Master>,
}

impl Bus {
    /// `None` where a line stays low although it is pulled up: there is a short, or a chip without power.
    pub(super) fn new(
        i2c: Peri<'static, p::I2C1>,
        mut scl: Peri<'static, p::PB8>,
        mut sda: Peri<'static, p::PB9>,
    ) -> Option<Self> {
        {
            let (scl, sda) = (Input::new(scl.reborrow(), Pull::Up), Input::new(sda.reborrow(), Pull::Up));
            cortex_m::asm::delay(RISE);
            if scl.is_low() || sda.is_low() {
                return None;
            }
        }
        let mut config = Config::default();
        (config.scl_pullup, config.sda_pullup) = (true, true);
        Some(Self { _driver: Driver::new_blocking(i2c, scl, sda, config) })
    }
}

impl ErrorType for Bus {
    type Error = ErrorKind;
}

impl I2c for Bus {
    /// Each operation begins with a start condition, those of one kind in a row as well: no sensor here has such.
    fn transaction(&mut self, address: u8, operations: &mut [Operation<'_>]) -> Result<(), ErrorKind> {
        let (began, last) = (clock::now(), operations.len().saturating_sub(1));
        let mut operations = operations.iter_mut().enumerate();
        let done = operations.try_for_each(|(i, operation)| operate(address, operation, i == last, began));
        if done.is_err() {
            // Turned off and on, the controller releases the lines and forgets the transfer (section 47.4.6).
            I2C1.cr1().modify(|w| w.set_pe(false));
            let _off = I2C1.cr1().read();
            I2C1.cr1().modify(|w| w.set_pe(true));
        }
        done
    }
}

/// One operation of a transaction that began at clock `began`. The last one ends with a stop condition.
fn operate(address: u8, operation: &mut Operation<'_>, last: bool, began: u32) -> Result<(), ErrorKind> {
    let (dir, len) = match operation {
        Operation::Read(bytes) => (Dir::READ, bytes.len()),
        Operation::Write(bytes) => (Dir::WRITE, bytes.len()),
    };
    let len = u8::try_from(len).map_err(|_| ErrorKind::Other)?;
    I2C1.cr2().write(|w| {
        w.set_sadd(u16::from(address) << 1);
        w.set_dir(dir);
        w.set_nbytes(len);
        w.set_autoend(if last { Autoend::AUTOMATIC } else { Autoend::SOFTWARE });
        w.set_start(true);
    });
    match operation {
        Operation::Read(bytes) => {
            for byte in bytes.iter_mut() {
                wait(Isr::rxne, began)?;
                *byte = I2C1.rxdr().read().rxdata();
            }
        }
        Operation::Write(bytes) => {
            for byte in bytes.iter() {
                wait(Isr::txis, began)?;
                I2C1.txdr().write(|w| w.set_txdata(*byte));
            }
        }
    }
    if !last {
        return wait(Isr::tc, began);
    }
    wait(Isr::stopf, began)?;
    I2C1.icr().write(|w| w.set_stopcf(true));
    Ok(())
}

/// Waits for a flag, until the transaction that began at clock `began` has taken too long.
fn wait(flag: fn(&Isr) -> bool, began: u32) -> Result<(), ErrorKind> {
    loop {
        let status = I2C1.isr().read();
        if status.nackf() || status.berr() || status.arlo() {
            return Err(ErrorKind::Bus);
        }
        if flag(&status) {
            return Ok(());
        }
        if clock::now().wrapping_sub(began) > LONGEST_US {
            return Err(ErrorKind::Other);
        }
    }
}
