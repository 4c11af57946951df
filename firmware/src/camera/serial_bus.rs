//! The serial bus of onsemi's PYTHON sensors: 9 bits of address, a bit that is 1 for a write, 16 bits of data, high
//! bits first. 26 bits are no whole bytes, so the pins are moved one by one.
//!
//! Source: the UCLA Miniscope's firmware, `SPI_BB_PYTHON480.c` (github.com/Aharoni-Lab/Miniscope-v4-Wire-Free).

use embedded_hal::delay::DelayNs;
use embedded_hal::digital::{InputPin, OutputPin};

/// Half a clock, us: 50,000 bits a second.
const HALF_US: u32 = 10;

/// Registers of 16 bits.
pub trait Registers {
    /// Errors of the bus.
    type Error;

    /// Writes a register.
    ///
    /// # Errors
    /// Those of the bus.
    fn write(&mut self, register: u16, value: u16) -> Result<(), Self::Error>;

    /// Reads a register.
    ///
    /// # Errors
    /// Those of the bus.
    fn read(&mut self, register: u16) -> Result<u16, Self::Error>;

    /// Waits.
    fn wait_ms(&mut self, ms: u32);
}

/// The pins of the bus.
#[derive(Debug)]
pub struct SerialBus<S, C, O, I, D> {
    /// Chip select, low during a transfer.
    pub select: S,
    /// Clock, low between transfers.
    pub clock: C,
    /// To the sensor, which takes bits when the clock rises.
    pub out: O,
    /// From the sensor.
    pub input: I,
    /// Waits.
    pub delay: D,
}

impl<E, S, C, O, I, D> SerialBus<S, C, O, I, D>
where
    S: OutputPin<Error = E>,
    C: OutputPin<Error = E>,
    O: OutputPin<Error = E>,
    I: InputPin<Error = E>,
    D: DelayNs,
{
    /// Sends the low `count` bits of `bits`.
    fn send(&mut self, bits: u32, count: u32) -> Result<(), E> {
        for bit in (0..count).rev() {
            self.out.set_state((bits >> bit & 1 == 1).into())?;
            self.half()?;
            self.clock.set_low()?;
        }
        Ok(())
    }

    /// The clock rises after half a period, and may fall after another one.
    fn half(&mut self) -> Result<(), E> {
        self.delay.delay_us(HALF_US);
        self.clock.set_high()?;
        self.delay.delay_us(HALF_US);
        Ok(())
    }

    fn selected<R>(&mut self, transfer: impl FnOnce(&mut Self) -> Result<R, E>) -> Result<R, E> {
        self.select.set_low()?;
        self.delay.delay_us(HALF_US);
        let done = transfer(self);
        self.delay.delay_us(HALF_US);
        self.select.set_high()?;
        self.delay.delay_us(HALF_US);
        done
    }
}

impl<E, S, C, O, I, D> Registers for SerialBus<S, C, O, I, D>
where
    S: OutputPin<Error = E>,
    C: OutputPin<Error = E>,
    O: OutputPin<Error = E>,
    I: InputPin<Error = E>,
    D: DelayNs,
{
    type Error = E;

    fn write(&mut self, register: u16, value: u16) -> Result<(), E> {
        let bits = u32::from(register & 0x1ff) << 17 | 1 << 16 | u32::from(value);
        self.selected(|bus| bus.send(bits, 26))
    }

    fn read(&mut self, register: u16) -> Result<u16, E> {
        self.selected(|bus| {
            bus.send(u32::from(register & 0x1ff) << 1, 10)?;
            let mut value = 0;
            for _ in 0..16 {
                bus.half()?;
                bus.clock.set_low()?;
                bus.delay.delay_us(HALF_US);
                value = value << 1 | u16::from(bus.input.is_high()?);
            }
            Ok(value)
        })
    }

    fn wait_ms(&mut self, ms: u32) {
        self.delay.delay_ms(ms);
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use embedded_hal_mock::eh1::delay::NoopDelay;
    use embedded_hal_mock::eh1::digital::{Mock, State, Transaction};
    use std::vec::Vec;

    fn levels(levels: &[bool]) -> Vec<Transaction> {
        levels.iter().map(|high| Transaction::set(if *high { State::High } else { State::Low })).collect()
    }

    /// The bits of a text of zeros and ones.
    fn bits(text: &str) -> Vec<bool> {
        text.chars().filter(|c| *c != ' ').map(|c| c == '1').collect()
    }

    /// A bus on which each bit of `out` goes to the sensor and each of `input` comes from it.
    fn bus(out: &str, input: &str) -> SerialBus<Mock, Mock, Mock, Mock, NoopDelay> {
        let (out, input) = (bits(out), bits(input));
        let state = |high: &bool| Transaction::get(if *high { State::High } else { State::Low });
        let set = out.iter().map(|high| Transaction::set(if *high { State::High } else { State::Low }));
        SerialBus {
            select: Mock::new(&levels(&[false, true])),
            clock: Mock::new(&levels(&[true, false].repeat(out.len() + input.len()))),
            out: Mock::new(&set.collect::<Vec<_>>()),
            input: Mock::new(&input.iter().map(state).collect::<Vec<_>>()),
            delay: NoopDelay::new(),
        }
    }

    fn done(bus: SerialBus<Mock, Mock, Mock, Mock, NoopDelay>) {
        for mut pin in [bus.select, bus.clock, bus.out, bus.input] {
            pin.done();
        }
    }

    #[test]
    fn a_write_is_an_address_a_one_and_a_word() {
        // 204 = 0 1100 1100, 0x00e4.
        let mut bus = bus("011001100 1 0000000011100100", "");
        bus.write(204, 0x00e4).unwrap();
        done(bus);
    }

    #[test]
    fn a_read_is_an_address_a_zero_and_a_word_from_the_sensor() {
        let mut bus = bus("100000001 0", "1010000000000011");
        assert_eq!(bus.read(257).unwrap(), 0xa003);
        done(bus);
    }
}
