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
pub use watchdog::Dog;

use super::{float, guard, masked, restart};
use crate::app::Parts;
use crate::start::Start;
use core::sync::atomic::{AtomicBool, Ordering};
use cortex_m::peripheral::DWT;
use cortex_m_semihosting::{debug, hprintln};
use ommatidia_shared::device::{Arenas, Clock, VirtualCamera};
use ommatidia_shared::flash::RamFlash;

/// Name of the board.
pub const NAME: &str = map::BOARD.name;

/// Rows and columns of the frames of the virtual camera at first.
const CAMERA: [u16; 2] = [428, 428];
const CLOCK: Clock = Clock { now_us: clock::now_us, pause: core::hint::spin_loop };

/// The parts of the board. `None` where they were taken before.
pub fn take() -> Option<Parts<'static, Uart, Led, RamFlash<'static>, Dog, VirtualCamera<'static>>> {
    static TAKEN: AtomicBool = AtomicBool::new(false);
    if TAKEN.swap(true, Ordering::Relaxed) {
        return None;
    }
    if !float::set_mode() {
        fail(&"the floating-point unit does not round as IEEE 754 says");
    }
    clock::begin();
    let watchdog = Dog::new(watchdog::PATIENCE_S);
    Some(Parts {
        name: NAME,
        link: Uart::new(watchdog),
        line: memory::line(),
        trigger: Led::new(),
        watchdog,
        start: start(),
        // An emulated core has no clock.
        core_mhz: None,
        footprint,
        cycles,
        // The board has no sensor.
        temperature_cdeg: || None,
        activity: clock::activity,
        flash: RamFlash::new(memory::flash()),
        source: VirtualCamera::new(memory::frame(), CAMERA, CLOCK),
        object: memory::object(),
        arenas: Arenas { fast: memory::fast(), bulk: memory::bulk() },
    })
}

/// How the program was started. From here on a stack too deep is a fault. To be called once.
pub fn start() -> Start {
    guard::begin();
    // The watchdog resets this board through the program, which leaves a note.
    restart::begin(false)
}

/// An address without memory.
pub const NOTHING: usize = map::MAP.nothing;

/// Whether the word at the address `at`, of memory or of nothing, can be read.
#[allow(unsafe_code)]
pub fn readable(at: usize) -> bool {
    // SAFETY: reading memory has no effect. The one register here that has one, that of the UART, is not called for.
    unsafe { masked::readable(at as *const u32) }
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
