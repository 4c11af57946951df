//! When the frames of a recording were taken: its table of timestamps, and what the table says of lost frames.

use crate::error::SessionError;
use crate::stack::Part;
use crate::table::{Grid, Row, time_column};
use serde::{Deserialize, Serialize};
use std::path::Path;

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
    /// How rows of the table were assigned to frames, where their numbers differ.
    pub assigned: Option<&'static str>,
    /// Number of the first file that the recorder wrote, there or not.
    pub first_file: u64,
    /// Number of the last file that the recorder wrote, there or not, where files have a known length.
    pub last_file: Option<u64>,
    /// Number of frames of the last file that is there, if it lacks some.
    pub last_should_have: Option<usize>,
    /// Frames without a row of the table, between others, whose times are interpolated.
    pub interpolated: Vec<usize>,
}

/// The rows of a table of timestamps.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Stamps {
    /// Time of each row, s.
    pub time_s: Vec<f64>,
    /// Number of the frame of each row, from 0, where the table has numbers that grow.
    pub numbers: Option<Vec<usize>>,
    /// What the table lacks at its end.
    pub unfinished: Option<String>,
    /// Which of several cameras these are the times of, and why, as a sentence.
    pub camera: Option<String>,
    /// The unit that was taken where the table states none, as a sentence.
    pub assumed: Option<String>,
}

