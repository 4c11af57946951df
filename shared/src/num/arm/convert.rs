//! Conversions between halves and singles.

use core::arch::asm;

use crate::num::f16;

/// Widens a half.
#[inline(always)]
pub(in crate::num) fn widen(value: f16) -> f32 {
    let mut bits = u32::from(value.to_bits());
    // SAFETY: touches nothing but the registers named.
    unsafe {
        asm!(
            "vmov s0, {bits}",
            "vcvtb.f32.f16 s0, s0",
            "vmov {bits}, s0",
            bits = inout(reg) bits,
            out("s0") _,
            options(pure, nomem, nostack, preserves_flags)
        );
    }
    f32::from_bits(bits)
}

/// Rounds to the nearest half.
#[inline(always)]
pub(in crate::num) fn narrow(value: f32) -> f16 {
    let mut bits = value.to_bits();
    // SAFETY: as above.
    unsafe {
        asm!(
            "vmov s0, {bits}",
            "vcvtb.f16.f32 s0, s0",
            "vmov {bits}, s0",
            bits = inout(reg) bits,
            out("s0") _,
            options(pure, nomem, nostack, preserves_flags)
        );
    }
    f16::from_bits(bits as u16)
}

/// Widens `from` into the equally long `to`; eight in twelve instructions.
#[cfg(not(feature = "helium"))]
pub(in crate::num) fn widen_slice(from: &[f16], to: &mut [f32]) {
    let len = from.len().min(to.len());
    let head = len.min(usize::from(!from.as_ptr().addr().is_multiple_of(4)));
    let blocks = (len - head) / 8;
    let tail = head + 8 * blocks;
    for i in (0..head).chain(tail..len) {
        to[i] = widen(from[i]);
    }
    if blocks == 0 {
        return;
    }
    // SAFETY: 8 * blocks numbers from `head` on lie in both slices; the halves are word-aligned there.
    unsafe {
        asm_low!(
            "2:",
            "vldmia {from}!, {{s8-s11}}",
            widen_eight!("s8" "s9" "s10" "s11" => "s0" "s1" "s2" "s3" "s4" "s5" "s6" "s7"),
            "vstmia {to}!, {{s0-s7}}",
            "subs {blocks}, #1",
            "bne 2b",
            from = inout(reg) from.as_ptr().add(head) => _,
            to = inout(reg) to.as_mut_ptr().add(head) => _,
            blocks = inout(reg) blocks => _,
        );
    }
}

/// Narrows `from` into the equally long `to`; eight in twelve instructions.
#[cfg(not(feature = "helium"))]
pub(in crate::num) fn narrow_slice(from: &[f32], to: &mut [f16]) {
    let len = from.len().min(to.len());
    let head = len.min(usize::from(!to.as_ptr().addr().is_multiple_of(4)));
    let blocks = (len - head) / 8;
    let tail = head + 8 * blocks;
    for i in (0..head).chain(tail..len) {
        to[i] = narrow(from[i]);
    }
    if blocks == 0 {
        return;
    }
    // SAFETY: 8 * blocks numbers from `head` on lie in both slices; the halves are word-aligned there.
    unsafe {
        asm_low!(
            "2:",
            "vldmia {from}!, {{s0-s7}}",
            narrow_eight!("s8" "s9" "s10" "s11"),
            "vstmia {to}!, {{s8-s11}}",
            "subs {blocks}, #1",
            "bne 2b",
            from = inout(reg) from.as_ptr().add(head) => _,
            to = inout(reg) to.as_mut_ptr().add(head) => _,
            blocks = inout(reg) blocks => _,
        );
    }
}
