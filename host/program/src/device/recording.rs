//! Recordings of streamed reconstructions.

use super::stream::StreamedFrame;
use anyhow::Context;
use ndarray::Array2;
use ommatidia_session::Recording;
use ommatidia_shared::image::Region;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

/// A recording of a stream: reconstructions as OME-TIFF, and a CSV table beside it with the number and time of each.
pub struct StreamRecording {
    stack: Recording,
    table: File,
    pages: usize,
}

impl StreamRecording {
    /// First line of the table.
    pub const HEADING: &'static str = "page,frame,time_s,dropped_before,saturated_px,field_frame\n";

    /// The table that belongs to a recording: the same name with suffix .csv.
    pub fn table_path(recording: &Path) -> PathBuf {
        recording.with_extension("csv")
    }

    /// Creates the TIFF file `path` and the table beside it; pages have the size of `region`.
    ///
    /// # Errors
    /// A file cannot be created.
    pub fn create(path: &Path, region: Region) -> anyhow::Result<Self> {
        let stack = Recording::create(path, [region.rows.into(), region.cols.into()])?;
        let table = Self::table_path(path);
        let mut table = File::create(&table).with_context(|| table.display().to_string())?;
        table.write_all(Self::HEADING.as_bytes())?;
        Ok(Self { stack, table, pages: 0 })
    }

    /// Appends a reconstruction. Both files are readable afterwards.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn push(&mut self, frame: &StreamedFrame) -> anyhow::Result<()> {
        let StreamedFrame { report, dropped_before, .. } = frame;
        let values = frame.object.iter().map(|half| half.to_f32()).collect();
        let shape = (report.region.rows.into(), report.region.cols.into());
        self.stack.push(Array2::from_shape_vec(shape, values)?.view())?;
        let (page, time, saturated) = (self.pages, frame.at.as_secs_f64(), report.saturated_px);
        let StreamedFrame { frame, field_frame, .. } = frame;
        writeln!(self.table, "{page},{frame},{time:.6},{dropped_before},{saturated},{field_frame}")?;
        self.pages += 1;
        Ok(())
    }
}
