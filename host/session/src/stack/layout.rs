//! What a stack of frames looks like: container, number and size of its frames, type of its samples.

use crate::error::SessionError;
use std::path::Path;

/// Type of the samples of a stack.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SampleType {
    /// 8-bit unsigned integer.
    U8,
    /// 16-bit unsigned integer.
    U16,
    /// 32-bit float.
    F32,
}

impl SampleType {
    /// Size of one sample, bytes.
    pub fn bytes(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::U16 => 2,
            Self::F32 => 4,
        }
    }

    /// NumPy's name of the type, e.g. `uint16`.
    pub fn name(self) -> &'static str {
        match self {
            Self::U8 => "uint8",
            Self::U16 => "uint16",
            Self::F32 => "float32",
        }
    }
}

/// Size and sample type of a stack that is about to be written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StackSpec {
    /// Number of frames.
    pub frames: usize,
    /// Rows of a frame.
    pub rows: usize,
    /// Columns of a frame.
    pub cols: usize,
    /// Type of the samples; values are rounded to the nearest integer for the integer types.
    pub samples: SampleType,
    /// Side of a pixel for the OME metadata of a TIFF, um; `None` writes no pixel size.
    pub pixel_um: Option<f64>,
}

impl StackSpec {
    /// Size of all samples, bytes.
    pub fn bytes(&self) -> u64 {
        [self.frames, self.rows, self.cols, self.samples.bytes()]
            .iter()
            .fold(1, |n: u64, m| n.saturating_mul(*m as u64))
    }
}

/// What a stack's file says of space and time. `.npy` files say nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StackScale {
    /// Height and width of a pixel, um.
    pub pixel_um: Option<[f64; 2]>,
    /// Time from one frame to the next, s.
    pub interval_s: Option<f64>,
}

/// Size and sample type of a stack, as its file states them.
pub(super) struct Shape {
    pub len: usize,
    pub rows: usize,
    pub cols: usize,
    pub samples: SampleType,
}

/// Container of a stack, chosen by the suffix of the file name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Container {
    Npy,
    Tif,
    Avi,
    Mat,
    Mp4,
    Zarr,
}

impl Container {
    pub(super) fn of(path: &Path) -> Result<Self, SessionError> {
        let suffix = path.extension().and_then(|s| s.to_str()).unwrap_or("").to_ascii_lowercase();
        match suffix.as_str() {
            "npy" => Ok(Self::Npy),
            "tif" | "tiff" => Ok(Self::Tif),
            "avi" => Ok(Self::Avi),
            "mat" => Ok(Self::Mat),
            "mp4" => Ok(Self::Mp4),
            "zarr" => Ok(Self::Zarr),
            _ => Err(SessionError::value(
                path,
                "suffix",
                ".npy, .tif, .tiff, .avi, .mp4, .mat or .zarr",
                if suffix.is_empty() { "none".into() } else { format!(".{suffix}") },
                "name the file with one of these suffixes, or convert the stack to one of these formats",
            )),
        }
    }
}
