//! When the frames of a recording were taken: its table of timestamps, and what the table says of lost frames.

use super::miniscope;
use super::stamps::{GAP, Stamps};
use crate::stack::Part;
use serde::{Deserialize, Serialize};

/// The times of the frames of a recording.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Times {
    /// Time of each frame, s, as the recorder's clock has it.
    pub time_s: Vec<f64>,
    /// Number of frames at the end without a timestamp, whose times are extrapolated.
    pub estimated: usize,
    /// Number of rows of the table.
    pub timestamps: usize,
    /// Number of rows of the table that belong to no whole frame.
    pub unused: usize,
    /// Number of them before that of the first frame.
    pub before: usize,
    /// Number of them after that of the last frame.
    pub after: usize,
    /// Mean time from one frame to the next, without gaps, s.
    pub interval_s: Option<f64>,
    /// Where frames are missing.
    pub gaps: Vec<Gap>,
    /// Frames whose timestamp is not later than that of the frame before.
    pub backwards: Vec<usize>,
    /// What the table of timestamps lacks at its end, where the recorder was cut off, as the end of a sentence.
    pub unfinished: Option<String>,
    /// Which of several cameras in the table was taken, and why, as a sentence.
    pub camera: Option<String>,
    /// The unit that was taken where the table states none, as a sentence.
    pub assumed: Option<String>,
    /// Whether that unit may well be another: it is an unusual one, or the rate that was set is not known or differs.
    pub doubtful_unit: bool,
    /// Number of rows of the table that repeat the row before, and were left out.
    pub repeats: usize,
    /// How rows of the table were assigned to frames, where their numbers differ.
    pub assigned: Option<&'static str>,
    /// Number of the first file that the recorder wrote, there or not.
    pub first_file: u64,
    /// Number of the last file that the recorder wrote, there or not, where files have a known length.
    pub last_file: Option<u64>,
    /// Number of frames of the last file that is there, if it lacks some.
    pub last_should_have: Option<usize>,
    /// Frames without a row of the table, between others or before them, whose times are interpolated.
    pub interpolated: Vec<usize>,
}

/// A time between two frames that is longer than others.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Gap {
    /// The last frame before it, counted from 0.
    pub after_frame: usize,
    /// Time of that frame, s.
    pub time_s: f64,
    /// Time to the next frame, s.
    pub seconds: f64,
    /// Number of frames that are missing, by the mean interval.
    pub missing: usize,
}

impl Times {
    /// Assigns timestamps to the whole frames of a recording. `per_file` is the number of frames that the recorder puts
    /// into each file, and `set_s` the time between frames that was set, s, if they are known.
    pub(super) fn of_table(
        table: &Stamps,
        parts: &[Part],
        frames: usize,
        per_file: Option<usize>,
        set_s: Option<f64>,
    ) -> Self {
        let listed: usize = parts.iter().map(|p| p.listed).sum();
        let full = per_file.unwrap_or_else(|| parts.iter().map(|p| p.listed).max().unwrap_or(0));
        let fit = |rows: usize| rows == listed || first_numbers(parts).any(|first| fits(rows, parts, full, first));
        // Numbers of frames tell where a row is missing, if the rows themselves do not fit the frames.
        let unfit = !fit(table.time_s.len());
        let numbered = Some(()).filter(|()| unfit).and_then(|()| table.by_number(listed));
        let by_number = numbered.is_some();
        let numbered = numbered.or_else(|| table.by_number_from_first().filter(|all| unfit && fit(all.len())));
        let mut times = Self::of(numbered.as_ref().unwrap_or(&table.time_s), parts, frames, per_file, set_s);
        if by_number && times.assigned.is_some() {
            times.assigned = Some("each row belongs to the frame of its number");
        }
        times.repeats = table.repeats;
        times.timestamps = table.time_s.len();
        times.unfinished = table.unfinished.clone();
        times.camera = table.camera.clone();
        times.assumed = table.assumed.clone();
        times.doubtful_unit = table.doubtful_unit;
        times
    }

