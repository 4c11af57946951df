//! Routines in assembly, for instructions of the Cortex-M's floating-point unit (FPv4-SP, FPv5) that the compiler does
//! not use: conversions between halves and singles, loads and stores of many registers, the fused multiply-accumulate
//! for exact products, and the chained one (`vmla`, `vmls`: two roundings, as [`super::mac`]), with which a complex
//! product takes four instructions.
//!
//! Each routine declares the vector registers that it uses as clobbered. The compiler does not allow vector registers
//! as operands, so whole loops are in assembly.
//!
//! NaN: conversions keep sign and payload. Arithmetic returns only the default NaN, which is converted as [`super`]
//! defines.
#![allow(unsafe_code)]

#[macro_use]
mod macros;

mod columns;
mod convert;
#[cfg(not(feature = "helium"))]
mod correlate;
mod divide;
#[cfg(not(feature = "helium"))]
mod dual;
mod fft;
mod flags;
#[cfg(not(feature = "helium"))]
mod fused;
mod groups;
#[cfg(feature = "helium")]
pub(crate) mod helium;
mod rows;
mod window;

pub(super) use columns::{add_products, gather_pairs, scatter_pairs};
pub(super) use convert::{narrow, widen};
pub(super) use divide::divide;
pub(crate) use fft::transform;
pub(super) use flags::{narrow_whole, overflowed};
pub(crate) use groups::Groups;
pub(crate) use rows::{order_row, scale_row, tangle_row, untangle_row};
pub(crate) use window::Rows;

#[cfg(not(feature = "helium"))]
pub(crate) use correlate::{correlate1, correlate4};
#[cfg(not(feature = "helium"))]
pub(crate) use dual::{correlate_groups1, correlate_groups2};
#[cfg(feature = "helium")]
pub(super) use helium::{
    accumulate, add_eights, add_scaled, correct, count_from, extreme_halves, largest, narrow_relu, narrow_slice,
    round_interleaved, sigmoid, widen_alternate, widen_slice,
};
#[cfg(feature = "helium")]
pub(crate) use helium::{correlate1, correlate4};
#[cfg(not(feature = "helium"))]
pub(super) use {
    convert::{narrow_slice, widen_slice},
    fused::{accumulate, add_eights, add_scaled, narrow_relu, round_interleaved, widen_alternate},
};
