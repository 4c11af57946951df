//! MATLAB .mat files: level 5 (`save`, versions 6 and 7) and version 7.3, which is HDF5. An array of size (rows, cols,
//! frames) is a stack.

mod hdf5;
mod level5;
mod variables;

use super::layout::Shape;
use crate::error::SessionError;
use std::fs::File;
use std::io::Read;
use std::path::Path;

const KIND: &str = ".mat";

/// Largest frame that is read, bytes. A larger one counts as damage.
const MAX_FRAME_BYTES: u64 = 1 << 29;

/// An open array of a .mat file.
#[derive(Debug)]
pub(super) enum MatSource {
    Level5(Box<level5::Level5Source>),
    Hdf5(Box<hdf5::Hdf5Source>),
}

impl MatSource {
    /// Opens the array of the given name, or the only array of three axes.
    pub fn open(path: &Path, variable: Option<&str>) -> Result<(Shape, Self), SessionError> {
        let mut start = Vec::new();
        let read = File::open(path).and_then(|f| f.take(128).read_to_end(&mut start));
        read.map_err(|e| SessionError::io(path, e))?;
        // Either kind has a text of 116 bytes first; four of them are not zero, by which level 4 is told apart.
        match start.get(124..128) {
            Some([1, 0, b'M', b'I'] | [0, 1, b'I', b'M']) if !start[..4].contains(&0) => {
                level5::Level5Source::open(path, variable).map(|(shape, s)| (shape, Self::Level5(Box::new(s))))
            }
            Some([2, 0, b'M', b'I'] | [0, 2, b'I', b'M']) => {
                hdf5::Hdf5Source::open(path, variable).map(|(shape, s)| (shape, Self::Hdf5(Box::new(s))))
            }
            _ if start.starts_with(hdf5::SIGNATURE) => {
                hdf5::Hdf5Source::open(path, variable).map(|(shape, s)| (shape, Self::Hdf5(Box::new(s))))
            }
            _ => Err(SessionError::value(
                path,
                "version of the .mat file",
                "5 (MATLAB 5 to 7) or 7.3",
                "none of them",
                "save the array with a later MATLAB, or as .npy",
            )),
        }
    }

    /// Frame `i`, row by row.
    pub fn read(&mut self, path: &Path, i: usize) -> Result<Vec<f32>, SessionError> {
        match self {
            Self::Level5(source) => source.read(path, i),
            Self::Hdf5(source) => source.read(path, i),
        }
    }
}

/// A frame that lies column by column, row by row.
fn by_rows(values: &[f32], rows: usize, cols: usize) -> Vec<f32> {
    (0..rows).flat_map(|r| (0..cols).map(move |c| values[c * rows + r])).collect()
}
