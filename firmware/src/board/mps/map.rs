//! The differences between the boards of the family.

#[cfg(any(
    all(feature = "mps2-an500", feature = "mps3-an547"),
    all(feature = "mps2-an500", feature = "mps2-an386"),
    all(feature = "mps3-an547", feature = "mps2-an386"),
    feature = "nucleo-h743zi"
))]
compile_error!("the programs are built for one board: choose one of its features");

use ommatidia_shared::boards;

#[cfg(feature = "mps2-an500")]
pub(super) const BOARD: boards::Board = boards::MPS2_AN500;
#[cfg(feature = "mps3-an547")]
pub(super) const BOARD: boards::Board = boards::MPS3_AN547;
#[cfg(feature = "mps2-an386")]
pub(super) const BOARD: boards::Board = boards::MPS2_AN386;

/// Addresses and numbers that differ between the boards.
pub(super) struct Map {
    /// Address of UART 0.
    pub(super) uart: usize,
    /// Number of its receive interrupt.
    pub(super) received: u16,
    /// Address of the register of the LEDs.
    pub(super) leds: usize,
    /// Address of the watchdog.
    pub(super) watchdog: usize,
    /// Clock of the watchdog, Hz.
    pub(super) watchdog_hz: u32,
    /// Length of fast scratch, numbers.
    pub(super) fast_len: usize,
    /// An address without memory.
    pub(super) nothing: usize,
}

/// MPS2 (ARM DAI 0500 and 0386, memory map and interrupts). The scratch is the 512 KB of tightly coupled memory of an
/// i.MX RT1176.
#[cfg(not(feature = "mps3-an547"))]
pub(super) const MAP: Map = Map {
    uart: 0x4000_4000,
    received: 0,
    leds: 0x4002_8000,
    watchdog: 0x4000_8000,
    watchdog_hz: 25_000_000,
    fast_len: 128 << 10,
    nothing: 0x9000_0000,
};

/// MPS3 (ARM DAI 0547, tables 3-1 and 5-1). The scratch leaves room for the program's own data in the 512 KB of the
/// DTCM.
#[cfg(feature = "mps3-an547")]
pub(super) const MAP: Map = Map {
    uart: 0x4930_3000,
    received: 33,
    leds: 0x4930_2000,
    watchdog: 0x4802_e000,
    watchdog_hz: 32_768,
    fast_len: 96 << 10,
    nothing: 0x0f00_0000,
};
