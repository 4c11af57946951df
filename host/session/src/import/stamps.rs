//! The table of timestamps of a recorder, as it is read.

use crate::error::SessionError;
use crate::table::{Grid, Row, time_column};
use std::path::{Path, PathBuf};

/// The rows of a table of timestamps.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Stamps {
    /// Time of each row, s.
    pub time_s: Vec<f64>,
    /// Number of the frame of each row, as the table has it, where it has numbers that grow.
    pub numbers: Option<Vec<usize>>,
    /// Number of rows that repeat the row before, and are left out.
    pub repeats: usize,
    /// What the table lacks at its end.
    pub unfinished: Option<String>,
    /// Which of several cameras these are the times of, and why, as a sentence.
    pub camera: Option<String>,
    /// The unit that was taken where the table states none, as a sentence.
    pub assumed: Option<String>,
    /// Whether that unit may well be another: it is an unusual one, or the rate that was set is not known or differs.
    pub doubtful_unit: bool,
}

impl Stamps {
    /// The times by the numbers of `frames` frames; those of missing rows are NaN. `None` where the table has no
    /// numbers, or they are not all numbers of these frames, or say no more than the order of the rows.
    pub fn by_number(&self, frames: usize) -> Option<Vec<f64>> {
        let numbers = self.numbers.as_ref()?;
        let (first, last) = (*numbers.first()?, *numbers.last()?);
        let from = match last.cmp(&frames) {
            std::cmp::Ordering::Less => 0,
            // Only then is it sure that they are counted from 1.
            std::cmp::Ordering::Equal if first > 0 => 1,
            _ => return None,
        };
        self.placed(from)
    }

    /// As [`Self::by_number`], for a recording of which frames are missing, too: the first row is that of frame 0.
    pub fn by_number_from_first(&self) -> Option<Vec<f64>> {
        let first = self.numbers.as_ref()?.first().copied().filter(|first| *first <= 1)?;
        // A table with few of its rows is another one.
        self.placed(first).filter(|all| all.len() <= 2 * self.time_s.len())
    }

    /// The times by the numbers of frames that are counted from `from`.
    fn placed(&self, from: usize) -> Option<Vec<f64>> {
        let numbers = self.numbers.as_ref()?;
        let count = numbers.last()?.checked_sub(from)?.checked_add(1)?;
        // Numbers may be of another kind, such as times.
        let few = count > numbers.len() && count / 1000 <= numbers.len();
        let mut all = vec![f64::NAN; Some(count).filter(|_| few)?];
        for (number, time) in numbers.iter().zip(&self.time_s) {
            *all.get_mut(number.checked_sub(from)?)? = *time;
        }
        Some(all)
    }
}

/// A time between frames of more than this many median times is a gap.
pub(super) const GAP: f64 = 1.5;

/// Names of tables of timestamps: those of Miniscope V4 and V3.
const TABLES: [&str; 3] = ["timeStamps.csv", "timestamps.csv", "timestamp.dat"];

/// The table of timestamps of a folder, if it has one: that with the name of a recorder, or else one whose name differs
/// from it in capitals alone.
pub(super) fn table_of(folder: &Path) -> Option<PathBuf> {
    let exact = TABLES.into_iter().map(|name| folder.join(name)).find(|path| path.is_file());
    exact.or_else(|| {
        let alike = |name: &std::ffi::OsStr| TABLES.iter().any(|table| name.eq_ignore_ascii_case(table));
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        entries.filter(|entry| alike(&entry.file_name())).map(|entry| entry.path()).filter(|path| path.is_file()).min()
    })
}

