//! Recordings of streamed reconstructions.

use super::stream::StreamedFrame;
use anyhow::Context;
use ndarray::Array2;
use ommatidia_session::Recording;
use ommatidia_shared::image::Region;
use ommatidia_shared::wire::{CameraSettings, Capture, SensorRegion, Trigger};
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Pages whose exposures started at times that differ by more than this share of the interval are not evenly spaced.
const UNEVEN: f64 = 0.01;

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
    /// The last frame of the camera.
    last: Option<Capture>,
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
    /// How the first line of a table begins.
    pub const START: &'static str = "page,frame,time_s,dropped_before,saturated_px,field_frame";
    /// The rest of that line: how the camera of the device took the frame. Without a camera these fields are empty.
    const CAMERA: &'static str = "camera_frame,missed_before,exposure_start_s,exposure_s,analog_gain,led,interval_s,\
                                  trigger,row,col,rows,cols,bin,restarted_before";

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
        writeln!(table, "{},{}", Self::START, Self::CAMERA).with_context(named)?;
        Ok(Self { stack, table, files, pages: 0, last: None })
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
        let StreamedFrame { report, dropped_before, restarted_before, .. } = frame;
        let capture = report.capture;
        let since_last = capture.zip(self.last);
        let step_s = since_last.map(|(now, last)| now.start_us.saturating_sub(last.start_us) as f64 / 1e6);
        self.last = capture;
        let uneven =
            self.interval_s().zip(step_s).is_some_and(|(interval, step)| (step / interval - 1.0).abs() > UNEVEN);
        if self.pages > 0 && (*dropped_before > 0 || *restarted_before || uneven) {
            self.stack.forget_interval()?;
        }
        let values = frame.object.iter().map(|half| half.to_f32()).collect();
        let shape = (report.region.rows.into(), report.region.cols.into());
        self.stack.push(Array2::from_shape_vec(shape, values)?.view())?;
        let (page, time, saturated) = (self.pages, frame.at.as_secs_f64(), report.saturated_px);
        let StreamedFrame { frame, field_frame, missed_before, restarted_before, .. } = frame;
        let camera = capture.map_or(",".repeat(Self::CAMERA.matches(',').count()), |capture| {
            fields(&capture, *missed_before) + if *restarted_before { ",1" } else { ",0" }
        });
        writeln!(self.table, "{page},{frame},{time:.6},{dropped_before},{saturated},{field_frame},{camera}")
            .with_context(|| self.files.table.display().to_string())?;
        self.pages += 1;
        self.files.has_pages = true;
        Ok(())
    }
}

/// How a frame was taken, as fields of the table.
fn fields(capture: &Capture, missed_before: u32) -> String {
    let Capture { number, start_us, settings } = *capture;
    let CameraSettings { region, trigger, .. } = settings;
    let [start, exposure, interval] = [start_us, settings.exposure_us.into(), settings.interval_us.into()].map(seconds);
    let (gain, led) = (f64::from(settings.analog_gain_thousandths) / 1e3, f64::from(settings.led_permille) / 1e3);
    let trigger = match trigger {
        Trigger::Device => "device",
        Trigger::Input => "input",
    };
    let SensorRegion { row, col, rows, cols, bin } = region;
    format!(
        "{number},{missed_before},{start},{exposure},{gain},{led},{interval},{trigger},{row},{col},{rows},{cols},{bin}"
    )
}

/// Microseconds as seconds, exactly.
fn seconds(us: u64) -> String {
    format!("{}.{:06}", us / 1_000_000, us % 1_000_000)
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
