//! What the pipeline refuses.

use core::fmt;

use crate::blob::{MemoryPlan, Size};
use crate::filter::FilterError;
use crate::image::{Region, ShapeError};
use crate::nn::NnError;

/// What the pipeline refuses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PipelineError {
    /// A size in the header is zero, odd, or too large.
    Field {
        /// Which one.
        field: &'static str,
        /// What it must be.
        expected: &'static str,
        /// What it is.
        found: u32,
    },
    /// The black level is not finite.
    BlackLevel {
        /// The level found, DN.
        found: f32,
    },
    /// The filter bank contradicts itself.
    Filter(FilterError),
    /// An operator refused its input. It means a defect of this crate: the shapes are checked before.
    Network(NnError),
    /// A buffer does not hold its shape. It means a defect of this crate.
    Shape(ShapeError),
    /// The memory plan in the header is not the plan of this version.
    Plan {
        /// The plan for these shapes.
        expected: MemoryPlan,
        /// The plan in the header.
        found: MemoryPlan,
    },
    /// The frame has another length.
    Frame {
        /// Pixels by the header.
        expected: usize,
        /// Pixels given.
        found: usize,
    },
    /// The region is empty or reaches out of the object.
    Region {
        /// The object.
        object: Size,
        /// The region asked for.
        found: Region,
    },
    /// There is another number of scales than the network has.
    Scales {
        /// Scales of the network.
        expected: usize,
        /// Scales given.
        found: usize,
    },
    /// What is held is of a frame without light, or of one whose filters left the range of halves.
    NothingHeld,
    /// What is held does not fit the frame: one of its maxima is more than [twice](super::GROWTH) as large, or the frame's less than half.
    Outgrown,
    /// The output has another length.
    Output {
        /// Pixels of the region.
        expected: usize,
        /// Pixels given.
        found: usize,
    },
    /// The caller's memory is too small.
    Memory {
        /// The least that is needed.
        expected: MemoryPlan,
        /// What was given.
        found: MemoryPlan,
    },
}

impl From<FilterError> for PipelineError {
    fn from(error: FilterError) -> Self {
        Self::Filter(error)
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
            // Words, not the number: the device would have to carry all that prints a float.
            Self::BlackLevel { found } => {
                let found = if found.is_nan() { "none" } else { "an infinite one" };
                write!(f, "sensor.black_level_dn: expected a finite level, found {found}")
            }
            Self::Filter(error) => error.fmt(f),
            Self::Network(error) => error.fmt(f),
            Self::Shape(error) => error.fmt(f),
            Self::Plan { expected, found } => write!(
                f,
                "memory plan: expected {} + {} bytes, found {} + {}; quantize the network anew",
                expected.fast_bytes, expected.bulk_bytes, found.fast_bytes, found.bulk_bytes
            ),
            Self::Frame { expected, found } => write!(f, "raw frame: expected {expected} pixels, found {found}"),
            Self::Region { object, found } => {
                write!(
                    f,
                    "region {found} (row,col,rows,cols): it must lie in the {} x {} pixels",
                    object.rows, object.cols
                )
            }
            Self::Scales { expected, found } => write!(f, "scales: expected {expected}, found {found}"),
            Self::NothingHeld => {
                f.write_str("no statistics of the field are held: the frame that they are of had no light")
            }
            Self::Outgrown => f.write_str("the frame is too bright or too dark for the statistics that are held"),
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
