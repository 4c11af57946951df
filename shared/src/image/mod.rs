//! Borrowed images: (row, col) planes with a stride, and channel-row-col (CHW) tensors without one.

mod plane;
mod region;
mod tensor;

pub use plane::{Plane, PlaneMut, Strided};
pub use region::Region;
pub use tensor::{Chw, ChwMut, Tensor};

/// The buffer does not hold the shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ShapeError {
    /// Elements that the shape needs.
    pub expected: usize,
    /// Elements that the buffer has.
    pub found: usize,
}

impl core::fmt::Display for ShapeError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "the shape needs {} elements, the buffer has {}", self.expected, self.found)
    }
}

impl core::error::Error for ShapeError {}
