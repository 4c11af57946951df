//! The table of a stack: one row for each frame.

mod columns;
mod grid;
mod positions;

pub(crate) use grid::{Grid, text_of};
pub(crate) use positions::{beads_inside, pixels_to_um};

use crate::error::SessionError;
use crate::manifest::ObjectGrid;
use columns::{Meaning, Unit, format_name, meanings};
pub(crate) use columns::{has_positions, time_column};
pub(crate) use grid::Row;
use positions::InPixels;
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
    /// Direction (y, x) in which the stage came to this position: the sign of its last motion along each axis, less the
    /// mean over the frames of the stack; 0 before its first motion. No column: it follows from the positions.
    pub travel: [f64; 2],
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
            travel: [0.0; 2],
            other: BTreeMap::new(),
        }
    }

    /// Whether the table says that the data of the frame are damaged: `damaged` in its column `data`, which `import`
    /// writes, in small letters or capitals. Its pixels show something that was never measured.
    pub fn is_damaged(&self) -> bool {
        self.other.get("data").is_some_and(|data| data.trim().eq_ignore_ascii_case("damaged"))
    }

    /// What its column `data` says, where that is neither `whole` nor `damaged` and so says nothing.
    pub fn unknown_data(&self) -> Option<&str> {
        let data = self.other.get("data")?.trim();
        let known = data.is_empty() || data.eq_ignore_ascii_case("whole") || self.is_damaged();
        (!known).then_some(data)
    }

    /// These frames of one stack, in order, with the directions of travel that their positions say.
    pub fn travelled(mut infos: Vec<Self>) -> Vec<Self> {
        let at = |info: &Self| [info.y_um, info.x_um];
        for axis in 0..2 {
            let mut direction = 0.0;
            for i in 0..infos.len() {
                let step = at(&infos[i])[axis] - at(&infos[i.saturating_sub(1)])[axis];
                direction = if step == 0.0 { direction } else { step.signum() };
                infos[i].travel[axis] = direction;
            }
            let mean = infos.iter().map(|info| info.travel[axis]).sum::<f64>() / infos.len().max(1) as f64;
            infos.iter_mut().for_each(|info| info.travel[axis] -= mean);
        }
        infos
    }
}

/// What a table is read for.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Wanted<'a> {
    /// Number of frames of the stack.
    pub frames: usize,
    /// Exposure of frames for which the table gives no other, ms.
    pub exposure_ms: f64,
    /// Whether the positions x and y must be there.
    pub positions: bool,
    /// Grid of the object, for positions in pixels.
    pub object: &'a ObjectGrid,
}

/// Reads the table of a stack, in the order of the frames; with notes on what was not read as it stands.
///
/// # Errors
/// The file is no table, a required column is missing or has no unit, a value is not a number or outside its range, or
/// the frames are not numbered from 0 (or from 1) on, each once.
pub(crate) fn read(path: &Path, wanted: &Wanted<'_>) -> Result<(Vec<FrameInfo>, Vec<String>), SessionError> {
    let table = Table { path, grid: Grid::read(path)?, exposure_ms: wanted.exposure_ms };
    let columns = meanings(&table.grid.names);
    let mut notes = table.notes(&columns);
    if wanted.positions {
        table.need(&columns, Meaning::X)?;
        table.need(&columns, Meaning::Y)?;
    }
    let rows = table.grid.rows.iter().enumerate();
    let mut infos = rows.map(|(i, row)| table.frame(i, row, &columns)).collect::<Result<Vec<_>, _>>()?;
    if infos.len() != wanted.frames {
        return Err(row_count(path, wanted.frames, format!("{} rows", infos.len())));
    }
    let from_one = infos.iter().map(|info| info.frame).min() == Some(1);
    if from_one && infos.iter().any(|info| info.frame == wanted.frames) {
        infos.iter_mut().for_each(|info| info.frame -= 1);
        notes.push(format!("{}: frames are numbered from 1; row 1 belongs to the first frame", path.display()));
    }
    let mut sorted: Vec<Option<FrameInfo>> = vec![None; wanted.frames];
    for (row, info) in table.grid.rows.iter().zip(infos) {
        let index = info.frame;
        match sorted.get_mut(index) {
            Some(slot @ None) => *slot = Some(info),
            Some(Some(_)) => {
                let remedy = "number the frames from 0";
                return Err(table.wrong(row, "frame", "each frame once", &index.to_string(), remedy));
            }
            None => return Err(row_count(path, wanted.frames, format!("a row for frame {index}"))),
        }
    }
    let mut infos: Vec<FrameInfo> = sorted.into_iter().flatten().collect();
    table.in_micrometres(&columns, wanted, &mut infos, &mut notes)?;
    Ok((FrameInfo::travelled(infos), notes))
}

