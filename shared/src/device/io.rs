//! Where a board puts its camera, its pins and its sensors; and the versions that live in memory.

use crate::wire::{Activity, StartCause};
use core::fmt;
use half::f16;

/// Why storage did not do what it was asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum IoError {
    /// Too little room.
    NoRoom {
        /// Bytes asked for.
        needed: usize,
        /// Bytes there are.
        available: usize,
    },
    /// The hardware failed.
    Failed,
}

impl fmt::Display for IoError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::NoRoom { needed, available } => write!(f, "{needed} bytes needed, room for {available}"),
            Self::Failed => f.write_str("the storage failed"),
        }
    }
}

impl core::error::Error for IoError {}

/// Where raw frames come from: the host, or a camera.
pub trait FrameInput {
    /// Room, pixels.
    fn capacity(&self) -> usize;
    /// Whether frames come by themselves: the host need not send any.
    fn live(&self) -> bool {
        false
    }
    /// Makes ready for a frame of `pixels` from the host.
    ///
    /// # Errors
    /// There is no such room, or this source takes no frames from the host.
    fn begin(&mut self, pixels: usize) -> Result<(), IoError>;
    /// Takes bytes of a frame from the host, little-endian codes, at `offset` bytes.
    ///
    /// # Errors
    /// The bytes go past the length given to `begin`.
    fn write(&mut self, offset: usize, bytes: &[u8]) -> Result<(), IoError>;
    /// The frame to reconstruct, row by row.
    ///
    /// # Errors
    /// The camera failed.
    fn frame(&mut self) -> Result<&[u16], IoError>;
}

/// Where reconstructions go.
pub trait FrameSink {
    /// Room, pixels.
    fn capacity(&self) -> usize;
    /// The buffer that the next reconstruction of `pixels` is written to.
    ///
    /// # Errors
    /// There is no such room.
    fn begin(&mut self, pixels: usize) -> Result<&mut [f16], IoError>;
    /// The buffer is filled.
    ///
    /// # Errors
    /// The hardware failed.
    fn finish(&mut self) -> Result<(), IoError>;
    /// The last reconstruction, for the host.
    fn object(&self) -> &[f16];
}

/// What the program takes of the board's memory. All 0 where that has no meaning.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Footprint {
    /// Code and constants, bytes.
    pub image_bytes: u32,
    /// Variables besides the large buffers, bytes.
    pub static_bytes: u32,
    /// The deepest that the stack has been, bytes.
    pub stack_bytes: u32,
}

impl Footprint {
    /// The most that variables and stack take together on any board, bytes; each half of it. So the memory of a network is known when
    /// its file is made. Tests over the boards hold it.
    pub const MOST_RAM: u32 = 16 << 10;
}

/// Resets the board unless it is fed in time. (`embedded-hal` 1.0 has no such trait.)
pub trait Watchdog {
    /// Begins to count.
    fn start(&mut self);
    /// The program is alive: count anew.
    fn feed(&mut self);
}

/// The board's view of the program: pins, counters, sensors.
pub trait Monitor {
    /// A request was handled: feed the watchdog.
    fn alive(&mut self);
    /// A reconstruction begins: raise the trigger pin.
    fn run_begins(&mut self);
    /// It has ended: lower the pin. Gives the cycles of the core since it began, where they are counted.
    fn run_ends(&mut self) -> Option<u32>;
    /// What the program takes.
    fn footprint(&self) -> Footprint;
    /// Temperature in hundredths of a degree Celsius, where there is a sensor.
    fn temperature_cdeg(&mut self) -> Option<i16>;
    /// Why the program was started.
    fn start_cause(&self) -> StartCause;
    /// How the core spends its time, where there is a clock.
    fn activity(&self) -> Option<Activity> {
        None
    }
}

/// No board.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Monitor for Silent {
    fn alive(&mut self) {}
    fn run_begins(&mut self) {}
    fn run_ends(&mut self) -> Option<u32> {
        None
    }
    fn footprint(&self) -> Footprint {
        Footprint::default()
    }
    fn temperature_cdeg(&mut self) -> Option<i16> {
        None
    }
    fn start_cause(&self) -> StartCause {
        StartCause::Power
    }
}

/// A frame that the host sent.
#[derive(Debug)]
pub struct RamFrame<'m> {
    memory: &'m mut [u16],
    pixels: usize,
}

impl<'m> RamFrame<'m> {
    /// Puts frames into `memory`.
    pub fn new(memory: &'m mut [u16]) -> Self {
        Self { memory, pixels: 0 }
    }

    /// The memory, whatever is in it.
    pub fn into_memory(self) -> &'m mut [u16] {
        self.memory
    }
}

impl FrameInput for RamFrame<'_> {
    fn capacity(&self) -> usize {
        self.memory.len()
    }

    fn begin(&mut self, pixels: usize) -> Result<(), IoError> {
        self.pixels = fits(pixels, self.memory.len())?;
        Ok(())
    }

    fn write(&mut self, offset: usize, bytes: &[u8]) -> Result<(), IoError> {
        // The codes are little-endian, and so is every target: see `blob`.
        copy(offset, bytes, bytemuck::cast_slice_mut(self.memory.get_mut(..self.pixels).unwrap_or_default()))
    }

    fn frame(&mut self) -> Result<&[u16], IoError> {
        Ok(self.memory.get(..self.pixels).unwrap_or_default())
    }
}

/// A reconstruction that the host reads.
#[derive(Debug)]
pub struct RamObject<'m> {
    memory: &'m mut [f16],
    pixels: usize,
}

impl<'m> RamObject<'m> {
    /// Puts reconstructions into `memory`.
    pub fn new(memory: &'m mut [f16]) -> Self {
        Self { memory, pixels: 0 }
    }
}

impl FrameSink for RamObject<'_> {
    fn capacity(&self) -> usize {
        self.memory.len()
    }

    fn begin(&mut self, pixels: usize) -> Result<&mut [f16], IoError> {
        self.pixels = fits(pixels, self.memory.len())?;
        Ok(self.memory.get_mut(..self.pixels).unwrap_or_default())
    }

    fn finish(&mut self) -> Result<(), IoError> {
        Ok(())
    }

    fn object(&self) -> &[f16] {
        self.memory.get(..self.pixels).unwrap_or_default()
    }
}

fn fits(needed: usize, available: usize) -> Result<usize, IoError> {
    if needed <= available { Ok(needed) } else { Err(IoError::NoRoom { needed, available }) }
}

fn copy(offset: usize, bytes: &[u8], memory: &mut [u8]) -> Result<(), IoError> {
    let available = memory.len();
    let needed = offset.saturating_add(bytes.len());
    let to = memory.get_mut(offset..needed).ok_or(IoError::NoRoom { needed, available })?;
    to.iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
    Ok(())
}