impl Stamps {
    /// The times by the numbers of the frames; those of missing rows are NaN. `None` where numbers say no more than the
    /// order of the rows.
    fn by_number(&self) -> Option<Vec<f64>> {
        let numbers = self.numbers.as_ref().filter(|n| n.last().is_some_and(|last| last + 1 > n.len()))?;
        // A table with few of its rows is another one.
        let count = numbers.last().map_or(0, |last| last + 1);
        let mut all = vec![f64::NAN; Some(count).filter(|n| *n <= 2 * numbers.len())?];
        numbers.iter().zip(&self.time_s).for_each(|(i, time)| all[*i] = *time);
        Some(all)
    }
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

/// A time between frames of more than this many median times is a gap.
const GAP: f64 = 1.5;

/// Names of tables of timestamps: those of Miniscope V4 and V3.
const TABLES: [&str; 3] = ["timeStamps.csv", "timestamps.csv", "timestamp.dat"];

/// The table of timestamps of a folder, if it has one.
pub(super) fn table_of(folder: &Path) -> Option<std::path::PathBuf> {
    TABLES.into_iter().map(|name| folder.join(name)).find(|path| path.is_file())
}

/// Reads a table of timestamps. Version 3 of the recorder lists all cameras in one table: the camera of `frames` frames
/// is taken from it.
///
/// # Errors
/// The table cannot be read, has no column of times with a unit, or a row is no number.
pub(super) fn timestamps(path: &Path, frames: usize) -> Result<Stamps, SessionError> {
    let (grid, unfinished) = Grid::read_log(path)?;
    let place = |names: &[&str]| {
        let plain = |n: &str| n.to_lowercase().chars().filter(|c| c.is_alphanumeric()).collect::<String>();
        grid.names.iter().position(|n| names.contains(&plain(n).as_str()))
    };
    let in_ms = place(&["sysclock", "timestampms", "timems"]).map(|i| (i, Some(1e-3)));
    let Some((column, stated)) = in_ms.or_else(|| time_column(&grid.names)) else {
        let found =
            if grid.names.is_empty() { "an empty table".into() } else { format!("columns {}", grid.names.join(", ")) };
        return Err(SessionError::Missing {
            path: path.into(),
            field: "column `Time Stamp (ms)`".into(),
            found,
            remedy: "name the column `Time Stamp (ms)` or `time_s`",
        });
    };
    let by_camera = place(&["camnum"]);
    let chosen = by_camera.and_then(|at| camera_of(grid.rows.iter().map(|row| row.cells[at].as_str()), frames));
    let is_of = |row: &&Row| by_camera.zip(chosen.as_ref()).is_none_or(|(at, (name, _))| row.cells[at] == *name);
    let rows: Vec<&Row> = grid.rows.iter().filter(is_of).collect();
    // Frames are counted from 0 or from 1.
    let numbers = place(&["framenumber", "framenum"]).and_then(|at| {
        let numbers: Vec<usize> = rows.iter().map(|row| row.cells[at].parse().ok()).collect::<Option<_>>()?;
        let first = numbers.first().copied().filter(|n| *n <= 1 && numbers.is_sorted_by(|a, b| a < b))?;
        Some(numbers.into_iter().map(|n| n - first).collect())
    });
    let time = |row: &Row| {
        let number = grid.number(&row.cells[column]).filter(|v| v.is_finite());
        number.ok_or_else(|| {
            let field = format!("line {}, column `{}`", row.line, grid.names[column]);
            let found = format!("`{}` in `{}`", row.cells[column], row.text(grid.separator));
            SessionError::value(path, field, "a finite number", found, "correct the table, or remove the line")
        })
    };
    let mut time_s = rows.into_iter().map(time).collect::<Result<Vec<_>, _>>()?;
    let factor = stated.unwrap_or_else(|| likely_unit_s(&time_s));
    time_s.iter_mut().for_each(|time| *time *= factor);
    let unit = if factor < 1.0 { "milliseconds" } else { "seconds" };
    let assumed = stated.is_none().then(|| {
        format!("column `{}` of the table of timestamps states no unit: {unit} are taken", grid.names[column])
    });
    // The clock of version 3 starts with the first frame, whose own time is often that of an earlier recording.
    if let (Some(_), [first, second, third, ..]) = (by_camera, &mut time_s[..]) {
        let step = *third - *second;
        if !(*second - GAP * step..*second).contains(first) {
            *first = f64::NAN;
        }
    }
    Ok(Stamps { time_s, numbers, unfinished, camera: chosen.and_then(|(_, why)| why), assumed })
}

/// The unit of times that state none, s: frames follow each other within a second or so, which is hundreds of
/// milliseconds.
fn likely_unit_s(times: &[f64]) -> f64 {
    let mut steps: Vec<f64> = times.windows(2).map(|w| w[1] - w[0]).collect();
    steps.sort_by(f64::total_cmp);
    if steps.get(steps.len() / 2).is_some_and(|median| *median < 2.0) { 1.0 } else { 1e-3 }
}

/// The camera of a table whose number of rows is nearest to that of the frames, and why where the table lists several.
/// Of several it is camera 1, which is the miniscope in most recordings.
fn camera_of<'a>(rows: impl Iterator<Item = &'a str>, frames: usize) -> Option<(String, Option<String>)> {
    let mut counts: Vec<(&str, usize)> = Vec::new();
    for camera in rows {
        match counts.iter_mut().find(|(known, _)| *known == camera) {
            Some((_, count)) => *count += 1,
            None => counts.push((camera, 1)),
        }
    }
    counts.sort_unstable();
    let (name, rows) = *counts.iter().min_by_key(|(name, count)| (count.abs_diff(frames), *name != "1"))?;
    let why = match counts.iter().filter(|(_, count)| *count == frames).count() {
        1 => format!("it alone has as many rows as there are frames, {frames}"),
        _ => format!("its {rows} rows are nearest to the {frames} frames of the files; check that it is the miniscope"),
    };
    let listed: Vec<String> = counts.iter().map(|(name, count)| format!("{name} ({count} rows)")).collect();
    let why = (counts.len() > 1).then(|| {
        format!("the table of timestamps lists cameras {}; camera {name} is taken: {why}", listed.join(" and "))
    });
    Some((name.to_string(), why))
}

impl Times {
    /// Assigns timestamps to the whole frames of a recording. `per_file` is the number of frames that the recorder puts
    /// into each file, if it is known.
    pub(super) fn of_table(table: &Stamps, parts: &[Part], frames: usize, per_file: Option<usize>) -> Self {
        let listed: usize = parts.iter().map(|p| p.listed).sum();
        let full = per_file.unwrap_or_else(|| parts.iter().map(|p| p.listed).max().unwrap_or(0));
        let fit = |rows: usize| rows == listed || first_numbers(parts).any(|first| fits(rows, parts, full, first));
        // Numbers of frames tell where a row is missing, if the rows themselves do not fit the frames.
        let numbered = table.by_number().filter(|all| !fit(table.time_s.len()) && fit(all.len()));
        let mut times = Self::of(numbered.as_ref().unwrap_or(&table.time_s), parts, frames, per_file);
        times.timestamps = table.time_s.len();
        times.unfinished = table.unfinished.clone();
        times.camera = table.camera.clone();
        times.assumed = table.assumed.clone();
        times
    }

