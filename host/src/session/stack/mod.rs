//! Stacks of frames, [frames, rows, cols], as .npy or multi-page .tif: read and written one frame at a time.
//!
//! ```no_run
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use ommatidia_host::session::stack::FrameReader;
//! let mut frames = FrameReader::open("scene.npy".as_ref())?;
//! for i in 0..frames.len() {
//!     let frame = frames.read(i)?; // [rows, cols], f32
//!     println!("{}", frame.sum());
//! }
//! # Ok(())
//! # }
//! ```

mod npy;
mod ome;
mod reader;
mod recording;
mod tif;
mod writer;

pub use reader::{FrameReader, FrameSource};
pub use recording::Recording;
pub use writer::{FrameWriter, StackSpec};

use super::SessionError;
use ndarray::{Array3, ArrayView3};
use std::path::Path;

/// Type of the samples of a stack.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SampleType {
    /// 8-bit unsigned.
    U8,
    /// 16-bit unsigned.
    U16,
    /// 32-bit float.
    F32,
}

impl SampleType {
    /// Bytes of one sample.
    pub fn bytes(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::U16 => 2,
            Self::F32 => 4,
        }
    }

    /// Name as NumPy gives it.
    pub fn name(self) -> &'static str {
        match self {
            Self::U8 => "uint8",
            Self::U16 => "uint16",
            Self::F32 => "float32",
        }
    }
}

/// Container of a stack, by the suffix of its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Container {
    Npy,
    Tif,
}

impl Container {
    fn of(path: &Path) -> Result<Self, SessionError> {
        let suffix = path.extension().and_then(|s| s.to_str()).unwrap_or("").to_ascii_lowercase();
        match suffix.as_str() {
            "npy" => Ok(Self::Npy),
            "tif" | "tiff" => Ok(Self::Tif),
            _ => Err(SessionError::value(
                path,
                "suffix",
                ".npy, .tif or .tiff",
                if suffix.is_empty() { "none".into() } else { format!(".{suffix}") },
                "name the stack after what it is",
            )),
        }
    }
}

/// Reads a whole stack, [frames, rows, cols]. For stacks that may be large use [`FrameReader`].
///
/// # Errors
/// As [`FrameReader::open`] and [`FrameReader::read`].
pub fn read(path: &Path) -> Result<Array3<f32>, SessionError> {
    let mut reader = FrameReader::open(path)?;
    let mut stack = Array3::zeros((reader.len(), reader.rows(), reader.cols()));
    for (i, mut frame) in stack.outer_iter_mut().enumerate() {
        frame.assign(&reader.read(i)?);
    }
    Ok(stack)
}

/// Writes a whole float32 stack, [frames, rows, cols]; .npy or OME-TIFF by suffix; whole or not at all.
///
/// # Errors
/// As [`FrameWriter`].
pub fn write(path: &Path, stack: ArrayView3<'_, f32>) -> Result<(), SessionError> {
    let (frames, rows, cols) = stack.dim();
    let mut writer =
        FrameWriter::create(path, StackSpec { frames, rows, cols, samples: SampleType::F32, pixel_um: None })?;
    for frame in stack.outer_iter() {
        writer.push(frame)?;
    }
    writer.finish()
}
