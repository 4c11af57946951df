//! The part of Ommatidia that the workstation and the microcontroller share: the network and its kernels, the network
//! file, the messages between host and device, and the device's program without its board.
//!
//! `no_std`, no allocator, no global state. Weights, activations and spectra are *stored* in IEEE half precision. All
//! arithmetic is IEEE single precision, round to nearest even, in one stated order per operator. A workstation and a
//! microcontroller therefore compute the same bits.
//!
//! Where to begin: [`blob::Network::decode`] reads a network file, [`pipeline::Pipeline`] runs it on raw frames,
//! [`device::Device`] serves it over a line. [`fft`], [`filter`], [`nn`] and [`sensor`] hold the operators, [`num`] the
//! number formats.
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
pub mod predict;
pub mod sensor;
pub mod watch;
pub mod wire;

#[cfg(test)]
mod naive;
