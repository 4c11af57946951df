//! The boards: one module for each board or family of boards. `this` is the one that the program is built for.

#[cfg(any(test, all(feature = "board", target_os = "none")))]
mod activity;
#[cfg(all(feature = "board", target_os = "none"))]
mod float;
#[cfg(all(feature = "board", target_os = "none"))]
mod guard;
#[cfg(all(feature = "board", target_os = "none"))]
mod masked;
#[cfg(all(feature = "board", target_os = "none"))]
mod memory;
#[cfg(all(feature = "emulated", target_os = "none"))]
pub mod mps;
#[cfg(all(feature = "nucleo-h743zi", target_os = "none"))]
pub mod nucleo;
#[cfg(all(feature = "board", target_os = "none"))]
mod restart;

#[cfg(all(feature = "emulated", target_os = "none"))]
pub use mps as this;
#[cfg(all(feature = "nucleo-h743zi", not(feature = "emulated"), target_os = "none"))]
pub use nucleo as this;
