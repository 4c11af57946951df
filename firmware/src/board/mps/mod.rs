//! Arm's MPS2 and MPS3 boards with an FPGA image of one core: memories, a UART, an LED. QEMU emulates each under the
//! name of its feature.

mod clock;
mod led;
mod map;
mod memory;
mod uart;
mod watchdog;

pub use led::Led;
pub use memory::footprint;
pub use uart::Uart;
pub use watchdog::{Dog, start_cause};

use crate::app::Parts;
use core::sync::atomic::{AtomicBool, Ordering};
use cortex_m::peripheral::DWT;
use cortex_m_semihosting::{debug, hprintln};
use ommatidia_shared::device::{Arenas, RamFrame};
use ommatidia_shared::flash::RamFlash;

/// Name of the board.
pub const NAME: &str = map::BOARD.name;

/// The parts of the board. `None` where they were taken before.
pub fn take() -> Option<Parts<'static, Uart, Led, RamFlash<'static>, Dog, RamFrame<'static>>> {
    static TAKEN: AtomicBool = AtomicBool::new(false);
    if TAKEN.swap(true, Ordering::Relaxed) {
        return None;
    }
    clock::begin();
    let watchdog = Dog::new(watchdog::PATIENCE_S);
    Some(Parts {
        name: NAME,
        link: Uart::new(watchdog),
        line: memory::line(),
        trigger: Led::new(),
        watchdog,
        started_by: start_cause(),
        footprint,
        cycles,
        // The board has no sensor.
        temperature_cdeg: || None,
        activity: clock::activity,
        flash: RamFlash::new(memory::flash()),
        source: RamFrame::new(memory::frame()),
        object: memory::object(),
        arenas: Arenas { fast: memory::fast(), bulk: memory::bulk() },
    })
}

/// The cycle counter of the core, where it counts: under QEMU it does not.
fn cycles() -> Option<u32> {
    let count = DWT::cycle_count();
    (count != 0).then_some(count)
}

/// Ends the emulation with exit code 0.
pub fn exit() -> ! {
    debug::exit(debug::EXIT_SUCCESS);
    halt()
}

/// Prints the reason and ends the emulation with exit code 1.
pub fn fail(reason: &dyn core::fmt::Display) -> ! {
    hprintln!("{}", reason);
    debug::exit(debug::EXIT_FAILURE);
    halt()
}

fn halt() -> ! {
    loop {
        cortex_m::asm::wfi();
    }
}

#[panic_handler]
fn panic(info: &core::panic::PanicInfo<'_>) -> ! {
    fail(info)
}
