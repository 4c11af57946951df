//! What a stack of frames looks like: container, number and size of its frames, type of its samples.

use crate::error::SessionError;
use std::io::Read;
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
#[derive(Clone, Copy, Debug)]
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
    /// The container of a file that is read. What is only written is refused, and so is a file whose first bytes are
    /// those of another container.
    pub(super) fn to_read(path: &Path) -> Result<Self, SessionError> {
        let named = Self::by_suffix(path).filter(|c| *c != Self::Mp4 && (*c != Self::Zarr || !path.is_file()));
        let found = Self::by_start(path);
        match (named, found) {
            (Some(named), None) => Ok(named),
            (Some(named), Some((found, ..))) if named == found => Ok(named),
            (_, Some((_, what, remedy))) => {
                let suffix = suffix(path);
                let found = if suffix.is_empty() {
                    format!("{what} without a suffix")
                } else {
                    format!("{what} named {suffix}")
                };
                Err(SessionError::value(path, "suffix", "the suffix of what the file holds", found, remedy))
            }
            (None, None) => {
                let expected = ".npy, .tif, .tiff, .avi or .mat, or a folder of Zarr, of .avi or of .tif files";
                let remedy = "convert the frames to one of these formats, e.g. to .npy with NumPy; another name alone \
                              does not convert them";
                Err(SessionError::value(path, "suffix", expected, shown_suffix(path), remedy))
            }
        }
    }

    /// The container of a file that is written.
    pub(super) fn to_write(path: &Path, shown_as: &Path) -> Result<Self, SessionError> {
        Self::by_suffix(path).filter(|c| *c != Self::Mat).ok_or_else(|| {
            let expected = ".npy, .tif, .tiff, .zarr, .avi or .mp4";
            let remedy = "choose a name with one of these suffixes, which decides the format";
            SessionError::value(shown_as, "suffix", expected, shown_suffix(path), remedy)
        })
    }

    /// The container that the suffix names.
    pub(super) fn by_suffix(path: &Path) -> Option<Self> {
        match suffix(path).as_str() {
            ".npy" => Some(Self::Npy),
            ".tif" | ".tiff" => Some(Self::Tif),
            ".avi" => Some(Self::Avi),
            ".mat" => Some(Self::Mat),
            ".mp4" => Some(Self::Mp4),
            ".zarr" => Some(Self::Zarr),
            _ => None,
        }
    }

    /// The container that the first bytes of a file are those of, with a word for it and its suffix.
    fn by_start(path: &Path) -> Option<(Self, &'static str, &'static str)> {
        let mut start = Vec::new();
        std::fs::File::open(path).ok()?.take(16).read_to_end(&mut start).ok()?;
        match start.as_slice() {
            [b'R', b'I', b'F', b'F', _, _, _, _, b'A', b'V', b'I', b' ', ..] => {
                Some((Self::Avi, "an AVI", "give it a name that ends in .avi"))
            }
            s if s.starts_with(b"II*\0")
                || s.starts_with(b"MM\0*")
                || s.starts_with(b"II+\0")
                || s.starts_with(b"MM\0+") =>
            {
                Some((Self::Tif, "a TIFF", "give it a name that ends in .tif"))
            }
            s if s.starts_with(b"\x93NUMPY") => Some((Self::Npy, "a NumPy array", "give it a name that ends in .npy")),
            s if s.starts_with(b"MATLAB 5.0 MAT") || s.starts_with(b"MATLAB 7.3 MAT") => {
                Some((Self::Mat, "a MATLAB file", "give it a name that ends in .mat"))
            }
            _ => None,
        }
    }
}

/// The suffix of a name in small letters, with its point; empty without one.
fn suffix(path: &Path) -> String {
    path.extension().map_or(String::new(), |s| format!(".{}", s.to_string_lossy().to_ascii_lowercase()))
}

/// The suffix of a name for people.
pub(super) fn shown_suffix(path: &Path) -> String {
    let suffix = suffix(path);
    if suffix.is_empty() { "none".into() } else { suffix }
}
