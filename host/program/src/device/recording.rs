//! Recordings of streamed reconstructions.

use super::stream::StreamedFrame;
use anyhow::Context;
use ndarray::Array2;
use ommatidia_session::Recording;
use ommatidia_shared::image::Region;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

/// What the metadata of a recording say of space and time.
#[derive(Clone, Copy, Debug, Default)]
pub struct PageScale {
    /// Side of an object pixel, um.
    pub pixel_um: Option<f64>,
    /// Time from one page to the next, s, while no frame is missing.
    pub interval_s: Option<f64>,
}

/// A recording of a stream: reconstructions as OME-TIFF, and a CSV table beside it with the number and time of each.
pub struct StreamRecording {
    stack: Recording,
    table: File,
    files: RecordingFiles,
    pages: usize,
}

/// The files of a recording. Without pages they are none: then both are removed with this value.
struct RecordingFiles {
    stack: PathBuf,
    table: PathBuf,
    has_pages: bool,
}

impl Drop for RecordingFiles {
    fn drop(&mut self) {
        if !self.has_pages {
            for path in [&self.stack, &self.table] {
                let _ = std::fs::remove_file(path);
            }
        }
    }
}

impl StreamRecording {
    /// First line of the table.
    pub const HEADING: &'static str = "page,frame,time_s,dropped_before,saturated_px,field_frame\n";

    /// The table that belongs to a recording: the same name with suffix .csv.
    pub fn table_path(recording: &Path) -> PathBuf {
        recording.with_extension("csv")
    }

    /// Creates the TIFF file `path` and the table beside it; pages have the size of `region`, and `scale` goes into the
    /// metadata of the TIFF.
    ///
    /// # Errors
    /// A file cannot be created.
    pub fn create(path: &Path, region: Region, scale: PageScale) -> anyhow::Result<Self> {
        let stack = Recording::create(path, [region.rows.into(), region.cols.into()])?
            .with_pixel(scale.pixel_um)
            .with_interval(scale.interval_s);
        let files = RecordingFiles { stack: path.into(), table: Self::table_path(path), has_pages: false };
        let named = || files.table.display().to_string();
        let mut table = File::create(&files.table).with_context(named)?;
        table.write_all(Self::HEADING.as_bytes()).with_context(named)?;
        Ok(Self { stack, table, files, pages: 0 })
    }

    /// The time from one page to the next that the TIFF states, s: `None` where it is unknown, or frames are missing.
    pub fn interval_s(&self) -> Option<f64> {
        self.stack.interval_s()
    }

    /// Appends a reconstruction. Both files are readable afterwards.
    ///
    /// # Errors
    /// A file cannot be written. Earlier pages stay.
    pub fn push(&mut self, frame: &StreamedFrame) -> anyhow::Result<()> {
        let StreamedFrame { report, dropped_before, .. } = frame;
        if self.pages > 0 && *dropped_before > 0 {
            self.stack.forget_interval()?;
        }
        let values = frame.object.iter().map(|half| half.to_f32()).collect();
        let shape = (report.region.rows.into(), report.region.cols.into());
        self.stack.push(Array2::from_shape_vec(shape, values)?.view())?;
        let (page, time, saturated) = (self.pages, frame.at.as_secs_f64(), report.saturated_px);
        let StreamedFrame { frame, field_frame, .. } = frame;
        writeln!(self.table, "{page},{frame},{time:.6},{dropped_before},{saturated},{field_frame}")
            .with_context(|| self.files.table.display().to_string())?;
        self.pages += 1;
        self.files.has_pages = true;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_recording_without_pages_leaves_no_files() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.tif");
        let region = Region { row: 0, col: 0, rows: 2, cols: 2 };
        let recording = StreamRecording::create(&path, region, PageScale::default()).unwrap();
        assert!(path.exists() && StreamRecording::table_path(&path).exists());
        drop(recording);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