    /// Assigns times to the whole frames of a recording; NaN stands for a row that is missing.
    fn of(stamps: &[f64], parts: &[Part], frames: usize, per_file: Option<usize>, set_s: Option<f64>) -> Self {
        let listed: usize = parts.iter().map(|p| p.listed).sum();
        let (mut last_file, mut last_should_have) = (None, None);
        let mut assigned = None;
        let mut first_file = usual_first(parts);
        let mut rows = Vec::with_capacity(frames);
        if parts.is_empty() {
            rows.extend(0..frames);
        } else {
            let stated = per_file;
            let per_file = per_file.unwrap_or_else(|| parts.iter().map(|p| p.listed).max().unwrap_or(0));
            let differs = listed != stamps.len();
            let by_file = first_numbers(parts).find(|first| differs && fits(stamps.len(), parts, per_file, *first));
            first_file = by_file.unwrap_or(first_file);
            if let Some((per_file, last)) = stated.zip(parts.last().filter(|_| differs)) {
                let written = stamps.len().div_ceil(per_file) as u64;
                let before = last.number.unwrap_or(0).saturating_sub(first_file) as usize;
                let before = before.saturating_mul(per_file);
                last_file = (first_file + written).checked_sub(1).filter(|_| last.number.is_some());
                last_should_have = stamps
                    .len()
                    .checked_sub(before)
                    .map(|n| n.min(per_file))
                    .filter(|n| last.number.is_some() && *n > last.listed);
            }
            let mut before = 0;
            for part in parts {
                let start = match part.number.zip(by_file) {
                    Some((number, first)) => (number - first) as usize * per_file,
                    None => before,
                };
                rows.extend(part.places().map(|place| start + place));
                before += part.listed;
            }
            if differs {
                assigned = Some(match by_file.is_some() {
                    true => "each file begins at its own row, since every file but the last should be full",
                    false => "the first row is that of the first frame, and so on",
                });
            }
        }
        let mut times =
            Self { timestamps: stamps.len(), assigned, first_file, last_file, last_should_have, ..Self::default() };
        times.time_s = rows.iter().map_while(|row| stamps.get(*row).copied()).collect();
        times.unused = stamps.len().saturating_sub(times.time_s.len());
        times.before = rows.first().map_or(0, |first| (*first).min(stamps.len()));
        times.after = rows.last().map_or(0, |last| stamps.len().saturating_sub(last + 1));
        times.interpolate(set_s);
        times.judge();
        times.extrapolate(frames, set_s);
        times
    }

    /// Fills in the times of frames whose rows are missing.
    fn interpolate(&mut self, set_s: Option<f64>) {
        let known: Vec<(usize, f64)> = self.time_s.iter().copied().enumerate().filter(|(_, t)| !t.is_nan()).collect();
        self.interpolated = (0..self.time_s.len()).filter(|i| self.time_s[*i].is_nan()).collect();
        let slope = |(a, first): (usize, f64), (b, last): (usize, f64)| (last - first) / (b - a) as f64;
        let mut steps: Vec<f64> = known.windows(2).map(|w| slope(w[0], w[1])).collect();
        steps.sort_by(f64::total_cmp);
        let step = steps.get(steps.len() / 2).copied().or(set_s).unwrap_or(0.0);
        for i in &self.interpolated {
            let after = known.partition_point(|(at, _)| at < i);
            let before = after.checked_sub(1).map(|at| known[at]);
            self.time_s[*i] = match (before, known.get(after)) {
                (Some(before), Some(after)) => before.1 + slope(before, *after) * (i - before.0) as f64,
                (None, Some((at, time))) => time - (at - i) as f64 * step,
                (Some((at, time)), None) => time + (i - at) as f64 * step,
                (None, None) => *i as f64 * step,
            };
        }
    }

    /// Which frames have a time that no row of the table states.
    pub(super) fn is_estimated(&self, frame: usize) -> bool {
        frame + self.estimated >= self.time_s.len() || self.interpolated.binary_search(&frame).is_ok()
    }

    /// The times of frames of which each has one, s.
    pub fn of_frames(time_s: &[f64]) -> Self {
        Self::of(time_s, &[], time_s.len(), None, None)
    }

    /// Finds the interval, gaps, and times that do not grow.
    ///
    /// The median tells gaps from ordinary times, but timestamps are often whole milliseconds: half of one is missing
    /// from it, which would count two frames too few in a gap of ten seconds. So the interval is the mean.
    fn judge(&mut self) {
        let steps: Vec<f64> = self.time_s.windows(2).map(|w| w[1] - w[0]).collect();
        let mut sorted = steps.clone();
        sorted.sort_by(f64::total_cmp);
        let Some(median) = sorted.get(sorted.len() / 2).copied().filter(|s| *s > 0.0) else {
            self.backwards = (0..steps.len()).filter(|i| steps[*i] <= 0.0).map(|i| i + 1).collect();
            return;
        };
        let usual: Vec<f64> = sorted.into_iter().filter(|step| *step > 0.0 && *step <= GAP * median).collect();
        let interval = usual.iter().sum::<f64>() / usual.len() as f64;
        self.interval_s = Some(interval);
        for (i, step) in steps.into_iter().enumerate() {
            if step <= 0.0 {
                self.backwards.push(i + 1);
            } else if step > GAP * median {
                // A step of a damaged row may be longer than any recording.
                let frames = (step / interval).round().min(f64::from(u32::MAX));
                let missing = (frames as usize).saturating_sub(1);
                self.gaps.push(Gap { after_frame: i, time_s: self.time_s[i], seconds: step, missing });
            }
        }
    }

