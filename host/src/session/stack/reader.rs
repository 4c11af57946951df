//! Reads frames of a stack, one at a time.

use super::{Container, SampleType, npy, tif};
use crate::session::SessionError;
use ndarray::Array2;
use std::collections::VecDeque;
use std::fmt::Debug;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Makes the frames of a stack instead of keeping them in a file: a frame is made anew each time that it is read.
pub trait FrameSource: Debug + Send + Sync {
    /// Frames, rows and columns.
    fn shape(&self) -> [usize; 3];

    /// Frame `i`, [rows, cols], DN, the same each time; and as many of those after it as are made along with it.
    ///
    /// # Errors
    /// What they are made from cannot be read.
    fn frames_from(&self, i: usize) -> Result<Vec<Array2<f32>>, SessionError>;
}

/// Reads frames of a stack, one at a time, in any order; holds one frame in memory.
#[derive(Debug)]
pub struct FrameReader {
    path: PathBuf,
    len: usize,
    rows: usize,
    cols: usize,
    samples: SampleType,
    source: Source,
}

#[derive(Debug)]
enum Source {
    Npy(npy::NpySource),
    Tif(Box<tif::TifSource>),
    Made {
        maker: Arc<dyn FrameSource>,
        /// Frames made ahead, and the index of the first.
        ahead: (usize, VecDeque<Array2<f32>>),
    },
}

/// What a container tells of its stack.
pub(super) struct Shape {
    pub len: usize,
    pub rows: usize,
    pub cols: usize,
    pub samples: SampleType,
}

impl FrameReader {
    /// Opens a stack and checks that it is complete: header, sample type, size of the file.
    ///
    /// # Errors
    /// The file is missing, neither .npy nor .tif, of a sample type other than uint8, uint16 and float32, not
    /// [frames, rows, cols], empty, or cut short.
    pub fn open(path: &Path) -> Result<Self, SessionError> {
        let (shape, source) = match Container::of(path)? {
            Container::Npy => npy::NpySource::open(path).map(|(shape, s)| (shape, Source::Npy(s)))?,
            Container::Tif => tif::TifSource::open(path).map(|(shape, s)| (shape, Source::Tif(Box::new(s))))?,
        };
        let Shape { len, rows, cols, samples } = shape;
        if len == 0 || rows == 0 || cols == 0 {
            return Err(SessionError::Shape {
                path: path.into(),
                expected: "at least one frame of at least one pixel".into(),
                found: format!("[{len}, {rows}, {cols}]"),
                remedy: "write the frames",
            });
        }
        Ok(Self { path: path.into(), len, rows, cols, samples, source })
    }

    /// Reads frames that are made as they are asked for; `name` stands for the file in messages.
    pub(crate) fn made(name: &Path, maker: Arc<dyn FrameSource>) -> Self {
        let [len, rows, cols] = maker.shape();
        let source = Source::Made { maker, ahead: (0, VecDeque::new()) };
        Self { path: name.into(), len, rows, cols, samples: SampleType::U16, source }
    }

    /// Number of frames, at least one.
    #[allow(clippy::len_without_is_empty)] // an empty stack cannot be opened
    pub fn len(&self) -> usize {
        self.len
    }

    /// Rows of a frame.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Columns of a frame.
    pub fn cols(&self) -> usize {
        self.cols
    }

    /// Type of the samples in the file.
    pub fn samples(&self) -> SampleType {
        self.samples
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Frame `i`, [rows, cols], in the unit of the file.
    ///
    /// # Errors
    /// There is no frame `i`, it cannot be read, or it holds a value that is no finite number.
    pub fn read(&mut self, i: usize) -> Result<Array2<f32>, SessionError> {
        if i >= self.len {
            let last = self.len - 1;
            let expected = format!("0 to {last}");
            return Err(SessionError::value(&self.path, "frame index", expected, i, "ask for a frame that is there"));
        }
        let values = match &mut self.source {
            Source::Npy(s) => s.read(&self.path, i)?,
            Source::Tif(s) => s.read(&self.path, i)?,
            Source::Made { maker, ahead: (next, frames) } => {
                if *next != i || frames.is_empty() {
                    *frames = maker.frames_from(i)?.into();
                }
                *next = i + 1;
                frames.pop_front().unwrap_or_default().into_raw_vec_and_offset().0
            }
        };
        if let Some(at) = values.iter().position(|v| !v.is_finite()) {
            return Err(SessionError::value(
                &self.path,
                format!("frame {i}, pixel ({}, {})", at / self.cols, at % self.cols),
                "a finite number",
                values[at],
                "replace or leave out the damaged frame",
            ));
        }
        let found = values.len();
        Array2::from_shape_vec((self.rows, self.cols), values).map_err(|_| SessionError::Shape {
            path: self.path.clone(),
            expected: format!("{} samples in frame {i}", self.rows * self.cols),
            found: found.to_string(),
            remedy: "write the stack again",
        })
    }
}
