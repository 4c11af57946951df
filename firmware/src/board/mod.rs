//! One board a module.

#[cfg(all(feature = "mps2-an500", target_os = "none"))]
pub mod mps2_an500;
