//! The traits that a board implements for its camera, its pins and its sensors, and implementations in memory.

use crate::wire::{Activity, CameraLimits, CameraSettings, Reply, Request, SettingError, StartCause};
use core::fmt;
use half::f16;

/// Why a buffer, a camera or the flash refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum IoError {
    /// There is too little room.
    NoRoom {
        /// Bytes needed.
        needed: usize,
        /// Bytes available.
        available: usize,
    },
    /// The hardware failed.
    Failed,
}

impl fmt::Display for IoError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::NoRoom { needed, available } => write!(f, "{needed} bytes needed, {available} available"),
            Self::Failed => f.write_str("the hardware failed"),
        }
    }
}

impl core::error::Error for IoError {}

/// The memory of the raw frame, which the host or a camera fills.
pub trait FrameSource {
    /// Largest frame that fits, pixels.
    fn capacity(&self) -> usize;
    /// The camera that fills it, where one answers.
    fn camera(&mut self) -> Option<&mut dyn Camera> {
        None
    }
    /// Prepares for a frame of `pixels` from the host.
    ///
    /// # Errors
    /// [`IoError::NoRoom`] where it does not fit; [`IoError::Failed`] where this source takes no frames from the host.
    fn begin(&mut self, pixels: usize) -> Result<(), IoError>;
    /// Stores bytes of the host's frame (little-endian 16-bit codes) at `offset` bytes from its beginning.
    ///
    /// # Errors
    /// [`IoError::NoRoom`] where the bytes go past the length given to [`Self::begin`].
    fn write(&mut self, offset: usize, bytes: &[u8]) -> Result<(), IoError>;
    /// The frame to reconstruct, the host's or the camera's last: raw codes, row by row.
    ///
    /// # Errors
    /// [`IoError::Failed`] where the hardware failed.
    fn frame(&mut self) -> Result<&[u16], IoError>;
}

/// An image sensor that exposes one frame when told to, its excitation LED and its clock. [`Device`](super::Device)
/// decides when; no method waits.
pub trait Camera {
    /// Name of the sensor.
    fn sensor(&self) -> &'static str;
    /// The settings in force.
    fn settings(&self) -> CameraSettings;
    /// What the sensor can do, while its other settings are those in force.
    fn limits(&self) -> CameraLimits;
    /// The nearest settings that the sensor has. Changes nothing.
    ///
    /// # Errors
    /// The setting that the sensor cannot have, and its limits.
    fn plan(&self, wanted: CameraSettings) -> Result<CameraSettings, SettingError>;
    /// Sets the sensor to settings from [`Self::plan`], whatever it was set to. Where that fails [`Self::settings`] are
    /// those before.
    ///
    /// # Errors
    /// [`IoError::Failed`] where the sensor does not respond.
    fn apply(&mut self, settings: CameraSettings) -> Result<(), IoError>;
    /// Clock, microseconds since the start.
    fn now_us(&self) -> u64;
    /// Longest time from [`Self::expose`] until the sensor really begins, us. The LED stays on that much longer.
    fn latency_us(&self) -> u32 {
        0
    }
    /// Sets the excitation LED to `permille` thousandths of the full current; dark at 0.
    fn light(&mut self, permille: u16);
    /// Whether a pulse has come to the trigger input since the last call.
    fn triggered(&mut self) -> bool;
    /// Starts one exposure, at once. The frame of the host is lost.
    ///
    /// # Errors
    /// [`IoError::Failed`] where the sensor does not respond.
    fn expose(&mut self) -> Result<(), IoError>;
    /// Whether the frame that was exposed is in memory.
    ///
    /// # Errors
    /// [`IoError::Failed`] where the transfer from the sensor failed.
    fn ready(&mut self) -> Result<bool, IoError>;
    /// The frame that was to be exposed is not waited for any more: nothing writes to the memory of frames from now on.
    fn abandon(&mut self);
    /// Called again and again during waits.
    fn pause(&self) {
        core::hint::spin_loop();
    }
}

/// Destination of reconstructions.
pub trait FrameSink {
    /// Largest reconstruction that fits, pixels.
    fn capacity(&self) -> usize;
    /// The buffer for the next reconstruction, of `pixels`.
    ///
    /// # Errors
    /// [`IoError::NoRoom`] where it does not fit.
    fn begin(&mut self, pixels: usize) -> Result<&mut [f16], IoError>;
    /// Called when the buffer holds the reconstruction.
    ///
    /// # Errors
    /// [`IoError::Failed`] where the hardware failed.
    fn finish(&mut self) -> Result<(), IoError>;
    /// The last reconstruction, row by row, 0 to 1.
    fn object(&self) -> &[f16];
}

