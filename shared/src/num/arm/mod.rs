//! The instructions of the Cortex-M's floating-point unit (FPv4-SP, FPv5) that the language does not reach: conversions between
//! halves and singles, loads and stores of many registers, the fused multiply-accumulate for exact products, and the chained one
//! (`vmla`, `vmls`: two roundings, as [`super::mac`]) that makes a complex product four instructions.
//!
//! Each routine names the vector registers that it uses as clobbered, which is all that the compiler lets it do with them. Loops
//! stand in assembly as a whole, because no value can be handed over in a vector register.
//! NaN: the unit keeps sign and payload. Arithmetic only makes the default NaN, which converts as the rest of [`super`] says.
#![allow(unsafe_code)]

mod columns;
mod convert;
#[cfg(not(feature = "helium"))]
mod correlate;
mod divide;
mod fft;
#[cfg(not(feature = "helium"))]
mod fused;
#[cfg(feature = "helium")]
pub(crate) mod helium;
mod rows;
mod window;

pub(super) use columns::{add_products, gather_pairs, scatter_pairs};
pub(super) use convert::{narrow, widen};
pub(super) use divide::divide;
pub(crate) use fft::transform;
pub(crate) use rows::{order_row, scale_row, tangle_row, untangle_row};
pub(crate) use window::Rows;

#[cfg(not(feature = "helium"))]
pub(crate) use correlate::{correlate1, correlate4};
#[cfg(feature = "helium")]
pub(super) use helium::{
    accumulate, add_eights, add_scaled, narrow_relu, narrow_slice, round_interleaved, widen_alternate, widen_slice,
};
#[cfg(feature = "helium")]
pub(crate) use helium::{correlate1, correlate4};
#[cfg(not(feature = "helium"))]
pub(super) use {
    convert::{narrow_slice, widen_slice},
    fused::{accumulate, add_eights, add_scaled, narrow_relu, round_interleaved, widen_alternate},
};

/// `asm!` that clobbers s0-s15, which no caller expects to be kept.
macro_rules! asm_low {
    ($($item:tt)*) => {
        core::arch::asm!(
            $($item)*
            out("d0") _, out("d1") _, out("d2") _, out("d3") _, out("d4") _, out("d5") _, out("d6") _, out("d7") _,
            options(nostack)
        )
    };
}

/// `asm!` that clobbers every vector register.
macro_rules! asm_all {
    ($($item:tt)*) => {
        core::arch::asm!(
            $($item)*
            out("d0") _, out("d1") _, out("d2") _, out("d3") _, out("d4") _, out("d5") _, out("d6") _, out("d7") _,
            out("d8") _, out("d9") _, out("d10") _, out("d11") _, out("d12") _, out("d13") _, out("d14") _, out("d15") _,
            options(nostack)
        )
    };
}

use {asm_all, asm_low};