/// An open table of a stack.
struct Table<'a> {
    path: &'a Path,
    grid: Grid,
    exposure_ms: f64,
}

impl Table<'_> {
    /// Rejects a table without a column, or without its unit.
    fn need(&self, columns: &[(usize, Meaning, Unit)], meaning: Meaning) -> Result<(), SessionError> {
        let name = format_name(meaning);
        let found = columns.iter().find(|(_, m, _)| *m == meaning);
        let remedy = match found {
            Some((_, _, Unit::Unstated)) => "its name states no unit: call it x_um, x_mm or x_px (y likewise)",
            Some(_) => return Ok(()),
            None => "add the column, or rename it to the name in the session format",
        };
        Err(SessionError::Missing {
            path: self.path.into(),
            field: format!("column `{name}`"),
            found: format!("columns {}", self.grid.names.join(", ")),
            remedy,
        })
    }

    /// Converts the columns in object pixels, if there are any. Positions that are needed must lie on the object grid.
    fn in_micrometres(
        &self,
        columns: &[(usize, Meaning, Unit)],
        wanted: &Wanted<'_>,
        infos: &mut [FrameInfo],
        notes: &mut Vec<String>,
    ) -> Result<(), SessionError> {
        let pixels = |meaning| {
            let found = columns.iter().find(|(_, m, u)| *m == meaning && *u == Unit::ObjectPixel);
            found.map(|(i, ..)| format!("column `{}`", self.grid.names[*i]))
        };
        match (pixels(Meaning::X), pixels(Meaning::Y)) {
            (None, None) => Ok(()),
            (Some(x), Some(y)) => {
                let of = InPixels { path: self.path, object: wanted.object, names: [y, x], inside: wanted.positions };
                of.to_um(infos, notes)
            }
            _ => {
                let expected = "x and y in the same unit";
                let remedy = "give both in micrometres, in columns x_um and y_um";
                Err(SessionError::value(self.path, "columns of positions", expected, "one of them in pixels", remedy))
            }
        }
    }

    /// What is not read as the session format has it.
    fn notes(&self, columns: &[(usize, Meaning, Unit)]) -> Vec<String> {
        let mut notes = Vec::new();
        let read_as = |(i, meaning, unit): &(usize, Meaning, Unit)| {
            let (name, as_name) = (&self.grid.names[*i], format_name(*meaning));
            let factor = match unit {
                Unit::Times(factor) if *factor != 1.0 => format!(" (times {factor})"),
                _ => String::new(),
            };
            (name != as_name && *unit != Unit::Unstated).then(|| format!("`{name}` as {as_name}{factor}"))
        };
        let renamed: Vec<String> = columns.iter().filter_map(read_as).collect();
        if !renamed.is_empty() {
            notes.push(format!("{}: columns are read by their names: {}", self.path.display(), renamed.join(", ")));
        }
        let cells = || self.grid.rows.iter().flat_map(|r| &r.cells);
        if cells().any(|text| self.grid.decimal_comma(text)) {
            notes.push(format!("{}: numbers are read with decimal commas", self.path.display()));
        }
        notes
    }

    fn frame(&self, i: usize, row: &Row, columns: &[(usize, Meaning, Unit)]) -> Result<FrameInfo, SessionError> {
        let mut info = FrameInfo::plain(i, self.exposure_ms);
        for (at, (name, text)) in self.grid.names.iter().zip(&row.cells).enumerate() {
            let known = columns.iter().find(|(of, _, unit)| *of == at && *unit != Unit::Unstated);
            let Some((_, meaning, unit)) = known else {
                info.other.insert(name.clone(), text.clone());
                continue;
            };
            let factor = if let Unit::Times(factor) = unit { *factor } else { 1.0 };
            let number = |range| self.number(row, name, text, range).map(|v| v * factor);
            match meaning {
                Meaning::Frame => {
                    let value = number(Range::NotNegative)?;
                    if value.fract() != 0.0 {
                        return Err(self.wrong(row, name, "a whole number", text, "number the frames from 0"));
                    }
                    info.frame = value as usize;
                }
                Meaning::X => info.x_um = number(Range::Any)?,
                Meaning::Y => info.y_um = number(Range::Any)?,
                Meaning::Z => info.z_um = number(Range::Any)?,
                Meaning::Exposure => info.exposure_ms = number(Range::NotNegative)?,
                Meaning::Illumination => info.illumination = number(Range::NotNegative)?,
                Meaning::Time => info.time_s = number(Range::Any)?,
                Meaning::Temperature => info.temperature_c = Some(number(Range::Temperature)?),
            }
        }
        Ok(info)
    }

    fn number(&self, row: &Row, name: &str, text: &str, range: Range) -> Result<f64, SessionError> {
        let (low, expected) = match range {
            Range::Any => (f64::MIN, "a finite number"),
            Range::NotNegative => (0.0, "a finite number, zero or more"),
            Range::Temperature => (-273.15, "a temperature in degrees C"),
        };
        match self.grid.number(text) {
            Some(v) if v.is_finite() && v >= low => Ok(v),
            _ => {
                let point = text.replace(',', ".");
                let remedy = if text.contains(',') && point.parse::<f64>().is_ok() {
                    "write decimal points (12.5), or semicolons between the values"
                } else if text.trim_end_matches(|c: char| c.is_alphabetic()).len() < text.len()
                    && text.starts_with(|c: char| c.is_ascii_digit() || "+-.".contains(c))
                {
                    "write numbers alone, without units; the name of the column gives the unit"
                } else {
                    "correct the table"
                };
                Err(self.wrong(row, name, expected, text, remedy))
            }
        }
    }

    /// A value is wrong: names its line, and shows it.
    fn wrong(&self, row: &Row, name: &str, expected: &str, found: &str, remedy: &'static str) -> SessionError {
        let field = format!("line {}, column `{name}`", row.line);
        let found = format!("`{found}` in `{}`", row.text(self.grid.separator));
        SessionError::value(self.path, field, expected, found, remedy)
    }
}

