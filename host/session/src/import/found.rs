//! What was found in a recording, for programs and for people.

use super::survey::Survey;
use super::times::{Gap, usual_first};
use super::{Opened, Source};
use crate::manifest::StackEntry;
use crate::stack::DECODED_FROM;
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
    /// Times between frames that are longer than others.
    pub gaps: Vec<Gap>,
    /// Frames whose timestamp is not later than that of the frame before.
    pub backwards: Vec<usize>,
    /// Frames that equal the frame before in every pixel.
    pub repeated: Vec<usize>,
    /// Frames that were left out since they end too early, have a damaged head, or have no data.
    pub torn: Vec<Torn>,
    /// Frames whose compressed data are damaged. They are in the stack, with wrong pixels.
    pub damaged_frames: Vec<DamagedFrame>,
    /// Files that are damaged at their end, or as a whole.
    pub damaged: Vec<String>,
    /// Files with fewer frames than they should have: name, frames, and how many a full file has, or the timestamps of
    /// the last.
    pub short: Vec<(String, usize, usize)>,
    /// Files that are missing.
    pub missing_files: Vec<u64>,
    /// What else was taken from where.
    pub notes: Vec<String>,
}

/// A frame whose compressed data are damaged.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DamagedFrame {
    /// Number of the frame in the stack, from 0.
    pub index: usize,
    /// The file.
    pub file: String,
    /// Number of the frame in the file, from 0.
    pub frame: usize,
    /// What is wrong, as the decoder has it.
    pub what: String,
}

/// A frame that was left out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Torn {
    /// The file.
    pub file: String,
    /// Number of the frame in the file, from 0.
    pub frame: usize,
    /// Whether it has no data at all.
    pub empty: bool,
}

/// Numbers that are missing between those of files of one frame each, at most a thousand: where most follow each other
/// at one step, which may be more than 1.
fn between(numbers: &[u64]) -> Vec<u64> {
    let steps: Vec<u64> = numbers.windows(2).filter_map(|w| w[1].checked_sub(w[0])).collect();
    let Some(step) = steps.iter().copied().min().filter(|step| *step > 0) else { return Vec::new() };
    let regular = steps.iter().filter(|s| **s == step).count();
    if steps.len() + 1 < numbers.len() || 2 * regular <= steps.len() {
        return Vec::new();
    }
    let missing = numbers.windows(2).flat_map(|w| (w[0] + step..w[1]).step_by(step as usize));
    missing.take(1000).collect()
}

