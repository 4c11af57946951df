//! What host and device compute alike.
//!
//! `no_std`, no allocator, no global state. Weights, activations and spectra are *stored* in IEEE half
//! precision; all arithmetic is IEEE single precision, round to nearest even, in one stated order per
//! operator, so that a workstation and a microcontroller give the same bits.
#![no_std]
#![warn(missing_docs)]

pub mod blob;
pub mod boards;
pub mod device;
pub mod fft;
pub mod filter;
pub mod flash;
pub mod image;
pub mod nn;
pub mod num;
pub mod pipeline;
pub mod sensor;
pub mod wire;

#[cfg(test)]
mod naive;
