//! The geometry of tiles, windows and taps.

use core::fmt;
use core::ops::{Range, RangeInclusive};

use crate::blob::{Bank, Size};
use crate::fft::FftError;
use crate::image::Region;

/// Why a filter bank refuses its shapes or its buffers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FilterError {
    /// The transform refuses its size or a buffer.
    Fft(FftError),
    /// The step is 0 or exceeds the tile.
    Step {
        /// Side of the tile.
        tile: u16,
        /// Step found.
        step: u16,
    },
    /// A tap belongs to a channel that does not exist.
    Channel {
        /// Number of channels.
        channels: u8,
        /// Channel of the tap.
        found: u8,
    },
    /// Taps are not in ascending order of (channel, dy, dx), or two are equal.
    Order {
        /// Number of the tap that is out of order.
        tap: usize,
    },
    /// A channel has no tap, or there are none at all.
    NoTap {
        /// The first such channel.
        channel: u8,
    },
    /// The bank stores kernels, but does not have one tap at (0, 0) in each channel and one tile that holds the whole
    /// frame.
    Kernels,
    /// The index of the blocks is out of order.
    Index {
        /// First row of blocks that is out of order, counted over all channels.
        row: usize,
    },
    /// A part of the object is empty or reaches beyond it.
    Part {
        /// Part given.
        found: Region,
    },
    /// The spectra of the windows, or the output, would have 4 GiB or more.
    TooLarge {
        /// Memory that the plan needs, bytes.
        needed: u64,
    },
    /// A buffer has another length.
    Length {
        /// Elements that the plan needs.
        expected: usize,
        /// Elements found.
        found: usize,
    },
}

impl From<FftError> for FilterError {
    fn from(error: FftError) -> Self {
        Self::Fft(error)
    }
}

impl fmt::Display for FilterError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Fft(error) => error.fmt(f),
            Self::Step { tile, step } => write!(f, "filter bank: expected a step of 1 to {tile}, found {step}"),
            Self::Channel { channels, found } => {
                write!(f, "filter bank: a tap of channel {found}, but there are {channels} channels")
            }
            Self::Order { tap } => write!(f, "filter bank: tap {tap} is not in the order (channel, dy, dx)"),
            Self::NoTap { channel } => write!(f, "filter bank: channel {channel} has no tap"),
            Self::Kernels => f.write_str(
                "filter bank: kernels need one tap at (0, 0) in each channel and one tile that holds the whole frame",
            ),
            Self::Index { row } => write!(f, "filter bank: the index of the blocks is out of order in row {row}"),
            Self::Part { found } => write!(f, "filter bank: the part {found} is empty or reaches beyond the object"),
            Self::TooLarge { needed } => {
                write!(f, "filter bank: it needs {needed} bytes; choose a larger step or a smaller tile")
            }
            Self::Length { expected, found } => write!(f, "filter bank: expected {expected} elements, found {found}"),
        }
    }
}

impl core::error::Error for FilterError {}

/// One axis of the geometry; see the [module](super) for the terms.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Axis {
    /// Frame, pixels (n).
    pub frame: usize,
    /// Object, pixels (m).
    pub object: usize,
    /// Transform, pixels (T).
    pub tile: usize,
    /// Step, pixels (S).
    pub step: usize,
    /// Smallest and largest tap offset, steps.
    pub offsets: (i32, i32),
}

impl Axis {
    /// Whether there is one tile, and its only window holds the whole frame.
    pub fn is_whole(&self) -> bool {
        self.tiles() == 1 && self.offsets == (0, 0) && self.tile >= self.frame
    }

    /// Number of output tiles.
    pub const fn tiles(&self) -> usize {
        self.object.div_ceil(self.step)
    }

    /// Pixels of a full output tile (V).
    pub const fn valid(&self) -> usize {
        if self.step < self.object { self.step } else { self.object }
    }

    /// First valid result of the transform (L).
    pub const fn lead(&self) -> usize {
        (self.tile - self.valid()) / 2
    }

    /// Pixels of output tile `i`. The last tile ends at the edge of the object.
    pub const fn tile_len(&self, i: usize) -> usize {
        let rest = self.object - i * self.step;
        if rest < self.valid() { rest } else { self.valid() }
    }

    /// Output tiles that hold the object pixels `part`, which is not empty.
    pub const fn tiles_of(&self, part: &Range<usize>) -> Range<usize> {
        part.start / self.step..part.end.div_ceil(self.step)
    }