    fn extrapolate(&mut self, frames: usize, set_s: Option<f64>) {
        self.estimated = frames - self.time_s.len();
        let (start, step) = (self.time_s.last().copied(), self.interval_s.or(set_s).unwrap_or(0.0));
        let next = |i: usize| start.map_or(i as f64 * step, |t| t + (i + 1) as f64 * step);
        self.time_s.extend((0..self.estimated).map(next));
    }

    /// What is to be known of the table of timestamps: what it lacks at its end, which rows were left out, which of
    /// several cameras was taken, and which unit where it states none.
    pub fn table_notes(&self) -> impl Iterator<Item = String> + '_ {
        self.sure_notes().chain(self.assumed.clone())
    }

    /// As [`Self::table_notes`], without the unit.
    pub(super) fn sure_notes(&self) -> impl Iterator<Item = String> + '_ {
        let unfinished = self.unfinished.as_ref().map(|what| format!("the table of timestamps {what}"));
        let repeats = Some(self.repeats).filter(|n| *n > 0).map(|n| {
            let rows = if n == 1 { "1 row that repeats".into() } else { format!("{n} rows that repeat") };
            format!("the table of timestamps has {rows} the row before; left out")
        });
        unfinished.into_iter().chain(repeats).chain(self.camera.clone())
    }

    /// Frames a second by the timestamps, without the gaps.
    pub fn rate_hz(&self) -> Option<f64> {
        // Steps backwards are no time between frames.
        if !self.backwards.is_empty() {
            return self.interval_s.map(|interval| 1.0 / interval).filter(|rate| rate.is_finite());
        }
        let last = self.time_s.len() - self.estimated;
        let whole = self.time_s.get(last.checked_sub(1)?)? - self.time_s.first()?;
        let lost: f64 = self.gaps.iter().map(|g| g.seconds).sum();
        let steps = (last - 1).checked_sub(self.gaps.len())?;
        Some(steps as f64 / (whole - lost)).filter(|rate| rate.is_finite() && *rate > 0.0)
    }
}

/// The number of the first file where a table does not say more: 1 if there is no file 0.
fn usual_first(parts: &[Part]) -> u64 {
    parts.first().and_then(|p| p.number).unwrap_or(0).min(1)
}

/// What the number of the first file may have been. Version 4 counts from 0 (`0.avi`), version 3 from 1
/// (`msCam1.avi`); without `0.avi` the table of timestamps must decide.
fn first_numbers(parts: &[Part]) -> impl Iterator<Item = u64> {
    Some(0).filter(|_| is_bare(parts)).into_iter().chain([usual_first(parts)])
}

/// Whether files are named by their numbers alone.
fn is_bare(parts: &[Part]) -> bool {
    let stem = parts.first().and_then(|p| p.path.file_stem()).unwrap_or_default().to_string_lossy();
    stem.chars().all(|c| c.is_ascii_digit())
}

/// The number of the first file that was recorded, without a table of timestamps: 0 in a folder of version 4, which its
/// metadata show; else that of the first of several, if it may be the first, or 1; that of a single file.
pub(super) fn first_without_table(parts: &[Part]) -> u64 {
    let Some((number, path)) = parts.first().and_then(|p| Some((p.number?, &p.path))) else { return 0 };
    match parts.len() {
        _ if is_bare(parts) && miniscope::is_there(crate::artifact::folder_of(path)) => 0,
        1 => number,
        _ => number.min(1),
    }
}

/// Whether a table fits files of `per_file` frames, counted from `first`, of which some are short or missing; none that
/// is missing is behind the last.
fn fits(stamps: usize, parts: &[Part], per_file: usize, first: u64) -> bool {
    let numbers: Option<Vec<u64>> = parts.iter().map(|p| p.number).collect();
    let (Some(numbers), Some(last)) = (numbers, parts.last()) else { return false };
    let files = numbers.last().unwrap_or(&0) - first;
    let begun = (files as usize).checked_mul(per_file);
    let short = parts.len() as u64 != files + 1 || parts.iter().rev().skip(1).any(|p| p.listed < per_file);
    let whole = parts.iter().all(|p| p.listed <= per_file);
    short
        && whole
        && begun
            .is_some_and(|begun| (begun.saturating_add(last.listed)..=begun.saturating_add(per_file)).contains(&stamps))
}
