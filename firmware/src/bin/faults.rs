//! Reads an address without memory: first with faults masked, which only says so, then without, which resets the board
//! again and again until a start finds that starts keep ending in faults. The second start ends by a stack too deep.
#![no_std]
#![no_main]
#![allow(unsafe_code)] // reads that fail

use cortex_m_semihosting::hprintln;
use ommatidia_firmware::board::this as board;

#[cortex_m_rt::entry]
fn main() -> ! {
    let start = board::start();
    hprintln!("start {} by {:?}", start.count, start.cause);
    if start.keeps_faulting {
        hprintln!("keeps faulting");
        board::exit()
    }
    if start.count == 2 {
        hprintln!("depth {}", deeper(0));
    }
    let variable = 7_u32;
    hprintln!("memory can be read: {}", board::readable((&raw const variable).addr()));
    hprintln!("nothing can be read: {}", board::readable(board::NOTHING));
    // SAFETY: the read fails, which is what is tried.
    let word = unsafe { (board::NOTHING as *const u32).read_volatile() };
    hprintln!("read {}", word);
    board::exit()
}

/// Fills the stack.
#[inline(never)]
#[allow(unconditional_recursion)]
fn deeper(depth: u32) -> u32 {
    let frame = core::hint::black_box([depth; 64]);
    deeper(depth + 1) + frame[63]
}