    /// Assigns times to the whole frames of a recording; NaN stands for a row that is missing.
    fn of(stamps: &[f64], parts: &[Part], frames: usize, per_file: Option<usize>) -> Self {
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
                let before = last.number.unwrap_or(0).saturating_sub(first_file) as usize * per_file;
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
        times.interpolate();
        times.judge();
        times.extrapolate(frames);
        times
    }

    /// Fills in the times of frames whose rows are missing.
    fn interpolate(&mut self) {
        self.interpolated = (0..self.time_s.len()).filter(|i| self.time_s[*i].is_nan()).collect();
        for i in &self.interpolated {
            let before = i.checked_sub(1).map(|b| (b, self.time_s[b]));
            let after = (i + 1..self.time_s.len()).find(|a| !self.time_s[*a].is_nan()).map(|a| (a, self.time_s[a]));
            self.time_s[*i] = match (before, after) {
                (Some((b, first)), Some((a, last))) => first + (last - first) / (a - b) as f64,
                (None, Some((a, last))) => last - (a - i) as f64 * self.time_s.get(a + 1).map_or(0.0, |t| t - last),
                (Some((_, time)), None) => time,
                (None, None) => 0.0,
            };
        }
    }

    /// Which frames have a time that no row of the table states.
    pub(super) fn is_estimated(&self, frame: usize) -> bool {
        frame + self.estimated >= self.time_s.len() || self.interpolated.binary_search(&frame).is_ok()
    }

    /// The times of frames of which each has one, s.
    pub fn of_frames(time_s: &[f64]) -> Self {
        Self::of(time_s, &[], time_s.len(), None)
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
                let missing = ((step / interval).round() as usize).saturating_sub(1);
                self.gaps.push(Gap { after_frame: i, time_s: self.time_s[i], seconds: step, missing });
            }
        }
    }

    fn extrapolate(&mut self, frames: usize) {
        self.estimated = frames - self.time_s.len();
        let (start, step) = (self.time_s.last().copied(), self.interval_s.unwrap_or(0.0));
        let next = |i: usize| start.map_or(i as f64 * step, |t| t + (i + 1) as f64 * step);
        self.time_s.extend((0..self.estimated).map(next));
    }

    /// What is to be known of the table of timestamps: what it lacks at its end, which of several cameras was taken,
    /// and which unit where it states none.
    pub fn table_notes(&self) -> impl Iterator<Item = String> + '_ {
        let unfinished = self.unfinished.as_ref().map(|what| format!("the table of timestamps {what}"));
        unfinished.into_iter().chain(self.camera.clone()).chain(self.assumed.clone())
    }

    /// Frames a second by the timestamps, without the gaps.
    pub fn rate_hz(&self) -> Option<f64> {
        let last = self.time_s.len() - self.estimated;
        let whole = self.time_s.get(last.checked_sub(1)?)? - self.time_s.first()?;
        let lost: f64 = self.gaps.iter().map(|g| g.seconds).sum();
        let steps = (last - 1).checked_sub(self.gaps.len())?;
        Some(steps as f64 / (whole - lost)).filter(|rate| rate.is_finite() && *rate > 0.0)
    }
}

/// The number of the first file where a table does not say more: 1 if there is no file 0.
pub(super) fn usual_first(parts: &[Part]) -> u64 {
    parts.first().and_then(|p| p.number).unwrap_or(0).min(1)
}

/// What the number of the first file may have been. Version 4 counts from 0 (`0.avi`), version 3 from 1
/// (`msCam1.avi`); without `0.avi` the table of timestamps must decide.
fn first_numbers(parts: &[Part]) -> impl Iterator<Item = u64> {
    let stem = parts.first().and_then(|p| p.path.file_stem()).unwrap_or_default().to_string_lossy();
    let bare = stem.chars().all(|c| c.is_ascii_digit());
    Some(0).filter(|_| bare).into_iter().chain([usual_first(parts)])
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
