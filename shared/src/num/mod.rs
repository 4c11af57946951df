//! Number formats, and the basic operations that every operator uses.
//!
//! # Rules
//! - Numbers are *stored* as IEEE 754 binary16 ([`struct@f16`], here called halves) and *computed* in IEEE binary32,
//!   round to nearest even.
//! - A multiply-accumulate is [`mac`]: two roundings, product first. Operators use a fused one only where both factors
//!   are widened halves. Such a product has 22 significant bits and is exact in binary32, so both forms give the same
//!   bits.
//! - Vector lanes run over independent outputs, never over a sum. A sum has one stated order.
//! - No infinity and no NaN is ever stored as a feature: a [`crate::blob::Network`] has finite weights only, filter
//!   outputs that are not finite are replaced by zeros, and features saturate at the largest half ([`fused`]). So NaN
//!   never reaches a comparison or a cast to an integer, where targets differ.
//!
//! ```
//! use ommatidia_shared::num::{f16, mac, max_finite, narrow, sigmoid, widen};
//!
//! assert_eq!(widen(narrow(0.1)), 0.099975586, "the nearest half");
//! assert_eq!(narrow(65_520.0), f16::INFINITY);
//! assert_eq!(mac(3.0, 4.0, 5.0), 17.0);
//! assert_eq!(max_finite(&[f16::ONE, f16::NEG_ONE]), (1.0, true));
//! assert_eq!(sigmoid(0.0), 0.5);
//! assert!((sigmoid(2.0) - 0.880797).abs() < 1.8e-4);
//! ```
//!
//! This is the only module of the crate with `unsafe` code: the loops in the Cortex-M's instructions (`arm`), and the
//! choice of the instruction set at run time ([`simd`]).

#[cfg(all(target_arch = "arm", feature = "fpv4"))]
pub(crate) mod arm;
mod convert;
mod function;
pub mod fused;
pub mod pairs;
pub mod simd;

pub use convert::{narrow, narrow_slice, widen, widen_slice};
#[cfg(all(target_arch = "arm", feature = "helium"))]
use function::{SATURATED, exp_is_e};
pub use function::{count_from, largest, mac, max_finite, sigmoid, sigmoid_slice};
pub use half::f16;