    /// Results of the transform of tile `i` that are object pixels in `part`. The first pixel of a tile is result
    /// `lead`.
    pub fn results(&self, i: usize, part: &Range<usize>, lead: usize) -> Range<usize> {
        let first = i * self.step;
        let (start, end) = (part.start.max(first), part.end.min(first + self.tile_len(i)));
        start - first + lead..end - first + lead
    }

    /// Frame pixel under object pixel 0 (D).
    pub const fn object_origin(&self) -> i32 {
        let (tile, frame, object) = (self.tile as i32, self.frame as i32, self.object as i32);
        (tile - object).div_euclid(2) - (tile - frame).div_euclid(2)
    }

    /// First frame pixel of window `i`, which may lie outside the frame.
    pub const fn window_origin(&self, i: i32) -> i32 {
        self.object_origin() + i * self.step as i32 - self.lead() as i32
    }

    /// Pixels of window `i` that lie in the frame, counted from the beginning of the window. There may be none.
    pub fn occupied(&self, i: i32) -> Range<usize> {
        let origin = self.window_origin(i);
        let clip = |pixel: i32| (pixel - origin).clamp(0, self.tile as i32) as usize;
        clip(0)..clip(self.frame as i32)
    }

    /// Windows that the taps of tile `i` may read.
    pub const fn windows(&self, i: usize) -> RangeInclusive<i32> {
        i as i32 + self.offsets.0..=i as i32 + self.offsets.1
    }

    /// Number of windows from the first tap of the first tile to the last tap of the last.
    pub const fn window_count(&self) -> usize {
        self.tiles() + self.span() - 1
    }

    /// Number of windows that one tile may read.
    pub const fn span(&self) -> usize {
        (self.offsets.1 - self.offsets.0 + 1) as usize
    }

    /// Lags of a tap's kernel that do not wrap around into a valid pixel.
    pub const fn lags(&self) -> RangeInclusive<i32> {
        (self.lead() + self.valid()) as i32 - self.tile as i32..=self.lead() as i32
    }
}

/// The geometry of a filter bank over a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Geometry {
    /// Rows.
    pub rows: Axis,
    /// Columns.
    pub cols: Axis,
}

impl Geometry {
    /// Computes the geometry, and checks the step, the channels and the order of the taps.
    ///
    /// # Errors
    /// [`FilterError::Step`], [`FilterError::Channel`], [`FilterError::Order`], [`FilterError::NoTap`],
    /// [`FilterError::Kernels`].
    pub fn new(bank: &Bank, frame: Size, object: Size) -> Result<Self, FilterError> {
        if bank.step == 0 || bank.step > bank.tile {
            return Err(FilterError::Step { tile: bank.tile, step: bank.step });
        }
        check_taps(bank)?;
        let axis = |frame, object, offset: fn(&crate::blob::Tap) -> i8| Axis {
            frame: usize::from(frame),
            object: usize::from(object),
            tile: usize::from(bank.tile),
            step: usize::from(bank.step),
            offsets: bank.taps.iter().map(offset).fold((i32::MAX, i32::MIN), |(low, high), offset| {
                let offset = i32::from(offset);
                (low.min(offset), high.max(offset))
            }),
        };
        let geometry = Self {
            rows: axis(frame.rows, object.rows, |tap| tap.dy),
            cols: axis(frame.cols, object.cols, |tap| tap.dx),
        };
        if bank.blocks.is_some() && ![geometry.rows, geometry.cols].iter().all(Axis::is_whole) {
            return Err(FilterError::Kernels);
        }
        Ok(geometry)
    }
}

/// Checks that each channel has taps, and that all taps are in order.
fn check_taps(bank: &Bank) -> Result<(), FilterError> {
    let mut next_channel = 0;
    for (i, tap) in bank.taps.iter().enumerate() {
        let key = |tap: &crate::blob::Tap| (tap.channel, tap.dy, tap.dx);
        if tap.channel >= bank.channels {
            return Err(FilterError::Channel { channels: bank.channels, found: tap.channel });
        }
        if i > 0 && key(&bank.taps[i - 1]) >= key(tap) {
            return Err(FilterError::Order { tap: i });
        }
        if tap.channel > next_channel {
            return Err(FilterError::NoTap { channel: next_channel });
        }
        next_channel = tap.channel + 1;
    }
    if next_channel == bank.channels && bank.channels > 0 {
        Ok(())
    } else {
        Err(FilterError::NoTap { channel: next_channel })
    }
}
