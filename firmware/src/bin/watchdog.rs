//! Hangs once, so that a test can check that the watchdog resets the board. The next start prints its cause and ends.
#![no_std]
#![no_main]

use cortex_m_semihosting::hprintln;
use ommatidia_firmware::board::this as board;
use ommatidia_shared::device::Watchdog;
use ommatidia_shared::wire::StartCause;

#[cortex_m_rt::entry]
fn main() -> ! {
    match board::start().cause {
        StartCause::Power => {
            hprintln!("started by power");
            board::Dog::new(1).start();
            loop {
                cortex_m::asm::nop();
            }
        }
        StartCause::Watchdog => {
            hprintln!("started by the watchdog");
            board::exit()
        }
        StartCause::Fault => board::fail(&"a fault instead of a hang"),
    }
}
