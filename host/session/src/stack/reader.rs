//! Reads the frames of a stack one at a time.

use super::layout::{Container, SampleType, Shape, StackScale};
use super::series::{self, Part, SeriesSource};
use super::{mat, npy, tif, zarr};
use crate::error::SessionError;
use ndarray::Array2;
use std::collections::VecDeque;
use std::fmt::Debug;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Computes the frames of a stack when they are read, instead of keeping them in a file.
///
/// A frame is computed again each time it is read.
pub trait ComputedFrames: Debug + Send + Sync {
    /// Size of the stack, [frames, rows, cols].
    fn shape(&self) -> [usize; 3];

    /// Frame `i`, [rows, cols], DN, followed by any later frames that were computed along with it. The same call
    /// returns the same frames.
    ///
    /// # Errors
    /// The data that the frames are computed from cannot be read.
    fn frames_from(&self, i: usize) -> Result<Vec<Array2<f32>>, SessionError>;
}

/// Reads the frames of a stack one at a time, in any order, and holds one frame in memory.
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
    Mat(Box<mat::MatSource>),
    Zarr(Box<zarr::ZarrSource>),
    Series(Box<SeriesSource>),
    Computed {
        frames: Arc<dyn ComputedFrames>,
        /// Index of the first frame that was computed ahead.
        next: usize,
        /// Frames computed ahead.
        ahead: VecDeque<Array2<f32>>,
    },
}

impl FrameReader {
    /// Names of the AVIs in its folder that are no part of the stack: videos of another camera.
    pub fn left_out(&self) -> Vec<String> {
        if self.path.is_dir() { series::left_out(&self.path, self.parts()) } else { Vec::new() }
    }

    /// Opens a stack and checks its header, its sample type and the size of the file. A folder of numbered .avi or .tif
    /// files is one stack; what is damaged in them is listed by [`FrameReader::parts`]. So is a folder of Zarr. Of a
    /// .mat file the only array of three axes is read.
    ///
    /// # Errors
    /// The file is missing, neither .npy nor .tif nor .avi nor .mat nor Zarr, of a sample type that is not read, not an
    /// array [frames, rows, cols] (in a .mat file: of size rows, cols, frames), empty, or cut short.
    pub fn open(path: &Path) -> Result<Self, SessionError> {
        Self::open_variable(path, None)
    }

    /// As [`FrameReader::open`]; `variable` names the array of a .mat file that holds more than one.
    ///
    /// # Errors
    /// As [`FrameReader::open`]; or the file has no array of this name, or is no .mat file.
    pub fn open_variable(path: &Path, variable: Option<&str>) -> Result<Self, SessionError> {
        let series = |(shape, s)| (shape, Source::Series(Box::new(s)));
        // A folder has no suffix that could be wrong.
        if path.extension().is_none() && !path.exists() {
            return Err(SessionError::io(path, std::io::ErrorKind::NotFound.into()));
        }
        // To open a pipe would wait for a writer, without end where there is none.
        if std::fs::metadata(path).is_ok_and(|found| !found.is_file() && !found.is_dir()) {
            let remedy = "write the frames into a file, and name that";
            return Err(SessionError::value(path, "stack", "a file or a folder", "a pipe or a device", remedy));
        }
        if let Some(name) = variable.filter(|_| Container::by_suffix(path) != Some(Container::Mat)) {
            let remedy = "leave the name out: only .mat files hold several arrays";
            return Err(SessionError::value(path, "variable", "none", name, remedy));
        }
        let (shape, source) = if path.is_dir() && zarr::is_zarr(path) {
            zarr::ZarrSource::open(path).map(|(shape, s)| (shape, Source::Zarr(Box::new(s))))?
        } else if path.is_dir() {
            SeriesSource::of_folder(path).map(series)?
        } else {
            match Container::to_read(path)? {
                Container::Npy => npy::NpySource::open(path).map(|(shape, s)| (shape, Source::Npy(s)))?,
                Container::Tif => tif::TifSource::open(path).map(|(shape, s)| (shape, Source::Tif(Box::new(s))))?,
                Container::Avi => SeriesSource::of_file(path).map(series)?,
                Container::Mat => {
                    mat::MatSource::open(path, variable).map(|(shape, s)| (shape, Source::Mat(Box::new(s))))?
                }
                // A folder of that name, which does not exist: what is no folder was refused.
                Container::Mp4 | Container::Zarr => {
                    return Err(SessionError::io(path, std::io::ErrorKind::NotFound.into()));
                }
            }
        };
        let Shape { len, rows, cols, samples } = shape;
        if len == 0 || rows == 0 || cols == 0 {
            return Err(SessionError::Shape {
                path: path.into(),
                expected: "at least one frame of at least one pixel".into(),
                found: format!("[{len}, {rows}, {cols}]"),
                remedy: "write the stack again, with its frames",
            });
        }
        Ok(Self { path: path.into(), len, rows, cols, samples, source })
    }

    /// A reader of frames that are computed when they are read. `name` stands for the file in error messages.
    pub fn computed(name: &Path, frames: Arc<dyn ComputedFrames>) -> Self {
        let [len, rows, cols] = frames.shape();
        let source = Source::Computed { frames, next: 0, ahead: VecDeque::new() };
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

    /// Type of the samples in the file; `U16` for computed frames.
    pub fn samples(&self) -> SampleType {
        self.samples
    }

    /// What the file says of pixel size and frame interval.
    pub fn scale(&self) -> StackScale {
        match &self.source {
            Source::Tif(tif) => tif.scale,
            Source::Series(series) => series.scale,
            Source::Zarr(zarr) => zarr.scale,
            Source::Npy(_) | Source::Mat(_) | Source::Computed { .. } => StackScale::default(),
        }
    }

    /// The files of a stack of AVIs or of a folder, in order, with what is damaged in them; empty for other stacks.
    pub fn parts(&self) -> &[Part] {
        match &self.source {
            Source::Series(series) => series.parts(),
            _ => &[],
        }
    }

    /// Path of the file or folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Reads frame `i`, [rows, cols], in the unit of the file.
    ///
    /// # Errors
    /// There is no frame `i`, it cannot be read, or it holds a non-finite value.
    pub fn read(&mut self, i: usize) -> Result<Array2<f32>, SessionError> {
        if i >= self.len {
            let last = self.len - 1;
            let expected = format!("0 to {last}");
            return Err(SessionError::value(&self.path, "frame index", expected, i, "choose a frame of the stack"));
        }
        let values = match &mut self.source {
            Source::Npy(s) => s.read(&self.path, i)?,
            Source::Tif(s) => s.read(&self.path, i)?,
            Source::Mat(s) => s.read(&self.path, i)?,
            Source::Zarr(s) => s.read(&self.path, i)?,
            Source::Series(s) => s.read(i)?,
            Source::Computed { frames, next, ahead } => {
                if *next != i || ahead.is_empty() {
                    *ahead = frames.frames_from(i)?.into();
                }
                *next = i + 1;
                ahead.pop_front().unwrap_or_default().into_raw_vec_and_offset().0
            }
        };
        if let Some(at) = values.iter().position(|v| !v.is_finite()) {
            return Err(SessionError::value(
                &self.path,
                format!("frame {i}, pixel ({}, {})", at / self.cols, at % self.cols),
                "a finite number",
                values[at],
                "replace the damaged frame, or leave it out",
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
