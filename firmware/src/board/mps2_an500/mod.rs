//! ARM MPS2 with FPGA image AN500 (ARM DAI 0500): Cortex-M7, three memories, a UART. QEMU calls it `mps2-an500`.

mod led;
mod memory;
mod uart;

pub use led::Led;
pub use memory::footprint;
pub use uart::Uart;

use crate::app::Parts;
use core::sync::atomic::{AtomicBool, Ordering};
use cortex_m_semihosting::{debug, hprintln};
use ommatidia_shared::device::Arenas;

/// Name of the board.
pub const NAME: &str = "mps2-an500";

/// The parts of the board, once.
pub fn take() -> Option<Parts<'static, Uart, Led>> {
    static TAKEN: AtomicBool = AtomicBool::new(false);
    if TAKEN.swap(true, Ordering::Relaxed) {
        return None;
    }
    Some(Parts {
        name: NAME,
        link: Uart::new(),
        line: memory::line(),
        trigger: Led::new(),
        footprint,
        blob: memory::blob(),
        frame: memory::frame(),
        object: memory::object(),
        arenas: Arenas { fast: memory::fast(), bulk: memory::bulk() },
    })
}

/// Ends the emulation with exit code 0.
pub fn exit() -> ! {
    debug::exit(debug::EXIT_SUCCESS);
    halt()
}

/// Prints what went wrong and ends the emulation with exit code 1.
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
