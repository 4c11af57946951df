//! Borrowed images: (row, col) planes with a stride, and channel-row-col (CHW) tensors without one.

mod error;
mod plane;
mod region;
mod tensor;

pub use error::ShapeError;
pub use plane::{Plane, PlaneMut, Strided};
pub use region::Region;
pub use tensor::{Chw, ChwMut, Tensor};
