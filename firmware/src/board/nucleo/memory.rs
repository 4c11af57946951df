//! Arenas and buffers in the sections of the memory map, and the memory that the program itself occupies.
#![allow(unsafe_code)] // sections and linker symbols

use super::camera::WORDS;
use crate::board::memory::{self, Once, Region};
use core::ops::Range;
use core::ptr::addr_of;
use half::f16;
use ommatidia_shared::device::{Footprint, Line};
use ommatidia_shared::wire::MAX_PACKET;

#[unsafe(link_section = ".sram.frames")]
static FRAMES: Region<u32, WORDS> = Region::new();
#[unsafe(link_section = ".sram.object")]
static OBJECT: Region<f16, { 96 * 96 }> = Region::new();
#[unsafe(link_section = ".axi.bulk")]
static BULK: Region<f16, { 256 << 10 }> = Region::new();
#[unsafe(link_section = ".uninit.fast")]
static FAST: Region<f32, { 24 << 10 }> = Region::new();
#[unsafe(link_section = ".uninit.line")]
static BUFFERS: Region<u32, { 2 * BUFFER / 4 }> = Region::new();
static LINE: Once = Once::new();

/// Length of the buffers of the serial line: a whole packet, which then arrives while the core is busy.
const BUFFER: usize = MAX_PACKET.next_multiple_of(32);

pub(super) fn line() -> &'static mut Line {
    // SAFETY: called once, from `super::take`.
    unsafe { LINE.take() }
}

/// Buffers for bytes to the host and from the host.
pub(super) fn line_buffers() -> [&'static mut [u8]; 2] {
    // SAFETY: called once, from `super::take`.
    let words = unsafe { BUFFERS.take() };
    let (send, receive) = bytemuck::cast_slice_mut(words).split_at_mut(BUFFER);
    [send, receive]
}

/// Memory of raw frames, two pixels in a word.
pub(super) fn frames() -> &'static mut [u32] {
    // SAFETY: called once, from `super::take`.
    unsafe { FRAMES.take() }
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
    static _flash_start: u8;
    static _flash_end: u8;
    static _dma_start: u8;
    static _dma_end: u8;
}

/// The memory that DMA writes.
pub(super) fn dma_range() -> Range<*const u8> {
    addr_of!(_dma_start)..addr_of!(_dma_end)
}

/// The sectors for network files.
pub(super) fn flash_range() -> Range<*const u8> {
    addr_of!(_flash_start)..addr_of!(_flash_end)
}

/// Memory that the program occupies. The image begins at the beginning of the flash.
pub fn footprint() -> Footprint {
    memory::footprint(0x0800_0000)
}