/// Memory that the program occupies on a board. All 0 on the workstation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Footprint {
    /// Code and constants, bytes.
    pub image_bytes: u32,
    /// Static variables without the large buffers, bytes.
    pub static_bytes: u32,
    /// Largest depth of the stack since the start, bytes.
    pub stack_bytes: u32,
}

impl Footprint {
    /// Upper bound of variables and stack together on any board, bytes. With it the memory of a network is known when
    /// its file is written. Tests on the emulated boards check the bound.
    pub const MOST_RAM: u32 = 16 << 10;
}

/// A watchdog: it resets the board unless it is fed in time. (`embedded-hal` 1.0 has no such trait.)
pub trait Watchdog {
    /// Starts the count.
    fn start(&mut self);
    /// Restarts the count: the program is alive.
    fn feed(&mut self);
}

/// What a board does when the program reports its progress, and what its counters and sensors measure.
pub trait Monitor {
    /// Called with every request: feeds the watchdog.
    fn alive(&mut self);
    /// Called before a reconstruction: raises the trigger pin.
    fn run_begins(&mut self);
    /// Called after a reconstruction: lowers the pin. Returns the cycles of the core since [`Self::run_begins`], where
    /// they are counted.
    fn run_ends(&mut self) -> Option<u32>;
    /// Called with the answer to every request but those that read a reconstruction: for a log.
    fn answers(&mut self, request: &Request<'_>, reply: &Reply<'_>) {
        let _ = (request, reply);
    }
    /// Memory that the program occupies.
    fn footprint(&self) -> Footprint;
    /// Temperature in hundredths of a degree Celsius, where there is a sensor.
    fn temperature_cdeg(&mut self) -> Option<i16>;
    /// Why the program was started.
    fn start_cause(&self) -> StartCause;
    /// Number of starts since the power came on, this one included. It is kept where a reset does not clear it, and
    /// never in the flash.
    fn starts(&self) -> u32 {
        1
    }
    /// Clock of the core, MHz, where it is known.
    fn core_mhz(&self) -> Option<u16> {
        None
    }
    /// Whether the last starts ended in faults, one after the other. The device then runs no network, and waits for
    /// another one.
    fn keeps_faulting(&self) -> bool {
        false
    }
    /// How long the core has run and slept, where there is a clock.
    fn activity(&self) -> Option<Activity> {
        None
    }
}

/// The monitor of a program without a board: nothing to signal, nothing to measure.
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

/// A frame in memory, which the host sends.
#[derive(Debug)]
pub struct RamFrame<'m> {
    memory: &'m mut [u16],
    pixels: usize,
}

impl<'m> RamFrame<'m> {
    /// Stores frames in `memory`, pixels.
    pub fn new(memory: &'m mut [u16]) -> Self {
        Self { memory, pixels: 0 }
    }

    /// The memory of a frame of `pixels` that a camera fills.
    ///
    /// # Errors
    /// [`IoError::NoRoom`] where it does not fit.
    pub fn fill(&mut self, pixels: usize) -> Result<&mut [u16], IoError> {
        self.pixels = fits(pixels, self.memory.len())?;
        Ok(self.memory.get_mut(..pixels).unwrap_or_default())
    }

    /// The memory, with whatever it holds.
    pub fn into_memory(self) -> &'m mut [u16] {
        self.memory
    }
}

impl FrameSource for RamFrame<'_> {
    fn capacity(&self) -> usize {
        self.memory.len()
    }

    fn begin(&mut self, pixels: usize) -> Result<(), IoError> {
        self.pixels = fits(pixels, self.memory.len())?;
        Ok(())
    }

    fn write(&mut self, offset: usize, bytes: &[u8]) -> Result<(), IoError> {
        // Codes are little-endian in memory as on the line: every target is little-endian.
        copy(offset, bytes, bytemuck::cast_slice_mut(self.memory.get_mut(..self.pixels).unwrap_or_default()))
    }

    fn frame(&mut self) -> Result<&[u16], IoError> {
        Ok(self.memory.get(..self.pixels).unwrap_or_default())
    }
}

/// A reconstruction in memory, which the host reads.
#[derive(Debug)]
pub struct RamObject<'m> {
    memory: &'m mut [f16],
    pixels: usize,
}

impl<'m> RamObject<'m> {
    /// Stores reconstructions in `memory`, pixels.
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
