//! The table of a stack: one row for each frame.

use super::error::SessionError;
use std::collections::BTreeMap;
use std::path::Path;

/// Metadata of one frame. A column that the table lacks has its default.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameInfo {
    /// Index of the frame in its stack, from 0.
    pub frame: usize,
    /// Stage position x, um; default 0.
    pub x_um: f64,
    /// Stage position y, um; default 0.
    pub y_um: f64,
    /// Depth of the stage, um; default 0.
    pub z_um: f64,
    /// Exposure, ms; default: the exposure of the stack.
    pub exposure_ms: f64,
    /// Relative light level; default 1.
    pub illumination: f64,
    /// Start of the exposure, s; default 0.
    pub time_s: f64,
    /// Temperature of the sensor, degrees C, if it was measured.
    pub temperature_c: Option<f64>,
    /// Columns with other names, as text.
    pub other: BTreeMap<String, String>,
}

impl FrameInfo {
    /// A frame with this index and exposure, and defaults for everything else.
    pub fn plain(frame: usize, exposure_ms: f64) -> Self {
        Self {
            frame,
            x_um: 0.0,
            y_um: 0.0,
            z_um: 0.0,
            exposure_ms,
            illumination: 1.0,
            time_s: 0.0,
            temperature_c: None,
            other: BTreeMap::new(),
        }
    }
}

/// Reads the table of a stack of `frames` frames, in the order of the frames. The columns in `required` must exist.
///
/// # Errors
/// The file is not valid CSV, a required column is missing, a value is not a number or outside its range, or the frames
/// are not numbered from 0 to `frames - 1`, each once.
pub(super) fn read(
    path: &Path,
    frames: usize,
    exposure_ms: f64,
    required: &[&str],
) -> Result<Vec<FrameInfo>, SessionError> {
    let mut csv = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .comment(Some(b'#'))
        .from_path(path)
        .map_err(|e| csv_error(path, e))?;
    let header = csv.headers().map_err(|e| csv_error(path, e))?.clone();
    // Spreadsheets may write a byte-order mark; it is not part of the first name.
    let names: Vec<&str> = header.iter().map(|n| n.trim_start_matches('\u{feff}').trim()).collect();
    for column in required {
        if !names.contains(column) {
            return Err(SessionError::Missing {
                path: path.into(),
                field: format!("column `{column}`"),
                found: format!("columns {}", names.join(", ")),
                remedy: "add the column, or rename it to the name in the session format",
            });
        }
    }
    let mut rows: Vec<Option<FrameInfo>> = vec![None; frames];
    let mut count = 0;
    for (i, record) in csv.records().enumerate() {
        let record = record.map_err(|e| csv_error(path, e))?;
        count += 1;
        let info = row(path, i, &names, &record, exposure_ms)?;
        let index = info.frame;
        match rows.get_mut(index) {
            Some(slot @ None) => *slot = Some(info),
            Some(Some(_)) => {
                let field = format!("column `frame`, row {i}");
                return Err(SessionError::value(path, field, "each frame once", index, "number the frames from 0"));
            }
            None => return Err(row_count(path, frames, format!("a row for frame {index}"))),
        }
    }
    if count != frames {
        return Err(row_count(path, frames, format!("{count} rows")));
    }
    Ok(rows.into_iter().flatten().collect())
}

fn row(
    path: &Path,
    i: usize,
    names: &[&str],
    record: &csv::StringRecord,
    exposure_ms: f64,
) -> Result<FrameInfo, SessionError> {
    let mut info = FrameInfo::plain(i, exposure_ms);
    for (name, text) in names.iter().zip(record) {
        let number = |range: Range| parse(path, name, i, text, range);
        match *name {
            "frame" => {
                let value = number(Range::NotNegative)?;
                if value.fract() != 0.0 {
                    return Err(SessionError::value(
                        path,
                        at(name, i),
                        "a whole number",
                        text,
                        "number the frames from 0",
                    ));
                }
                info.frame = value as usize;
            }
            "x_um" => info.x_um = number(Range::Any)?,
            "y_um" => info.y_um = number(Range::Any)?,
            "z_um" => info.z_um = number(Range::Any)?,
            "exposure_ms" => info.exposure_ms = number(Range::NotNegative)?,
            "illumination" => info.illumination = number(Range::NotNegative)?,
            "time_s" => info.time_s = number(Range::Any)?,
            "temperature_c" => info.temperature_c = Some(number(Range::Temperature)?),
            _ => {
                info.other.insert((*name).to_string(), text.to_string());
            }
        }
    }
    Ok(info)
}

/// Values that a column may hold.
#[derive(Clone, Copy)]
enum Range {
    Any,
    NotNegative,
    Temperature,
}

fn parse(path: &Path, name: &str, i: usize, text: &str, range: Range) -> Result<f64, SessionError> {
    let (low, expected) = match range {
        Range::Any => (f64::MIN, "a finite number"),
        Range::NotNegative => (0.0, "a finite number, zero or more"),
        Range::Temperature => (-273.15, "a temperature in degrees C"),
    };
    match text.parse::<f64>() {
        Ok(v) if v.is_finite() && v >= low => Ok(v),
        _ => Err(SessionError::value(path, at(name, i), expected, format!("`{text}`"), "correct the table")),
    }
}

fn at(name: &str, row: usize) -> String {
    format!("column `{name}`, row {row}")
}

fn row_count(path: &Path, frames: usize, found: String) -> SessionError {
    SessionError::Shape {
        path: path.into(),
        expected: format!("one row for each of {frames} frames"),
        found,
        remedy: "write one row for each frame of the stack",
    }
}

fn csv_error(path: &Path, error: csv::Error) -> SessionError {
    match error.into_kind() {
        csv::ErrorKind::Io(e) => SessionError::io(path, e),
        kind => SessionError::format(path, ".csv", format!("{kind:?}")),
    }
}
