//! One board, or one family of boards, a module; [`this`] is the one that the program is built for.

#[cfg(all(any(feature = "mps2-an500", feature = "mps3-an547", feature = "mps2-an386"), target_os = "none"))]
pub mod mps;
#[cfg(all(any(feature = "mps2-an500", feature = "mps3-an547", feature = "mps2-an386"), target_os = "none"))]
pub use mps as this;
