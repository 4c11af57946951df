//! ARM MPS2 with FPGA image AN500: Cortex-M7, three memories, a UART. What QEMU calls `mps2-an500`.

mod uart;

pub use uart::Uart;

/// x
pub fn uart() -> Uart { Uart::new() }
