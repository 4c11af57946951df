//! The program of the microcontroller beside the sensor: it turns raw frames into reconstructions.
//!
//! [`ommatidia_shared::device`] defines how the program handles each request of the host; it also runs on the
//! workstation. This crate connects it to hardware: [`app`] puts the parts of a board together, [`board`] has a module
//! for each board or family of boards, and [`camera`] has the image sensors. Any UART with `embedded-io` and any pin
//! with `embedded-hal` can be used.
//!
//! Build the image of the default board with `cargo fw`; run it under QEMU with `cargo qemu --bin app`.
#![no_std]

pub mod app;
pub mod board;
pub mod camera;
mod log;
pub mod numbers;
pub mod start;
