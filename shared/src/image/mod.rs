//! Borrowed images: planes (row, col) with a stride, and tensors (channel, row, col) without one.

mod error;
mod plane;
mod region;
mod tensor;

pub use error::ShapeError;
pub use plane::{Plane, PlaneMut, Strided};
pub use region::Region;
pub use tensor::{Chw, ChwMut, Tensor};
