//! The boards that the firmware is built for.

/// A board and how the firmware is built for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Board {
    /// Name: of the board, of the firmware's feature, and of QEMU's machine.
    pub name: &'static str,
    /// Processor core.
    pub core: &'static str,
    /// Target triple of the compiler.
    pub target: &'static str,
    /// Compiler flags for the core, besides the target.
    pub rustflags: &'static [&'static str],
    /// Whether QEMU emulates the board.
    pub emulated: bool,
    /// Size of the emulated memory that a file can back, bytes. The flash with the network files is the first part of
    /// it. 0 without an emulator.
    pub memory_bytes: u64,
}

/// Arm MPS2 with FPGA image AN500, a Cortex-M7: the default board.
pub const MPS2_AN500: Board = Board {
    name: "mps2-an500",
    core: "Cortex-M7",
    target: "thumbv7em-none-eabihf",
    rustflags: &[],
    emulated: true,
    memory_bytes: 16 << 20,
};

/// Arm MPS3 with FPGA image AN547, a Cortex-M55 with the vector extension Helium. Helium flushes subnormal numbers to
/// zero, which only the routines written for it allow for. So the compiler must not make vector loops of its own.
pub const MPS3_AN547: Board = Board {
    name: "mps3-an547",
    core: "Cortex-M55",
    target: "thumbv8m.main-none-eabihf",
    rustflags: &["-C", "target-cpu=cortex-m55", "-C", "no-vectorize-loops", "-C", "no-vectorize-slp"],
    emulated: true,
    memory_bytes: 2 << 30,
};

/// Arm MPS2 with FPGA image AN386, a Cortex-M4F: the core of today's wire-free miniscopes.
pub const MPS2_AN386: Board = Board {
    name: "mps2-an386",
    core: "Cortex-M4F",
    target: "thumbv7em-none-eabihf",
    rustflags: &["-C", "target-cpu=cortex-m4"],
    emulated: true,
    memory_bytes: 16 << 20,
};

/// ST NUCLEO-H743ZI2 (STM32H743ZI, a Cortex-M7) with an image sensor.
pub const NUCLEO_H743ZI: Board = Board {
    name: "nucleo-h743zi",
    core: "Cortex-M7",
    target: "thumbv7em-none-eabihf",
    rustflags: &[],
    emulated: false,
    memory_bytes: 0,
};

/// All boards, the default one first.
pub const BOARDS: [Board; 4] = [MPS2_AN500, MPS3_AN547, MPS2_AN386, NUCLEO_H743ZI];

impl Board {
    /// The board with this name, if there is one.
    ///
    /// ```
    /// use ommatidia_shared::boards::Board;
    ///
    /// assert_eq!(Board::named("mps2-an500").unwrap().core, "Cortex-M7");
    /// assert_eq!(Board::named("mps2-an999"), None);
    /// ```
    pub fn named(name: &str) -> Option<Self> {
        BOARDS.into_iter().find(|board| board.name == name)
    }
}