/// Reads a table of timestamps. Version 3 of the recorder lists all cameras in one table: the camera of `frames` frames
/// is taken from it. `set_s` is the time between frames that was set, s, if it is known: it decides the unit where the
/// table states none.
///
/// # Errors
/// The table cannot be read, has no column of times or no rows, or a row is no number.
pub(super) fn timestamps(path: &Path, frames: usize, set_s: Option<f64>) -> Result<Stamps, SessionError> {
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
    if rows.is_empty() {
        let remedy = "record it again, or give a row for each frame";
        return Err(SessionError::Missing {
            path: path.into(),
            field: "rows".into(),
            found: "only its header".into(),
            remedy,
        });
    }
    let numbers: Option<Vec<usize>> = place(&["framenumber", "framenum"])
        .and_then(|at| rows.iter().map(|row| row.cells[at].parse().ok()).collect())
        .filter(|numbers: &Vec<usize>| numbers.is_sorted());
    // Version 3 counts from 1.
    let numbers = match by_camera {
        Some(_) => numbers.and_then(|all| all.into_iter().map(|n| n.checked_sub(1)).collect()),
        None => numbers,
    };
    let time = |row: &Row| {
        let number = grid.number(&row.cells[column]).filter(|v| v.abs() <= LATEST);
        number.ok_or_else(|| {
            let field = format!("line {}, column `{}`", row.line, grid.names[column]);
            let found = format!("`{}` in `{}`", row.cells[column], row.text(grid.separator));
            SessionError::value(path, field, "a time", found, "correct the table, or remove the line")
        })
    };
    let mut time_s = rows.into_iter().map(time).collect::<Result<Vec<_>, _>>()?;
    let likely = likely_unit(&time_s, set_s);
    let factor = stated.unwrap_or(likely.s);
    time_s.iter_mut().for_each(|time| *time *= factor);
    let assumed = stated.is_none().then(|| {
        format!("column `{}` of the table of timestamps states no unit: {} are taken", grid.names[column], likely.name)
    });
    let (time_s, numbers, repeats) = without_repeats(time_s, numbers);
    let mut time_s = time_s;
    // The clock of version 3 starts with the first frame, whose own time is often that of an earlier recording.
    if let (Some(_), [first, second, third, ..]) = (by_camera, &mut time_s[..]) {
        let step = *third - *second;
        if !(*second - GAP * step..*second).contains(first) {
            *first = f64::NAN;
        }
    }
    Ok(Stamps {
        time_s,
        numbers,
        repeats,
        unfinished,
        camera: chosen.and_then(|(_, why)| why),
        assumed,
        doubtful_unit: stated.is_none() && likely.doubtful,
    })
}

/// The latest number that can be a time: more nanoseconds than any clock counts.
const LATEST: f64 = 1e20;

/// Leaves out rows that repeat the row before, and gives their number. Numbers of which two rows have the same at
/// different times are no numbers of frames.
fn without_repeats(times: Vec<f64>, numbers: Option<Vec<usize>>) -> (Vec<f64>, Option<Vec<usize>>, usize) {
    let Some(numbers) = numbers else { return (times, None, 0) };
    let all: Vec<(usize, f64)> = numbers.iter().copied().zip(times.iter().copied()).collect();
    let mut kept = all.clone();
    kept.dedup();
    if kept.windows(2).any(|w| w[0].0 == w[1].0) {
        return (times, None, 0);
    }
    let repeats = all.len() - kept.len();
    let (numbers, times) = kept.into_iter().unzip();
    (times, Some(numbers), repeats)
}

/// The unit of times that state none.
struct LikelyUnit {
    s: f64,
    name: &'static str,
    doubtful: bool,
}

/// The unit of times that state none: that which gives the time between frames that was set, if it is known.
fn likely_unit(times: &[f64], set_s: Option<f64>) -> LikelyUnit {
    let mut steps: Vec<f64> = times.windows(2).map(|w| w[1] - w[0]).collect();
    steps.sort_by(f64::total_cmp);
    let median = steps.get(steps.len() / 2).copied().filter(|step| *step > 0.0);
    let units = [(1.0, "seconds"), (1e-3, "milliseconds"), (1e-6, "microseconds"), (1e-9, "nanoseconds")];
    let (at, fits) = match (median, set_s) {
        (None, _) => (1, false),
        (Some(median), Some(set_s)) => {
            let off = units.map(|(s, _)| (median * s / set_s).ln().abs());
            let nearest = (0..units.len()).min_by(|a, b| off[*a].total_cmp(&off[*b])).unwrap_or(1);
            (nearest, off[nearest] < GAP.ln())
        }
        // Frames follow each other within a second or so, which is hundreds of milliseconds.
        (Some(median), None) => ([2.0, 1e4, 1e7].iter().position(|limit| median < *limit).unwrap_or(3), false),
    };
    LikelyUnit { s: units[at].0, name: units[at].1, doubtful: !fits || at > 1 }
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