impl Found {
    pub(super) fn new(source: &Source, entry: StackEntry, recording: &Opened, survey: &Survey) -> Self {
        let (frames, parts) = (&recording.frames, recording.frames.parts());
        let times = recording.times.clone().unwrap_or_default();
        let name = |path: &std::path::Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let mut torn = Vec::new();
        for part in parts {
            let of = |empty| move |frame: &usize| (*frame, empty);
            let mut all: Vec<(usize, bool)> =
                part.torn.iter().map(of(false)).chain(part.empty.iter().map(of(true))).collect();
            all.sort_unstable();
            torn.extend(all.into_iter().map(|(frame, empty)| Torn { file: name(&part.path), frame, empty }));
        }
        let full = recording.metadata.as_ref().and_then(|m| m.frames_per_file);
        let full = full.unwrap_or_else(|| parts.iter().map(|p| p.listed).max().unwrap_or(0));
        // Files of a folder of AVIs are filled one after the other; those of TIFFs need not be.
        let filled = parts.iter().all(|p| p.path.extension().is_some_and(|e| e.eq_ignore_ascii_case("avi")));
        let short = parts.iter().rev().skip(1).rev().filter(|p| filled && p.listed < full);
        let numbers: Vec<u64> = parts.iter().filter(|_| filled).filter_map(|p| p.number).collect();
        let present = |n: &u64| numbers.binary_search(n).is_err();
        let first = recording.times.as_ref().map_or_else(|| usual_first(parts), |times| times.first_file);
        let mut damaged_frames = Vec::new();
        let mut before = 0;
        for part in parts {
            for (index, place) in part.places().enumerate() {
                if let Ok(at) = part.damaged.binary_search_by_key(&place, |(frame, _)| *frame) {
                    let (index, what) = (before + index, part.damaged[at].1.clone());
                    damaged_frames.push(DamagedFrame { index, file: name(&part.path), frame: place, what });
                }
            }
            before += part.frames;
        }
        let last = numbers.last().map(|last| times.last_file.map_or(*last, |of_table| of_table.max(*last)));
        let mut missing_files: Vec<u64> =
            last.map_or(Vec::new(), |last| (first..=last).filter(present).take(1000).collect());
        if !filled {
            missing_files = between(&parts.iter().map_while(|p| p.number).collect::<Vec<u64>>());
        }
        let mut short: Vec<_> = short.map(|p| (name(&p.path), p.listed, full)).collect();
        if let Some((part, frames)) = parts.last().filter(|_| filled).zip(times.last_should_have) {
            short.push((name(&part.path), part.listed, frames));
        }
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
            gaps: times.gaps,
            backwards: times.backwards,
            // What stands in for a damaged frame is no frame that the recorder repeated.
            repeated: {
                let damaged = |i: &usize| damaged_frames.binary_search_by_key(i, |f| f.index).is_ok();
                survey.repeated.iter().copied().filter(|i| !damaged(i)).collect()
            },
            torn,
            damaged_frames,
            damaged: parts
                .iter()
                .filter_map(|p| {
                    p.damage
                        .as_ref()
                        .map(|d| if d.contains(&name(&p.path)) { d.clone() } else { format!("{}: {d}", name(&p.path)) })
                })
                .collect(),
            short,
            missing_files,
            notes: recording.notes.clone(),
        }
    }

    /// The report for people; each line says one thing.
    pub fn text(&self) -> String {
        let mut out = String::new();
        // Writing to a string cannot fail.
        let mut line = |text: String| {
            let _ = writeln!(out, "{text}");
        };
        let device = self.device.as_ref().map_or(String::new(), |d| format!(" of {d}"));
        let plural = if self.files == 1 { "file" } else { "files" };
        line(format!(
            "{}{device}: {} frames of {} x {} {} in {} {plural}, as {} ({})",
            self.source, self.frames, self.rows, self.cols, self.samples, self.files, self.role, self.file
        ));
        match (self.rate_hz, self.configured_rate_hz) {
            (Some(rate), Some(set)) if rate.max(set) > UNLIKE * rate.min(set) => line(format!(
                "  rate        {rate:.3} Hz by the timestamps, but {set} Hz was set: the times are those of the \
                 timestamps; check that their table belongs to these frames"
            )),
            (Some(rate), Some(set)) => line(format!("  rate        {rate:.3} Hz by the timestamps; {set} Hz was set")),
            (Some(rate), None) => line(format!("  rate        {rate:.3} Hz by the timestamps")),
            (None, Some(set)) => line(format!("  rate        no timestamps; {set} Hz was set")),
            (None, None) => {}
        }
        if let Some(count) = self.timestamps {
            let left: usize = self.torn.len();
            let of = format!("{count} for {} frames", self.frames);
            let unused = match (self.timestamps_unused, left) {
                (0, _) => String::new(),
                (n, _) => format!("; {n} without a whole frame"),
            };
            let estimated = match self.times_estimated {
                0 => String::new(),
                n => format!("; the times of the last {n} frames are extrapolated (column time_is)"),
            };
            let estimated = match self.times_interpolated {
                0 => estimated,
                n => format!("{estimated}; {n} frames have no row, and times between those of others (column time_is)"),
            };
            line(format!("  timestamps  {of}{unused}{estimated}"));
            if let Some(how) = self.assigned {
                line(format!("              rows are assigned to frames so that {how}"));
            }
        }
        for gap in self.gaps.iter().take(LINES) {
            line(format!(
                "  gap         after frame {}, at {:.3} s: {:.3} s, {} frames are missing",
                gap.after_frame, gap.time_s, gap.seconds, gap.missing
            ));
        }
        more(&mut line, self.gaps.len(), "gaps");
        for torn in self.torn.iter().take(LINES) {
            let what = if torn.empty { "has no data" } else { "is not whole" };
            line(format!("  left out    frame {} of {}: it {what}", torn.frame, torn.file));
        }
        more(&mut line, self.torn.len(), "frames that were left out");
        let runs: Vec<&[DamagedFrame]> = self.damaged_frames.chunk_by(follows).collect();
        for run in runs.iter().take(LINES) {
            line(format!("  damaged     {}", of_run(run)));
        }
        more(&mut line, runs.len(), "damaged places");
        for damage in &self.damaged {
            line(format!("  damaged     {damage}"));
        }
        for (file, frames, full) in &self.short {
            line(format!("  short       {file}: {frames} frames, it should have {full}"));
        }
        if !self.missing_files.is_empty() {
            line(format!("  missing     files {}", list(&self.missing_files)));
        }
        if !self.repeated.is_empty() {
            let (n, which) = (self.repeated.len(), list(&self.repeated));
            line(format!("  repeated    {n} frames equal the frame before: {which}"));
        }
        if !self.backwards.is_empty() {
            let (n, which) = (self.backwards.len(), list(&self.backwards));
            line(format!("  backwards   {n} frames have no later time than the frame before: {which}"));
        }
        // Frames of the stack have other numbers in the recording.
        if self.files > 1 || !self.torn.is_empty() {
            line(
                "  frames      are counted from 0, as in the session; its table has the file and the frame of each"
                    .into(),
            );
        }
        for note in &self.notes {
            line(format!("  note        {note}"));
        }
        out
    }
}

