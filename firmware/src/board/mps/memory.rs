//! What lies where: arenas and buffers in sections of `memory.x`, and how much the program itself takes.
#![allow(unsafe_code)] // sections and linker symbols

use super::map::MAP;
use core::cell::UnsafeCell;
use core::mem::MaybeUninit;
use core::ptr::{addr_of, addr_of_mut};
use half::f16;
use ommatidia_shared::device::{Footprint, Line};

/// Memory that no start-up code clears.
#[repr(C, align(32))]
struct Region<T, const N: usize>(UnsafeCell<MaybeUninit<[T; N]>>);

// SAFETY: each region is handed out once, through `super::take`; there is one thread.
unsafe impl<T, const N: usize> Sync for Region<T, N> {}

impl<T: bytemuck::Zeroable, const N: usize> Region<T, N> {
    const fn new() -> Self {
        Self(UnsafeCell::new(MaybeUninit::uninit()))
    }

    /// The region, cleared.
    ///
    /// # Safety
    /// Called once.
    #[allow(clippy::mut_from_ref)]
    unsafe fn take(&'static self) -> &'static mut [T; N] {
        // SAFETY: the caller calls once, so this is the only reference; all zeros is a value of T.
        unsafe {
            self.0.get().write_bytes(0, 1);
            (*self.0.get()).assume_init_mut()
        }
    }
}

#[unsafe(link_section = ".psram.frame")]
static FRAME: Region<u16, { 512 << 10 }> = Region::new();
#[unsafe(link_section = ".psram.object")]
static OBJECT: Region<f16, { 512 << 10 }> = Region::new();
#[unsafe(link_section = ".psram.bulk")]
static BULK: Region<f16, { 4 << 20 }> = Region::new();
#[unsafe(link_section = ".uninit.fast")]
static FAST: Region<f32, { MAP.fast_len }> = Region::new();
static LINE: Once = Once(UnsafeCell::new(Line::new()));

struct Once(UnsafeCell<Line>);

// SAFETY: as for `Region`.
unsafe impl Sync for Once {}

pub(super) fn line() -> &'static mut Line {
    // SAFETY: called once, from `super::take`.
    unsafe { &mut *LINE.0.get() }
}

/// The part of the PSRAM that plays the flash. It is neither loaded nor cleared, so it keeps what it holds over a reset, and under
/// QEMU, where a file can stand behind the PSRAM, over the end of the emulation.
pub(super) fn flash() -> &'static mut [u8] {
    let (start, end) = (addr_of_mut!(_flash_start), addr_of!(_flash_end));
    // SAFETY: called once, from `super::take`; `memory.x` keeps the bytes between the symbols free of anything else.
    unsafe { core::slice::from_raw_parts_mut(start, end.addr() - start.addr()) }
}

pub(super) fn frame() -> &'static mut [u16] {
    // SAFETY: called once, from `super::take`.
    unsafe { FRAME.take() }
}

pub(super) fn object() -> &'static mut [f16] {
    // SAFETY: called once, from `super::take`.
    unsafe { OBJECT.take() }
}

pub(super) fn bulk() -> &'static mut [f16] {
    // SAFETY: called once, from `super::take`.
    unsafe { BULK.take() }
}

pub(super) fn fast() -> &'static mut [f32] {
    // SAFETY: called once, from `super::take`.
    unsafe { FAST.take() }
}

unsafe extern "C" {
    static __sidata: u8;
    static __sdata: u8;
    static __edata: u8;
    static __sbss: u8;
    static __ebss: u8;
    static _stack_end: u32;
    static _stack_start: u32;
    static mut _flash_start: u8;
    static _flash_end: u8;
}

/// What the program takes. The image begins at address 0; its stack was painted before `main`.
pub fn footprint() -> Footprint {
    let at = |symbol: *const u8| symbol.addr() as u32;
    let (data, bss) = (at(addr_of!(__edata)) - at(addr_of!(__sdata)), at(addr_of!(__ebss)) - at(addr_of!(__sbss)));
    Footprint { image_bytes: at(addr_of!(__sidata)) + data, static_bytes: data + bss, stack_bytes: stack_depth() }
}

/// Bytes from the top of the stack down to the lowest word that was ever written.
fn stack_depth() -> u32 {
    let (mut word, top) = (addr_of!(_stack_end), addr_of!(_stack_start));
    // SAFETY: all words between the two symbols are memory of the stack.
    while word < top && unsafe { word.read_volatile() } == cortex_m_rt::STACK_PAINT_VALUE {
        word = word.wrapping_add(1);
    }
    (top.addr() - word.addr()) as u32
}
