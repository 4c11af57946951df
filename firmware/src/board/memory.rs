//! Memory of the boards: sections that the start-up code does not initialize, and the depth of the stack.
#![allow(unsafe_code)] // sections and linker symbols

use core::cell::UnsafeCell;
use core::mem::MaybeUninit;
use core::ptr::addr_of;
use ommatidia_shared::device::{Footprint, Line};

/// Memory that the start-up code does not initialize.
#[repr(C, align(32))]
pub(super) struct Region<T, const N: usize>(UnsafeCell<MaybeUninit<[T; N]>>);

// SAFETY: each region is borrowed once, in the `take` of the board; there is one thread.
unsafe impl<T, const N: usize> Sync for Region<T, N> {}

// Helium gathers words: all arenas begin at one, whatever a part of them begins at.
const _: () = assert!(align_of::<Region<u16, 1>>() >= ommatidia_shared::blob::ALIGN);

impl<T: bytemuck::Zeroable, const N: usize> Region<T, N> {
    pub(super) const fn new() -> Self {
        Self(UnsafeCell::new(MaybeUninit::uninit()))
    }

    /// Borrows the region, filled with zeros.
    ///
    /// # Safety
    /// Must be called only once.
    #[allow(clippy::mut_from_ref)]
    pub(super) unsafe fn take(&'static self) -> &'static mut [T; N] {
        // SAFETY: the caller calls once, so this is the only reference; all zeros is a value of T.
        unsafe {
            self.0.get().write_bytes(0, 1);
            (*self.0.get()).assume_init_mut()
        }
    }
}

/// The buffers of the line.
pub(super) struct Once(UnsafeCell<Line>);

// SAFETY: as for `Region`.
unsafe impl Sync for Once {}

impl Once {
    pub(super) const fn new() -> Self {
        Self(UnsafeCell::new(Line::new()))
    }

    /// Borrows the buffers.
    ///
    /// # Safety
    /// Must be called only once.
    #[allow(clippy::mut_from_ref)]
    pub(super) unsafe fn take(&'static self) -> &'static mut Line {
        // SAFETY: the caller calls once.
        unsafe { &mut *self.0.get() }
    }
}

unsafe extern "C" {
    static __sidata: u8;
    static __sdata: u8;
    static __edata: u8;
    static __sbss: u8;
    static __ebss: u8;
    static _stack_end: u32;
    static _stack_start: u32;
}

/// Memory that the program occupies. `image` is the address of the image. The stack was painted before `main`.
pub(super) fn footprint(image: u32) -> Footprint {
    let at = |symbol: *const u8| symbol.addr() as u32;
    let (data, bss) = (at(addr_of!(__edata)) - at(addr_of!(__sdata)), at(addr_of!(__ebss)) - at(addr_of!(__sbss)));
    Footprint {
        image_bytes: at(addr_of!(__sidata)) - image + data,
        static_bytes: data + bss,
        stack_bytes: stack_depth(),
    }
}

/// Bytes from the top of the stack to the lowest word that was ever written.
fn stack_depth() -> u32 {
    let (mut word, top) = (addr_of!(_stack_end), addr_of!(_stack_start));
    // SAFETY: all words between the two symbols are memory of the stack.
    while word < top && unsafe { word.read_volatile() } == cortex_m_rt::STACK_PAINT_VALUE {
        word = word.wrapping_add(1);
    }
    (top.addr() - word.addr()) as u32
}
