//! The program beside the sensor: frames in, reconstructions out.
//!
//! What the program does with each request of the host stands in [`ommatidia_shared::device`], which runs on the
//! workstation too. Here is what ties it to hardware: [`app`] puts the parts of a board together, [`board`] holds the
//! boards, one a module, [`camera`] the image sensors. Any UART with `embedded-io` and any pin with `embedded-hal` will do.
//!
//! Build the image of the default board with `cargo fw`; run it under QEMU with `cargo qemu --bin app`.
#![no_std]

pub mod app;
pub mod board;
pub mod camera;
mod log;
