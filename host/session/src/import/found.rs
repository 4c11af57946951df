//! What was found in a recording, for programs and for people.

use super::losses::{Losses, count, list};
use super::survey::Survey;
use super::{Opened, Source, Written};
use crate::manifest::StackEntry;
use serde::Serialize;
use std::fmt::Write;

/// What was found in a recording.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Found {
    /// The recording as it was named.
    pub source: String,
    /// Role of its stack.
    pub role: &'static str,
    /// File of the stack, as the manifest has it.
    pub file: String,
    /// Device, where the metadata name it.
    pub device: Option<String>,
    /// Number of whole frames: the frames of the stack.
    pub frames: usize,
    /// Rows of a frame.
    pub rows: usize,
    /// Columns of a frame.
    pub cols: usize,
    /// Type of the samples: uint8, uint16 or float32.
    pub samples: &'static str,
    /// Largest value, DN.
    pub max_dn: f64,
    /// Number of files.
    pub files: usize,
    /// Frames a second by the timestamps, without the gaps.
    pub rate_hz: Option<f64>,
    /// Frames a second as the recorder was set.
    pub configured_rate_hz: Option<f64>,
    /// Number of timestamps; `None` without a table of them.
    pub timestamps: Option<usize>,
    /// Number of timestamps that belong to no whole frame.
    pub timestamps_unused: usize,
    /// Number of frames at the end without a timestamp, whose times are extrapolated.
    pub times_estimated: usize,
    /// Number of frames between others without a timestamp, whose times are interpolated.
    pub times_interpolated: usize,
    /// How timestamps were assigned to frames, where their numbers differ.
    pub assigned: Option<&'static str>,
    /// Frames that equal the frame before in every pixel.
    pub repeated: Vec<usize>,
    /// Files of the session that were written for it; that of the first recording has the manifest, too.
    pub written: Vec<Written>,
    /// What is lost of it.
    #[serde(flatten)]
    pub losses: Losses,
    /// What is lost and what could not be read, in sentences.
    pub warnings: Vec<String>,
    /// What else was taken from where.
    pub notes: Vec<String>,
}

impl Found {
    pub(super) fn new(source: &Source, entry: StackEntry, recording: &Opened, survey: &Survey) -> Self {
        let (frames, parts) = (&recording.frames, recording.frames.parts());
        let times = recording.times.clone().unwrap_or_default();
        let per_file = recording.metadata.as_ref().and_then(|m| m.frames_per_file);
        let losses = Losses::of(frames, recording.times.as_ref(), per_file);
        let damaged = |i: &usize| losses.damaged_frames.binary_search_by_key(i, |f| f.index).is_ok();
        let mut warnings = recording.warnings.clone();
        warnings.extend(losses.warnings(&source.path));
        Self {
            source: source.path.display().to_string(),
            role: recording.role.name(),
            file: entry.file,
            device: recording.metadata.as_ref().and_then(|m| m.device.clone()),
            frames: frames.len(),
            rows: frames.rows(),
            cols: frames.cols(),
            samples: frames.samples().name(),
            max_dn: survey.max_dn,
            files: parts.len().max(1),
            rate_hz: times.rate_hz(),
            configured_rate_hz: recording.metadata.as_ref().and_then(|m| m.frame_rate_hz),
            timestamps: recording.times.as_ref().map(|t| t.timestamps),
            timestamps_unused: times.unused,
            times_estimated: times.estimated,
            times_interpolated: times.interpolated.len(),
            assigned: times.assigned,
            // What stands in for a damaged frame is no frame that the recorder repeated.
            repeated: survey.repeated.iter().copied().filter(|i| !damaged(i)).collect(),
            written: Vec::new(),
            losses,
            warnings,
            notes: recording.notes.clone(),
        }
    }

    /// The report for people, without [`Found::warnings`] and notes; each line says one thing.
    pub fn text(&self) -> String {
        let mut out = String::new();
        // Writing to a string cannot fail.
        let mut line = |text: String| {
            let _ = writeln!(out, "{text}");
        };
        let device = self.device.as_ref().map_or(String::new(), |d| format!(" of {d}"));
        line(format!(
            "{}{device}: {} of {} x {} {} in {}, as {} ({})",
            self.source,
            count(self.frames, "frame"),
            self.rows,
            self.cols,
            self.samples,
            count(self.files, "file"),
            self.role,
            self.file
        ));
        match (self.rate_hz, self.configured_rate_hz) {
            (Some(rate), Some(set)) if rate.max(set) > UNLIKE * rate.min(set) => line(format!(
                "  rate        {rate:.3} Hz by the timestamps, but {set} Hz was set: the times are those of the \
                 timestamps; check that their table belongs to these frames"
            )),
            (Some(rate), Some(set)) => line(format!("  rate        {rate:.3} Hz by the timestamps; {set} Hz was set")),
            (Some(rate), None) => line(format!("  rate        {rate:.3} Hz by the timestamps")),
            (None, Some(set)) => {
                let what = if self.timestamps.is_some() { "none by the timestamps" } else { "no timestamps" };
                line(format!("  rate        {what}; {set} Hz was set"));
            }
            (None, None) => {}
        }
        if let Some(stamps) = self.timestamps {
            let of = format!("{stamps} for {}", count(self.frames, "frame"));
            let unused = match self.timestamps_unused {
                0 => String::new(),
                n => format!("; {n} without a whole frame"),
            };
            let estimated = match self.times_estimated {
                0 => String::new(),
                1 => "; the time of the last frame is extrapolated (column time_is)".into(),
                n => format!("; the times of the last {n} frames are extrapolated (column time_is)"),
            };
            let estimated = match self.times_interpolated {
                0 => estimated,
                1 => format!("{estimated}; 1 frame has no row, and a time by those of others (column time_is)"),
                n => format!("{estimated}; {n} frames have no row, and times by those of others (column time_is)"),
            };
            line(format!("  timestamps  {of}{unused}{estimated}"));
            if let Some(how) = self.assigned {
                line(format!("              rows are assigned to frames so that {how}"));
            }
        }
        match &self.repeated[..] {
            [] => {}
            [one] => line(format!("  repeated    1 frame equals the frame before: {one}")),
            all => line(format!("  repeated    {} frames equal the frame before: {}", all.len(), list(all))),
        }
        // Frames of the stack have other numbers in the recording.
        if self.files > 1 || !self.losses.torn.is_empty() {
            line(
                "  frames      are counted from 0, as in the session; its table has the file and the frame of each"
                    .into(),
            );
        }
        out
    }
}

/// Two rates that differ by more than this factor cannot both be right.
const UNLIKE: f64 = 1.5;
