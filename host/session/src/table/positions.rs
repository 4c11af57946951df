//! Positions of beads: those in object pixels, and whether they lie on the object grid.

use super::FrameInfo;
use super::columns::{Meaning, Unit, format_name, meanings};
use super::grid::Grid;
use crate::error::SessionError;
use crate::manifest::ObjectGrid;
use crate::numbers::trimmed;
use std::path::Path;

/// What to do about a position outside the grid.
const OUTSIDE: &str = "check the unit of the column, leave out beads outside the field, or enlarge [object]";
/// What to do where all positions would be inside if they were counted from 0.
const FROM_ONE: &str =
    "the pixels look counted from 1, since all lie on the grid after 1 is subtracted: count them from 0";

/// Positions in object pixels.
pub(super) struct InPixels<'a> {
    /// The file that they are from.
    pub path: &'a Path,
    /// The grid of the pixels.
    pub object: &'a ObjectGrid,
    /// What holds y, and what holds x, for messages.
    pub names: [String; 2],
    /// Whether they must lie on the grid.
    pub inside: bool,
}

impl InPixels<'_> {
    /// Converts them to micrometres from the centre of the grid. They are counted from the centre where one is
    /// negative, and from the first pixel where they reach beyond half of the grid.
    ///
    /// # Errors
    /// Both, or neither, is the case; or one lies outside the grid.
    pub fn to_um(&self, infos: &mut [FrameInfo], notes: &mut Vec<String>) -> Result<(), SessionError> {
        let object = self.object;
        let half = [object.rows, object.cols].map(|n| (n as f64 - 1.0) / 2.0);
        let at = |info: &FrameInfo| [info.y_um, info.x_um];
        let negative = infos.iter().any(|i| at(i).iter().any(|v| *v < 0.0));
        let beyond = infos.iter().any(|i| at(i).iter().zip(half).any(|(v, half)| *v > half + 0.5));
        let origin = match (negative, beyond) {
            (true, false) => "the centre of the object grid",
            (false, true) => "the first object pixel",
            _ => {
                let (expected, found) =
                    ("positions counted from the centre or from the first pixel", "either may be meant");
                let remedy = "give micrometres from the centre of the field, in columns x_um and y_um";
                return Err(SessionError::value(self.path, "columns in pixels", expected, found, remedy));
            }
        };
        // From the centre, so that the grid reaches as far on one side as on the other.
        let from = if beyond { half } else { [0.0; 2] };
        if self.inside {
            self.all_inside(infos, half, from)?;
        }
        for info in infos {
            info.y_um = (info.y_um - from[0]) * object.pixel_um;
            info.x_um = (info.x_um - from[1]) * object.pixel_um;
        }
        let of = object.pixel_um;
        let path = self.path.display();
        notes.push(format!("{path}: pixels are taken as object pixels of {of} um, counted from {origin}"));
        Ok(())
    }

    /// Rejects positions outside the grid, which reaches `half` and half a pixel from its centre; that is at `from`.
    fn all_inside(&self, infos: &[FrameInfo], half: [f64; 2], from: [f64; 2]) -> Result<(), SessionError> {
        let off = |info: &FrameInfo, a: usize| [info.y_um, info.x_um][a] - from[a];
        let inside = |info: &FrameInfo, less: f64| (0..2).all(|a| (off(info, a) - less).abs() <= half[a] + 0.5);
        let Some(bead) = infos.iter().find(|info| !inside(info, 0.0)) else { return Ok(()) };
        let a = usize::from((off(bead, 0)).abs() <= half[0] + 0.5);
        let reach = [-1.0, 1.0].map(|sign| trimmed(from[a] + sign * (half[a] + 0.5), 3));
        let from_one = from != [0.0; 2] && infos.iter().all(|info| inside(info, 1.0));
        Err(SessionError::value(
            self.path,
            format!("{}, frame {}", self.names[a], bead.frame),
            format!("a position on the object grid, {} to {} px", reach[0], reach[1]),
            format!("{} px", trimmed(off(bead, a) + from[a], 3)),
            if from_one { FROM_ONE } else { OUTSIDE },
        ))
    }
}

/// Converts positions in object pixels that are from no column of a table, as [`InPixels::to_um`] does.
///
/// # Errors
/// As there.
pub(crate) fn pixels_to_um(
    path: &Path,
    object: &ObjectGrid,
    infos: &mut [FrameInfo],
    notes: &mut Vec<String>,
) -> Result<(), SessionError> {
    InPixels { path, object, names: ["y", "x"].map(String::from), inside: true }.to_um(infos, notes)
}

/// Rejects bead positions, um, outside the object grid; the outer edges of its pixels still count as inside. `path` is
/// the table that they are from: the message names its column, and the value with the unit of that column.
///
/// # Errors
/// A position lies outside.
pub(crate) fn beads_inside(path: &Path, object: &ObjectGrid, infos: &[FrameInfo]) -> Result<(), SessionError> {
    for bead in infos {
        let [r, c] = object.pixel_of_um(bead.y_um, bead.x_um);
        for (meaning, at, n, um) in [(Meaning::Y, r, object.rows, bead.y_um), (Meaning::X, c, object.cols, bead.x_um)] {
            if (-0.5..=n as f64 - 0.5).contains(&at) {
                continue;
            }
            let (name, factor, unit) = column(path, meaning);
            let edge = trimmed(n as f64 / 2.0 * object.pixel_um / factor, 6);
            return Err(SessionError::value(
                path,
                format!("column `{name}`, frame {}", bead.frame),
                format!("a position on the object grid, -{edge} to {edge} {unit}"),
                format!("{} {unit}", trimmed(um / factor, 6)),
                OUTSIDE,
            ));
        }
    }
    Ok(())
}

/// The column of a table that holds positions along an axis: its name, its unit in um, and that unit's name. Where the
/// table cannot be read any more, that of the session format.
fn column(path: &Path, meaning: Meaning) -> (String, f64, &'static str) {
    let units = [(1e-3, "nm"), (1.0, "um"), (1e3, "mm")];
    let found = Grid::read(path).ok().and_then(|grid| {
        let (i, _, unit) = meanings(&grid.names).into_iter().find(|(_, m, _)| *m == meaning)?;
        let (factor, unit) = units.into_iter().find(|(factor, _)| unit == Unit::Times(*factor))?;
        Some((grid.names[i].clone(), factor, unit))
    });
    found.unwrap_or_else(|| (format_name(meaning).into(), 1.0, "um"))
}
