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
    separated(path, &names)?;
    for column in required {
        if !names.contains(column) {
            return Err(SessionError::Missing {
                path: path.into(),
                field: format!("column `{column}`"),
                found: format!("columns {}", names.join(", ")),
                remedy: rename(column, &names),
            });
        }
    }
    let mut rows: Vec<Option<FrameInfo>> = vec![None; frames];
    let (mut count, mut first) = (0, None);
    for (i, record) in csv.records().enumerate() {
        let record = record.map_err(|e| uneven(path, e, names.len()))?;
        count += 1;
        let info = row(path, i, &names, &record, exposure_ms)?;
        let index = info.frame;
        first = first.or(Some(index));
        match rows.get_mut(index) {
            Some(slot @ None) => *slot = Some(info),
            Some(Some(_)) => {
                let field = format!("column `frame`, row {i}");
                return Err(SessionError::value(path, field, "each frame once", index, "number the frames from 0"));
            }
            None if index == frames && first.is_none_or(|n| n == 1) => {
                let field = format!("column `frame`, row {i}");
                let expected = format!("0 to {}", frames - 1);
                let remedy = "the frames look numbered from 1: number them from 0";
                return Err(SessionError::value(path, field, expected, index, remedy));
            }
            None => return Err(row_count(path, frames, format!("a row for frame {index}"))),
        }
    }
    if count != frames {
        return Err(row_count(path, frames, format!("{count} rows")));
    }
    Ok(rows.into_iter().flatten().collect())
}

/// What to do about a column that is missing, from the names that are there.
fn rename(column: &str, names: &[&str]) -> &'static str {
    let axis = column.split('_').next().unwrap_or(column);
    let alike = |ending: &str| names.iter().any(|n| n.eq_ignore_ascii_case(&format!("{axis}{ending}")));
    if alike("_mm") {
        "the positions look given in millimetres: multiply them by 1000, and name the columns x_um and y_um"
    } else if alike("_px") || alike("_pixel") {
        "the positions look given in pixels: multiply them by object.pixel_um, and name the columns x_um and y_um"
    } else if alike("") || alike("_um") || alike("_µm") || alike(" (um)") || alike("(um)") {
        "name the columns x_um and y_um, in small letters, and give micrometres"
    } else {
        "add the column, or rename it to the name in the session format"
    }
}

/// Rejects headers that are not names between commas: other separators, and tables without a header.
fn separated(path: &Path, names: &[&str]) -> Result<(), SessionError> {
    let expected = "names of columns, separated by commas";
    let found = names.join(",");
    if names.iter().any(|n| n.contains(';')) {
        let remedy = "the table looks separated by semicolons: write commas between the values and decimal points in \
                      them (a spreadsheet offers `CSV, comma separated`)";
        return Err(SessionError::value(path, "header", expected, found, remedy));
    }
    if names.len() == 1 && names[0].split_whitespace().count() > 1 {
        let remedy = "the table looks separated by tabs or blanks: write commas between the values";
        return Err(SessionError::value(path, "header", expected, found.replace('\t', " "), remedy));
    }
    if !names.is_empty() && names.iter().all(|n| n.parse::<f64>().is_ok()) {
        let remedy =
            "the header row is missing: begin the table with the names of its columns, such as frame,x_um,y_um";
        return Err(SessionError::value(path, "header", expected, found, remedy));
    }
    Ok(())
}

/// A row with another number of values than the header: decimal commas make two of one.
fn uneven(path: &Path, error: csv::Error, columns: usize) -> SessionError {
    let csv::ErrorKind::UnequalLengths { pos, len, .. } = error.kind() else { return csv_error(path, error) };
    let row = pos.as_ref().map_or_else(|| "a row".into(), |p| format!("line {}", p.line()));
    let remedy = if *len > columns as u64 {
        "numbers with decimal commas count as two: write decimal points (12.5); or the header lacks a column"
    } else {
        "a value is missing: write one for each column"
    };
    SessionError::value(path, row, format!("{columns} values"), len, remedy)
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
        _ => {
            let point = text.replace(',', ".");
            let remedy = if text.contains(',') && point.parse::<f64>().is_ok() {
                "the table looks written with decimal commas: write decimal points (12.5)"
            } else if name.ends_with("_um") && text.trim_end_matches(|c: char| c.is_alphabetic()).len() < text.len() {
                "write numbers alone, without units; the name of the column gives the unit"
            } else {
                "correct the table"
            };
            Err(SessionError::value(path, at(name, i), expected, format!("`{text}`"), remedy))
        }
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
