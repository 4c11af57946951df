//! A stack that grows while frames arrive: an OME-TIFF that can be read after each frame, even if the program is
//! killed.

use super::layout::{Container, SampleType, StackSpec};
use super::ome;
use super::writer::{CALLER_ERROR, push_page};
use crate::error::SessionError;
use ndarray::ArrayView2;
use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use tiff::encoder::{TiffEncoder, TiffKindBig};

/// The OME description lies within this many bytes of the start of the file.
const DESCRIBED_WITHIN: u64 = 1 << 12;

/// Appends float32 frames to an OME-TIFF that can be read after every frame.
///
/// Unlike other outputs, the file exists from the start. Each page is written completely before the previous page
/// points to it; then the number of pages in the OME description is updated.
pub struct Recording {
    path: PathBuf,
    spec: StackSpec,
    out: TiffEncoder<File, TiffKindBig>,
    /// A second handle of the same file, with its own position.
    patch: File,
    /// Positions of the number of pages in the description, bytes from the start of the file.
    counts: Vec<u64>,
}

impl Recording {
    /// Starts a recording of frames of [rows, cols]. An existing file at `path` is overwritten.
    ///
    /// # Errors
    /// The suffix is not .tif/.tiff, or the file cannot be created.
    pub fn create(path: &Path, [rows, cols]: [usize; 2]) -> Result<Self, SessionError> {
        if Container::of(path)? != Container::Tif {
            let remedy = "record as .tif, to which pages can be appended";
            return Err(SessionError::value(path, "suffix", ".tif or .tiff", ".npy", remedy));
        }
        let io = |e| SessionError::io(path, e);
        let file = File::create(path).map_err(io)?;
        let patch = OpenOptions::new().read(true).write(true).open(path).map_err(io)?;
        let out = TiffEncoder::new_big(file).map_err(|e| SessionError::format(path, ".tif", e))?;
        let spec = StackSpec { frames: 0, rows, cols, samples: SampleType::F32, pixel_um: None };
        Ok(Self { path: path.into(), spec, out, patch, counts: Vec::new() })
    }

    /// Appends a frame, [rows, cols].
    ///
    /// # Errors
    /// The frame has another size than announced, or the disk is full. Earlier frames stay in the file.
    pub fn push(&mut self, frame: ArrayView2<'_, f32>) -> Result<(), SessionError> {
        let (rows, cols) = (self.spec.rows, self.spec.cols);
        if frame.dim() != (rows, cols) {
            return Err(SessionError::Shape {
                path: self.path.clone(),
                expected: format!("frames of {rows} x {cols}"),
                found: format!("frame {} of {} x {}", self.spec.frames, frame.nrows(), frame.ncols()),
                remedy: CALLER_ERROR,
            });
        }
        self.spec.frames += 1;
        let first = self.spec.frames == 1;
        let description = first.then(|| ome::description(&self.spec, None, &number(1)));
        push_page(&mut self.out, &self.spec, frame.iter().copied().collect(), description)
            .map_err(|e| SessionError::format(&self.path, ".tif", e))?;
        self.count(first).map_err(|e| SessionError::io(&self.path, e))
    }

    /// Updates the number of pages in the OME description.
    fn count(&mut self, first: bool) -> std::io::Result<()> {
        if first {
            let mut start = Vec::new();
            Read::by_ref(&mut self.patch).take(DESCRIBED_WITHIN).read_to_end(&mut start)?;
            let number = number(1);
            let places = start.windows(number.len()).enumerate().filter(|(_, bytes)| *bytes == number.as_bytes());
            self.counts = places.map(|(i, _)| i as u64).take(2).collect();
        }
        for at in &self.counts {
            self.patch.seek(SeekFrom::Start(*at))?;
            self.patch.write_all(number(self.spec.frames).as_bytes())?;
        }
        Ok(())
    }
}

/// A number of pages with a fixed number of digits, so that it can be overwritten in place.
fn number(pages: usize) -> String {
    format!("{pages:010}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::FrameReader;
    use ndarray::Array2;

    #[test]
    fn the_file_holds_every_pushed_page_without_being_finished() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("recording.tif");
        let page = |i: usize| Array2::from_shape_fn((5, 7), |(r, c)| (100 * i + 10 * r + c) as f32);
        let mut recording = Recording::create(&path, [5, 7]).unwrap();
        for i in 0..12 {
            recording.push(page(i).view()).unwrap();
            // The file as a killed program would leave it.
            let left = folder.path().join("left.tif");
            std::fs::copy(&path, &left).unwrap();
            let mut reader = FrameReader::open(&left).unwrap();
            assert_eq!(reader.len(), i + 1);
            assert_eq!([0, i].map(|i| reader.read(i).unwrap()), [0, i].map(page));
            let text = String::from_utf8_lossy(&std::fs::read(&left).unwrap()).into_owned();
            let count = format!("{:010}", i + 1);
            assert!(text.contains(&format!("SizeT=\"{count}\"")) && text.contains(&format!("PlaneCount=\"{count}\"")));
        }
        assert!(recording.push(Array2::zeros((5, 8)).view()).is_err());
    }

    #[test]
    fn a_container_that_cannot_grow_is_refused() {
        let error = Recording::create("objects.npy".as_ref(), [1, 1]).err().unwrap().to_string();
        assert!(error.contains("record as .tif"), "{error}");
    }
}