/// Values that a column may hold.
#[derive(Clone, Copy)]
enum Range {
    Any,
    NotNegative,
    Temperature,
}

fn row_count(path: &Path, frames: usize, found: String) -> SessionError {
    SessionError::Shape {
        path: path.into(),
        expected: format!("one row for each of {frames} frames"),
        found,
        remedy: "write one row for each frame of the stack",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn travel_is_the_last_motion_of_the_stage_less_its_mean() {
        // Two rows of two positions, there and back.
        let place = |(i, (y_um, x_um)): (usize, (f64, f64))| FrameInfo { y_um, x_um, ..FrameInfo::plain(i, 1.0) };
        let scan = [(0.0, 0.0), (0.0, 5.0), (5.0, 5.0), (5.0, 0.0)].into_iter().enumerate().map(place).collect();
        let travel: Vec<[f64; 2]> = FrameInfo::travelled(scan).iter().map(|info| info.travel).collect();
        // Along y: 0, 0, 1, 1 with the mean 1/2; along x: 0, 1, 1, -1 with the mean 1/4.
        assert_eq!(travel, [[-0.5, -0.25], [-0.5, 0.75], [0.5, 0.75], [0.5, -1.25]]);
        // Twice is once, and a stage at rest has no direction.
        let rest = FrameInfo::travelled(FrameInfo::travelled(vec![FrameInfo::plain(0, 1.0), FrameInfo::plain(1, 1.0)]));
        assert!(rest.iter().all(|info| info.travel == [0.0; 2]) && FrameInfo::travelled(Vec::new()).is_empty());
    }
}
