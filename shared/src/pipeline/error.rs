//! Errors of the pipeline.

use core::fmt;

use crate::blob::{MemoryPlan, Size};
use crate::fft::FftError;
use crate::filter::FilterError;
use crate::image::{Region, ShapeError};
use crate::nn::NnError;

/// Why the pipeline refuses a network or an argument.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PipelineError {
    /// A size in the header is zero, odd, or too large.
    Field {
        /// Name of the field.
        field: &'static str,
        /// Allowed values.
        expected: &'static str,
        /// Value found.
        found: u32,
    },
    /// The black level is NaN, or beyond what 16 bits can hold.
    BlackLevel {
        /// The level found, DN.
        found: f32,
    },
    /// The filter bank has impossible shapes, or its filters do not belong to it.
    Filter(FilterError),
    /// An operator refused its input. As all shapes are checked before, this is a defect of this crate.
    Network(NnError),
    /// A buffer does not hold its shape. As all lengths are checked before, this is a defect of this crate.
    Shape(ShapeError),
    /// The memory plan in the header is not that of this version.
    Plan {
        /// The plan for these shapes.
        expected: MemoryPlan,
        /// The plan in the header.
        found: MemoryPlan,
    },
    /// The network needs 4 GiB or more of one of the two memories.
    TooLarge {
        /// Fast scratch, bytes.
        fast: u64,
        /// Bulk arena, bytes.
        bulk: u64,
    },
    /// The raw frame has another length.
    Frame {
        /// Pixels by the header.
        expected: usize,
        /// Pixels given.
        found: usize,
    },
    /// The region is empty or reaches beyond the object.
    Region {
        /// Size of the object.
        object: Size,
        /// Region given.
        found: Region,
    },
    /// The number of attention scales is not that of the network.
    Scales {
        /// Scales of the network.
        expected: usize,
        /// Scales given.
        found: usize,
    },
    /// The held statistics are those of a frame without light, or of one with filter outputs outside the range of
    /// halves.
    NothingHeld,
    /// The held statistics do not fit the frame: its maximum is more than [`GROWTH`](super::GROWTH) times the held one
    /// or less than the held one divided by that, or its filter outputs are too large in the same way.
    Outgrown,
    /// Statistics of the field cannot be held for a network with several passes.
    Hold,
    /// The output buffer has another length.
    Output {
        /// Pixels of the region.
        expected: usize,
        /// Pixels given.
        found: usize,
    },
    /// The memory is too small.
    Memory {
        /// Memory needed at least.
        expected: MemoryPlan,
        /// Memory given.
        found: MemoryPlan,
    },
}

impl From<FilterError> for PipelineError {
    fn from(error: FilterError) -> Self {
        Self::Filter(error)
    }
}

impl From<FftError> for PipelineError {
    fn from(error: FftError) -> Self {
        Self::Filter(FilterError::Fft(error))
    }
}

impl From<NnError> for PipelineError {
    fn from(error: NnError) -> Self {
        Self::Network(error)
    }
}

impl From<ShapeError> for PipelineError {
    fn from(error: ShapeError) -> Self {
        Self::Shape(error)
    }
}

impl fmt::Display for PipelineError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Field { field, expected, found } => write!(f, "{field}: expected {expected}, found {found}"),
            // A word instead of the value: printing floats would take much of the device's flash.
            Self::BlackLevel { found } => {
                let found = if found.is_nan() { "NaN" } else { "one that no code of 16 bits reaches" };
                write!(f, "sensor.black_level_dn: expected a level of -65535 to 65535 DN, found {found}")
            }
            Self::Filter(error) => error.fmt(f),
            Self::Network(error) => error.fmt(f),
            Self::Shape(error) => error.fmt(f),
            Self::Plan { expected, found } => write!(
                f,
                "memory plan: expected {} + {} bytes, found {} + {}; quantize the network again",
                expected.fast_bytes, expected.bulk_bytes, found.fast_bytes, found.bulk_bytes
            ),
            Self::TooLarge { fast, bulk } => {
                write!(f, "memory plan: {fast} + {bulk} bytes are too many; choose a larger step or a smaller object")
            }
            Self::Frame { expected, found } => write!(f, "raw frame: expected {expected} pixels, found {found}"),
            Self::Region { object, found } => {
                write!(
                    f,
                    "region {found} (row,col,rows,cols): it must lie in the {} x {} pixels of the object",
                    object.rows, object.cols
                )
            }
            Self::Scales { expected, found } => write!(f, "attention scales: expected {expected}, found {found}"),
            Self::NothingHeld => {
                f.write_str("no statistics of the field are held: the frame that they come from had no light")
            }
            Self::Outgrown => f.write_str("the frame is too bright or too dark for the held statistics"),
            Self::Hold => {
                f.write_str("a network with several passes holds no field statistics; run it with a hold of 0")
            }
            Self::Output { expected, found } => write!(f, "output: expected {expected} pixels, found {found}"),
            Self::Memory { expected, found } => {
                memory(f, "fast", expected.fast_bytes, found.fast_bytes)?;
                f.write_str(", ")?;
                memory(f, "bulk", expected.bulk_bytes, found.bulk_bytes)
            }
        }
    }
}

fn memory(f: &mut fmt::Formatter<'_>, kind: &str, expected: u32, found: u32) -> fmt::Result {
    write!(f, "{kind} memory: expected {expected} bytes, found {found}")?;
    match expected.saturating_sub(found) {
        0 => Ok(()),
        missing => write!(f, " ({missing} missing)"),
    }
}

impl core::error::Error for PipelineError {}

/// Checks one field of a header.
pub(super) fn check(
    field: &'static str,
    expected: &'static str,
    found: u32,
    good: impl Fn(u32) -> bool,
) -> Result<(), PipelineError> {
    if good(found) { Ok(()) } else { Err(PipelineError::Field { field, expected, found }) }
}
