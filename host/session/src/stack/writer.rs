//! Writes the frames of a stack one at a time. The file appears complete or not at all.

use super::layout::{Container, SampleType, StackSpec};
use super::npy_header::NpyHeader;
use super::ome;
use super::video::{self, VideoWriter};
use super::zarr::ZarrWriter;
use crate::artifact;
use crate::error::SessionError;
use crate::space::{need_file_size, need_space};
use ndarray::ArrayView2;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use tempfile::{NamedTempFile, TempDir};
use tiff::TiffResult;
use tiff::encoder::{TiffEncoder, TiffKind, TiffKindBig, TiffKindStandard, colortype};
use tiff::tags::Tag;

/// What to do about an error that only a mistake in this program can cause.
pub(super) const CALLER_ERROR: &str = "this is an error in the program: please report it";

/// Writes the frames of a stack one at a time, as .npy, OME-TIFF, OME-Zarr (.zarr) or video (.avi, .mp4) by the suffix
/// of the file name. The file appears when [`FrameWriter::finish`] returns.
#[derive(Debug)]
pub struct FrameWriter {
    path: PathBuf,
    /// The path in messages.
    shown: PathBuf,
    spec: StackSpec,
    interval_s: Option<f64>,
    place: Place,
    sink: Sink,
    pushed: usize,
}

/// What is being written, until it appears at its path.
#[derive(Debug)]
enum Place {
    File(NamedTempFile),
    Folder(TempDir),
}

enum Sink {
    Npy(BufWriter<File>),
    Tif(TiffEncoder<File, TiffKindStandard>),
    BigTif(TiffEncoder<File, TiffKindBig>),
    Zarr(Box<ZarrWriter>),
    Video(VideoWriter),
}

impl std::fmt::Debug for Sink {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Npy(_) => "Npy",
            Self::Tif(_) => "Tif",
            Self::BigTif(_) => "BigTif",
            Self::Zarr(_) => "Zarr",
            Self::Video(_) => "Video",
        })
    }
}

/// Largest plain TIFF, bytes: its offsets have 32 bits, and its tables need some room. Larger stacks become BigTIFF.
const TIFF_BYTES: u64 = 4_000_000_000;

impl FrameWriter {
    /// Starts a stack of the size in `spec` that will appear at `path`.
    ///
    /// # Errors
    /// The suffix is none of .npy, .tif, .tiff, .zarr, .avi and .mp4, the folder is missing or not writable, the disk
    /// has no room for the whole stack, or ffmpeg, which a video needs, is not installed.
    pub fn create(path: &Path, spec: StackSpec) -> Result<Self, SessionError> {
        Self::create_as(path, path, spec)
    }

    /// Whether a stack can be written to `path`, before hours of work for it.
    ///
    /// # Errors
    /// The suffix is none of those of [`FrameWriter::create`], or ffmpeg, which a video needs, is not installed.
    pub fn check_name(path: &Path) -> Result<(), SessionError> {
        match Container::to_write(path, path)? {
            Container::Avi | Container::Mp4 => video::need_ffmpeg(path),
            _ => Ok(()),
        }
    }

    /// As [`FrameWriter::create`], for a file at `path` that messages name `shown`: it lies in a temporary folder.
    pub(crate) fn create_as(path: &Path, shown: &Path, spec: StackSpec) -> Result<Self, SessionError> {
        let io = |e| SessionError::io(shown, e);
        let container = Container::to_write(path, shown)?;
        let bytes = spec.bytes().saturating_add(1024 * spec.frames as u64);
        let coarser = if container == Container::Zarr { bytes / 3 } else { 0 };
        if container != Container::Zarr {
            need_file_size(shown, bytes)?;
        }
        need_space(artifact::folder_of(path), shown, bytes.saturating_add(coarser))?;
        let tif = |e| SessionError::tif(shown, e);
        let new = |place, sink| Self {
            path: path.into(),
            shown: shown.into(),
            spec,
            interval_s: None,
            place,
            sink,
            pushed: 0,
        };
        if container == Container::Zarr {
            let folder = artifact::temporary_folder_beside(path).map_err(io)?;
            let sink = Sink::Zarr(Box::new(ZarrWriter::create(folder.path(), spec).map_err(io)?));
            return Ok(new(Place::Folder(folder), sink));
        }
        let file = artifact::temporary_beside(path).map_err(io)?;
        let out = || file.as_file().try_clone().map_err(io);
        let sink = match container {
            Container::Npy => Sink::Npy(npy(out()?, &spec).map_err(io)?),
            Container::Tif if bytes < TIFF_BYTES => Sink::Tif(TiffEncoder::new(out()?).map_err(tif)?),
            Container::Tif => Sink::BigTif(TiffEncoder::new_big(out()?).map_err(tif)?),
            _ => Sink::Video(VideoWriter::create(artifact::folder_of(path), shown)?),
        };
        Ok(new(Place::File(file), sink))
    }

    /// Gives the time from one frame to the next, s, for the OME metadata of a TIFF.
    #[must_use]
    pub fn with_interval(self, interval_s: Option<f64>) -> Self {
        Self { interval_s, ..self }
    }

