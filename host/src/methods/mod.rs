//! Ways from a raw frame to an object: the network, and the methods that it must beat.

mod blob;
mod central;
mod error;
mod frame;
mod network;
#[cfg(test)]
mod testing;

pub use blob::{Blob, NetworkFileError};
pub use central::Central;
pub use error::MethodError;
pub use frame::FrameCorrection;
pub use network::FloatNetwork;

use ndarray::{Array2, ArrayView2};

/// A method that reconstructs an object from one raw frame.
pub trait Reconstruct: Send + Sync {
    /// Name in tables and on the command line.
    fn name(&self) -> &str;
    /// Raw frame, DN, [sensor rows, sensor cols] -> object, [object rows, object cols], >= 0, in a unit of its own
    /// (judged with one free scale a frame).
    ///
    /// # Errors
    /// The frame has the wrong shape or holds values that are no numbers.
    fn reconstruct(&self, frame_dn: ArrayView2<'_, f32>) -> anyhow::Result<Array2<f32>>;
}
