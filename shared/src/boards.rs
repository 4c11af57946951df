//! The boards that the firmware is built for.

/// A board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Board {
    /// Its name: the feature of the firmware, QEMU's machine, and what the device says of itself.
    pub name: &'static str,
    /// Its core.
    pub core: &'static str,
    /// The compiler's target.
    pub target: &'static str,
    /// What the compiler is told of the core, beyond the target.
    pub rustflags: &'static [&'static str],
    /// Whether QEMU emulates it.
    pub emulated: bool,
    /// Of the emulated memory the block that can stand in a file; the flash with the network files is the first part of it.
    pub memory_bytes: u64,
}

/// Cortex-M7: the board that is taken where none is named.
pub const MPS2_AN500: Board = Board {
    name: "mps2-an500",
    core: "Cortex-M7",
    target: "thumbv7em-none-eabihf",
    rustflags: &[],
    emulated: true,
    memory_bytes: 16 << 20,
};

/// Cortex-M55 with Helium. The compiler's own vector loops are off: vectors flush subnormal numbers to zero, which only the routines
/// written for it take account of.
pub const MPS3_AN547: Board = Board {
    name: "mps3-an547",
    core: "Cortex-M55",
    target: "thumbv8m.main-none-eabihf",
    rustflags: &["-C", "target-cpu=cortex-m55", "-C", "no-vectorize-loops", "-C", "no-vectorize-slp"],
    emulated: true,
    memory_bytes: 2 << 30,
};

/// Cortex-M4F, the core of the wire-free miniscopes on heads today.
pub const MPS2_AN386: Board = Board {
    name: "mps2-an386",
    core: "Cortex-M4F",
    target: "thumbv7em-none-eabihf",
    rustflags: &["-C", "target-cpu=cortex-m4"],
    emulated: true,
    memory_bytes: 16 << 20,
};

/// A board that can be bought, with an image sensor: STM32H743ZI.
pub const NUCLEO_H743ZI: Board = Board {
    name: "nucleo-h743zi",
    core: "Cortex-M7",
    target: "thumbv7em-none-eabihf",
    rustflags: &[],
    emulated: false,
    memory_bytes: 0,
};

/// All boards.
pub const BOARDS: [Board; 4] = [MPS2_AN500, MPS3_AN547, MPS2_AN386, NUCLEO_H743ZI];

impl Board {
    /// The board of that name.
    pub fn named(name: &str) -> Option<Self> {
        BOARDS.into_iter().find(|board| board.name == name)
    }
}