    /// Appends a frame, [rows, cols].
    ///
    /// # Errors
    /// The frame has another size than announced, holds a non-finite value or one outside the range of the sample type,
    /// there are more frames than announced, or the disk is full.
    pub fn push(&mut self, frame: ArrayView2<'_, f32>) -> Result<(), SessionError> {
        self.check(frame)?;
        let spec = &self.spec;
        let values = frame.iter().copied();
        let description = (self.pushed == 0).then(|| ome::description(spec, self.interval_s, &spec.frames.to_string()));
        match &mut self.sink {
            Sink::Npy(out) => {
                let bytes: Vec<u8> = match spec.samples {
                    SampleType::U8 => values.map(|v| v.round() as u8).collect(),
                    SampleType::U16 => values.flat_map(|v| (v.round() as u16).to_le_bytes()).collect(),
                    SampleType::F32 => values.flat_map(f32::to_le_bytes).collect(),
                };
                out.write_all(&bytes).map_err(|e| SessionError::io(&self.shown, e))?;
            }
            Sink::Tif(out) => {
                push_page(out, spec, values.collect(), description).map_err(|e| SessionError::tif(&self.shown, e))?
            }
            Sink::BigTif(out) => {
                push_page(out, spec, values.collect(), description).map_err(|e| SessionError::tif(&self.shown, e))?
            }
            Sink::Zarr(out) => out.push(values.collect()).map_err(|e| SessionError::io(&self.shown, e))?,
            Sink::Video(out) => {
                out.push(&values.collect::<Vec<f32>>()).map_err(|e| SessionError::io(&self.shown, e))?
            }
        }
        self.pushed += 1;
        Ok(())
    }

    fn check(&self, frame: ArrayView2<'_, f32>) -> Result<(), SessionError> {
        let spec = &self.spec;
        if frame.dim() != (spec.rows, spec.cols) || self.pushed == spec.frames {
            return Err(SessionError::Shape {
                path: self.shown.clone(),
                expected: format!("{} frames of {} x {}", spec.frames, spec.rows, spec.cols),
                found: format!("frame {} of {} x {}", self.pushed, frame.nrows(), frame.ncols()),
                remedy: CALLER_ERROR,
            });
        }
        let (low, high) = match spec.samples {
            SampleType::U8 => (0.0, f32::from(u8::MAX)),
            SampleType::U16 => (0.0, f32::from(u16::MAX)),
            SampleType::F32 => (f32::MIN, f32::MAX),
        };
        match frame.indexed_iter().find(|(_, v)| !(low..=high).contains(*v)) {
            None => Ok(()),
            Some(((r, c), v)) => Err(SessionError::value(
                &self.shown,
                format!("frame {}, pixel ({r}, {c})", self.pushed),
                format!("a value that {} can hold, {low} to {high}", spec.samples.name()),
                v,
                "scale the frames, or write float32",
            )),
        }
    }

    /// Completes the stack: the file appears at its path.
    ///
    /// # Errors
    /// Fewer frames were pushed than announced, or the disk is full. No file is left behind.
    pub fn finish(self) -> Result<(), SessionError> {
        let io = |e| SessionError::io(&self.shown, e);
        if self.pushed != self.spec.frames {
            return Err(SessionError::Shape {
                path: self.shown.clone(),
                expected: format!("{} frames", self.spec.frames),
                found: self.pushed.to_string(),
                remedy: CALLER_ERROR,
            });
        }
        match (self.sink, &self.place) {
            (Sink::Npy(mut out), _) => out.flush().map_err(io)?,
            (Sink::Video(out), Place::File(file)) => {
                out.finish(file.path(), &self.shown, &self.spec, self.interval_s)?;
            }
            (Sink::Zarr(out), _) => {
                let name = self.path.file_stem().unwrap_or_default().to_string_lossy();
                out.finish(&name, self.interval_s).map_err(io)?;
            }
            _ => {}
        }
        match self.place {
            Place::File(file) => {
                file.as_file().sync_all().map_err(io)?;
                file.persist(&self.path).map_err(|e| io(e.error))?;
            }
            Place::Folder(folder) => artifact::replace_folder(folder, &self.path).map_err(io)?,
        }
        Ok(())
    }
}

fn npy(out: File, spec: &StackSpec) -> std::io::Result<BufWriter<File>> {
    let mut out = BufWriter::new(out);
    let type_name = match spec.samples {
        SampleType::U8 => "|u1",
        SampleType::U16 => "<u2",
        SampleType::F32 => "<f4",
    };
    out.write_all(&NpyHeader::bytes(type_name, [spec.frames, spec.rows, spec.cols]))?;
    Ok(out)
}

pub(super) fn push_page<K: TiffKind>(
    out: &mut TiffEncoder<File, K>,
    spec: &StackSpec,
    values: Vec<f32>,
    description: Option<String>,
) -> TiffResult<()> {
    let (width, height) = (spec.cols as u32, spec.rows as u32);
    macro_rules! page {
        ($color:ty, $data:expr) => {{
            let mut image = out.new_image::<$color>(width, height)?;
            if let Some(text) = &description {
                image.encoder().write_tag(Tag::ImageDescription, text.as_str())?;
            }
            image.write_data($data)
        }};
    }
    match spec.samples {
        SampleType::U8 => {
            page!(colortype::Gray8, &values.iter().map(|v| v.round() as u8).collect::<Vec<_>>())
        }
        SampleType::U16 => {
            page!(colortype::Gray16, &values.iter().map(|v| v.round() as u16).collect::<Vec<_>>())
        }
        SampleType::F32 => page!(colortype::Gray32Float, &values),
    }
}
