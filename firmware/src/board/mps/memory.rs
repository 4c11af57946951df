//! Arenas and buffers in the sections of the memory map, and the memory that the program itself occupies.
#![allow(unsafe_code)] // sections and linker symbols

use super::map::MAP;
use crate::board::memory::{self, Once, Region};
use core::ptr::{addr_of, addr_of_mut};
use half::f16;
use ommatidia_shared::device::{Footprint, Line};

#[unsafe(link_section = ".psram.frame")]
static FRAME: Region<u16, { 512 << 10 }> = Region::new();
#[unsafe(link_section = ".psram.object")]
static OBJECT: Region<f16, { 512 << 10 }> = Region::new();
#[unsafe(link_section = ".psram.bulk")]
static BULK: Region<f16, { 4 << 20 }> = Region::new();
#[unsafe(link_section = ".uninit.fast")]
static FAST: Region<f32, { MAP.fast_len }> = Region::new();
static LINE: Once = Once::new();

pub(super) fn line() -> &'static mut Line {
    // SAFETY: called once, from `super::take`.
    unsafe { LINE.take() }
}

/// The part of the PSRAM that is used as flash. The start-up code does not initialize it, so it keeps its content over
/// a reset. Under QEMU a file can back the PSRAM, and the content is kept when the emulation ends.
pub(super) fn flash() -> &'static mut [u8] {
    let (start, end) = (addr_of_mut!(_flash_start), addr_of!(_flash_end));
    // SAFETY: called once, from `super::take`; the memory map puts nothing else between the symbols.
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
    static mut _flash_start: u8;
    static _flash_end: u8;
}

/// Memory that the program occupies. The image begins at address 0.
pub fn footprint() -> Footprint {
    memory::footprint(0)
}