/// Whether a damaged frame is the next one, and damaged since it is decoded from the one before.
fn follows(a: &DamagedFrame, b: &DamagedFrame) -> bool {
    a.file == b.file && a.index + 1 == b.index && b.what == DECODED_FROM
}

/// A damaged frame, and those that are decoded from it.
fn of_run(run: &[DamagedFrame]) -> String {
    let [first, rest @ ..] = run else { return String::new() };
    let DamagedFrame { index, file, frame, what } = first;
    let others = match rest {
        [] => String::new(),
        [one] => format!("; so is frame {}, which is decoded from it", one.index),
        [.., last] => format!("; so are frames {} to {}, which are decoded from it", index + 1, last.index),
    };
    format!("frame {index}, {frame} of {file}: {what}{others}")
}

/// Two rates that differ by more than this factor cannot both be right.
const UNLIKE: f64 = 1.5;

/// Most lines of one kind in the text; the JSON has all.
const LINES: usize = 12;

fn more(line: &mut impl FnMut(String), count: usize, what: &str) {
    if count > LINES {
        line(format!("              and more: {count} {what} in all"));
    }
}

fn list<T: ToString>(values: &[T]) -> String {
    let first: Vec<String> = values.iter().take(LINES).map(ToString::to_string).collect();
    let rest = if values.len() > LINES { ", ..." } else { "" };
    format!("{}{rest}", first.join(", "))
}

#[cfg(test)]
mod tests {
    use super::between;

    #[test]
    fn numbers_that_are_missing_are_those_between_regular_ones() {
        assert_eq!(between(&[0, 1, 2, 5, 6, 7]), [3, 4]);
        assert_eq!(between(&[0, 10, 20, 40]), [30]);
        assert!(between(&[3, 4, 5]).is_empty() && between(&[7]).is_empty() && between(&[]).is_empty());
        // Numbers that mean something else: positions of beads, or the same number in each name.
        assert!(between(&[0, 7, 9, 30]).is_empty() && between(&[1, 1, 2, 3]).is_empty());
        assert!(between(&[0, 20, 40, 0, 20, 40]).is_empty());
    }
}
