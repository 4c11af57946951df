//! Number formats and the few operations whose bits the whole project depends on.
//!
//! # Rules
//! - *Stored*: IEEE 754 binary16 ([`struct@f16`]). *Computed*: IEEE binary32, round to nearest even.
//! - A multiply-accumulate is [`mac`]: two roundings, product first. No operator uses a fused one, except where both factors are
//!   widened halves: such a product has 22 significant bits, is exact in binary32, and both forms give the same bits.
//! - Vector lanes run over independent outputs, never over a sum. A sum has one stated order.
//! - NaN never reaches a cast to an integer; it is refused at the door ([`crate::pipeline`]).
//!
//! This is the only module of the crate that may hold `unsafe` code: the loops that are written in the Cortex-M's instructions
//! (`arm`), and the choice of the instruction set at run time ([`simd`]).

#[cfg(all(target_arch = "arm", target_abi = "eabihf"))]
pub(crate) mod arm;
mod convert;
mod function;
pub mod fused;
pub mod pairs;
pub mod simd;

pub use convert::{narrow, narrow_slice, widen, widen_slice};
pub use function::{mac, max_finite, sigmoid};
pub use half::f16;
