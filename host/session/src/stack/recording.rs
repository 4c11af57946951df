//! A stack that grows while frames arrive: an OME-TIFF that can be read after each frame, even if the program is
//! killed.

use super::layout::{Container, SampleType, StackSpec, shown_suffix};
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
    interval_s: Option<f64>,
    /// Where the description states the number of pages and the interval.
    described: Described,
}

/// Places in the description that change later, bytes from the start of the file.
#[derive(Default)]
struct Described {
    /// The number of pages, twice.
    counts: Vec<u64>,
    /// The interval: its attributes.
    interval: Option<std::ops::Range<u64>>,
}

impl Recording {
    /// Starts a recording of frames of [rows, cols]. An existing file at `path` is overwritten.
    ///
    /// # Errors
    /// The suffix is not .tif/.tiff, or the file cannot be created.
    pub fn create(path: &Path, [rows, cols]: [usize; 2]) -> Result<Self, SessionError> {
        if Container::by_suffix(path) != Some(Container::Tif) {
            let remedy = "record as .tif, to which pages can be appended";
            return Err(SessionError::value(path, "suffix", ".tif or .tiff", shown_suffix(path), remedy));
        }
        let io = |e| SessionError::io(path, e);
        let file = File::create(path).map_err(io)?;
        let patch = OpenOptions::new().read(true).write(true).open(path).map_err(io)?;
        let out = TiffEncoder::new_big(file).map_err(|e| {
            let _ = std::fs::remove_file(path);
            SessionError::tif(path, e)
        })?;
        let spec = StackSpec { frames: 0, rows, cols, samples: SampleType::F32, pixel_um: None };
        Ok(Self { path: path.into(), spec, out, patch, interval_s: None, described: Described::default() })
    }

    /// Gives the side of a pixel, um, for the OME metadata.
    #[must_use]
    pub fn with_pixel(self, pixel_um: Option<f64>) -> Self {
        Self { spec: StackSpec { pixel_um, ..self.spec }, ..self }
    }

    /// Gives the time from one page to the next, s, for the OME metadata.
    #[must_use]
    pub fn with_interval(self, interval_s: Option<f64>) -> Self {
        Self { interval_s, ..self }
    }

    /// The time from one page to the next that the metadata state, s.
    pub fn interval_s(&self) -> Option<f64> {
        self.interval_s
    }

    /// Takes the interval out of the metadata: the pages are not evenly spaced in time, since frames are missing.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn forget_interval(&mut self) -> Result<(), SessionError> {
        self.interval_s = None;
        let Some(at) = self.described.interval.take() else { return Ok(()) };
        let blanks = vec![b' '; (at.end - at.start) as usize];
        let written = self.patch.seek(SeekFrom::Start(at.start)).and_then(|_| self.patch.write_all(&blanks));
        written.map_err(|e| SessionError::io(&self.path, e))
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
        let description = first.then(|| ome::description(&self.spec, self.interval_s, &number(1)));
        push_page(&mut self.out, &self.spec, frame.iter().copied().collect(), description)
            .map_err(|e| SessionError::tif(&self.path, e))?;
        self.count(first).map_err(|e| SessionError::io(&self.path, e))
    }

    /// Updates the number of pages in the OME description.
    fn count(&mut self, first: bool) -> std::io::Result<()> {
        if first {
            let mut start = Vec::new();
            Read::by_ref(&mut self.patch).take(DESCRIBED_WITHIN).read_to_end(&mut start)?;
            let after = |text: &str| find(&start, text).map(|at| at.end);
            let interval = find(&start, " TimeIncrement=\"").zip(find(&start, "TimeIncrementUnit=\"s\""));
            self.described = Described {
                counts: [after("SizeT=\""), after("PlaneCount=\"")].into_iter().flatten().collect(),
                interval: interval.map(|(first, last)| first.start..last.end),
            };
        }
        for at in &self.described.counts {
            self.patch.seek(SeekFrom::Start(*at))?;
            self.patch.write_all(number(self.spec.frames).as_bytes())?;
        }
        Ok(())
    }
}

/// Where a text lies in bytes.
fn find(bytes: &[u8], text: &str) -> Option<std::ops::Range<u64>> {
    let at = bytes.windows(text.len()).position(|window| window == text.as_bytes())? as u64;
    Some(at..at + text.len() as u64)
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
    fn pixel_size_and_interval_are_written_and_the_interval_goes_where_frames_are_missing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("recording.tif");
        // A size whose digits are those of a number of pages.
        let (pixel_um, interval_s) = (0.0000000001, 0.05);
        let created = Recording::create(&path, [2, 3]).unwrap();
        let mut recording = created.with_pixel(Some(pixel_um)).with_interval(Some(interval_s));
        let page = Array2::zeros((2, 3));
        recording.push(page.view()).unwrap();
        recording.push(page.view()).unwrap();
        let scale = || FrameReader::open(&path).unwrap().scale();
        assert_eq!((scale().pixel_um, scale().interval_s), (Some([pixel_um; 2]), Some(interval_s)));
        recording.forget_interval().unwrap();
        recording.push(page.view()).unwrap();
        assert_eq!((scale().pixel_um, scale().interval_s), (Some([pixel_um; 2]), None));
        assert_eq!(FrameReader::open(&path).unwrap().len(), 3);
    }

    #[test]
    fn a_container_that_cannot_grow_is_refused() {
        let error = Recording::create("objects.npy".as_ref(), [1, 1]).err().unwrap().to_string();
        assert!(error.contains("record as .tif"), "{error}");
    }
}
