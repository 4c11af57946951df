//! What is known of each frame: its position and its time.

use super::{ImportRequest, LengthUnit, Times, files_of_rows, positions};
use crate::error::SessionError;
use crate::manifest::{ObjectGrid, Role};
use crate::stack::{FrameReader, Part};
use crate::table::{self, FrameInfo, Wanted};
use std::path::{Path, PathBuf};

/// Positions of the frames.
pub(super) struct Positions {
    /// Each frame with its position.
    pub infos: Vec<FrameInfo>,
    /// Where they are from: a table, or the recording by the names of its files.
    pub from: PathBuf,
    /// Whether they are in object pixels, not um.
    pub in_pixels: bool,
}

/// Positions of the frames: those of the table that is asked for, of names of files, or of the only table of positions
/// in their folder. `None` where there are none.
pub(super) fn positions(
    frames: &FrameReader,
    request: &ImportRequest<'_>,
    role: Option<Role>,
    notes: &mut Vec<String>,
    warnings: &mut Vec<String>,
) -> Result<Option<Positions>, SessionError> {
    let of = |path: &Path, notes: &mut Vec<String>| {
        let infos = of_table(path, frames, request, notes)?;
        Ok(Some(Positions { infos, from: path.into(), in_pixels: false }))
    };
    if let Some(path) = request.positions {
        return of(path, notes);
    }
    // Names of files are positions only where each file is one frame: several may lie at several depths.
    let files: Vec<&Path> = frames.parts().iter().map(|p| p.path.as_path()).collect();
    let single = files.len() == frames.len();
    if single && let Some(found) = positions::in_names(&files, request.unit)? {
        notes.push("positions are those in the names of the files".into());
        let infos = found.at.iter().enumerate().map(|(frame, [x_um, y_um, z_um])| FrameInfo {
            x_um: *x_um,
            y_um: *y_um,
            z_um: *z_um,
            ..FrameInfo::plain(frame, 0.0)
        });
        let in_pixels = found.in_pixels;
        return Ok(Some(Positions { infos: infos.collect(), from: frames.path().into(), in_pixels }));
    }
    let unit = request.unit.or(Some(LengthUnit::Um));
    let unused = !single && matches!(positions::in_names(&files, unit), Ok(Some(_)));
    match &tables_of_positions(frames.path())[..] {
        [path] => {
            notes.push(format!("positions are those in {}", path.display()));
            of(path, notes).map_err(or_scene)
        }
        [first, second, ..] => {
            let name = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let found = format!("several: {} and {}", name(first), name(second));
            let remedy = "choose one: --positions FILE; or write scene= in front of frames that show no beads";
            Err(SessionError::value(frames.path(), "tables of positions", "at most one", found, remedy))
        }
        [] if role == Some(Role::Bead) => {
            let found = match unused {
                true => "some in names of files, but files of several frames, and no table beside them",
                false => "none in names of files, and no table beside them",
            };
            let (expected, remedy) = ("a stage position for each bead frame", "give a table: --positions FILE");
            Err(SessionError::value(frames.path(), "positions", expected, found, remedy))
        }
        [] => {
            if unused {
                let path = frames.path().display();
                warnings.push(format!(
                    "{path}: the names of the files look like positions, but the files have several frames: no \
                     position is taken; give a table (--positions)"
                ));
            }
            Ok(None)
        }
    }
}

/// What else can be done about a table that was not asked for and holds no positions.
fn or_scene(error: SessionError) -> SessionError {
    match error {
        SessionError::Missing { path, field, found, .. } => {
            let remedy = "call its columns x_um and y_um; or, if the frames show no beads, write scene= in front of \
                          the recording";
            SessionError::Missing { path, field, found, remedy }
        }
        other => other,
    }
}

/// The table in which Miniscope V4 writes how the head of the animal is turned: it holds no positions.
const HEAD: &str = "headOrientation.csv";

/// The tables in the folder of a folder recording that may hold positions: all but those of a recorder, and those that
/// can be read and have other columns.
fn tables_of_positions(folder: &Path) -> Vec<PathBuf> {
    if super::stamps::table_of(folder).is_some() {
        return Vec::new();
    }
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|e| e.path());
    let is_table = |p: &PathBuf| {
        let hidden = p.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
        !hidden && p.extension().is_some_and(|e| e.eq_ignore_ascii_case("csv")) && p.file_name() != Some(HEAD.as_ref())
    };
    let mut tables: Vec<PathBuf> = entries.filter(is_table).collect();
    tables.sort();
    // One that is alone is meant, whatever its columns are called: what it lacks is then said.
    if tables.len() > 1 {
        tables.retain(|path| table::Grid::read(path).map_or(true, |grid| table::has_positions(&grid.names)));
    }
    tables
}

fn of_table(
    path: &Path,
    frames: &FrameReader,
    request: &ImportRequest<'_>,
    notes: &mut Vec<String>,
) -> Result<Vec<FrameInfo>, SessionError> {
    let pixel_um = super::pixel_um(request, frames);
    let of_frames = ObjectGrid { rows: frames.rows(), cols: frames.cols(), pixel_um };
    let object = request.like.as_ref().map_or(of_frames, |like| like.object);
    let wanted = Wanted { frames: frames.len(), exposure_ms: 0.0, positions: true, object: &object };
    let (infos, of_table) = table::read(path, &wanted)?;
    notes.extend(of_table);
    files_of_rows::in_order(path, infos, frames.parts(), notes)
}

/// Puts the times into the table, from the first frame on. Estimated ones are marked.
pub(super) fn times_into(infos: &mut [FrameInfo], times: &Times) {
    let marked = times.estimated > 0 || !times.interpolated.is_empty();
    for (i, (info, time)) in infos.iter_mut().zip(&times.time_s).enumerate() {
        info.time_s = in_table(*time);
        if marked {
            info.other.insert("time_is".into(), if times.is_estimated(i) { "estimated" } else { "measured" }.into());
        }
    }
}

/// Puts times by the rate that was set into the table of a recording without timestamps: each frame that is left out
/// keeps its time, and nothing is known of files that are missing.
pub(super) fn rate_into(infos: &mut [FrameInfo], parts: &[Part], interval_s: Option<f64>) {
    let Some(interval_s) = interval_s else { return };
    let starts = parts.iter().scan(0, |listed, part| Some(std::mem::replace(listed, *listed + part.listed)));
    let places = parts.iter().zip(starts).flat_map(|(part, start)| part.places().map(move |place| start + place));
    for (info, place) in infos.iter_mut().zip(places) {
        info.time_s = in_table(place as f64 * interval_s);
        info.other.insert("time_is".into(), "estimated".into());
    }
}

/// Tenths of a microsecond: the milliseconds of a table, without the error of their binary fractions.
fn in_table(time_s: f64) -> f64 {
    // Not minus zero.
    (time_s * 1e7).round() / 1e7 + 0.0
}

/// Puts into the table where each frame came from, as the recorder counts: its file, and its number there from 0. What
/// is damaged in the frame is said, too.
pub(super) fn places_into(infos: &mut [FrameInfo], parts: &[Part]) {
    let damaged = parts.iter().any(|part| !part.damaged.is_empty());
    let places = parts.iter().flat_map(|part| part.places().map(move |place| (part, place)));
    for (info, (part, place)) in infos.iter_mut().zip(places) {
        info.other.insert("recorded_in".into(), part.path.file_name().unwrap_or_default().to_string_lossy().into());
        info.other.insert("recorded_frame".into(), place.to_string());
        if damaged {
            let here = part.damaged.binary_search_by_key(&place, |(frame, _)| *frame).is_ok();
            info.other.insert("data".into(), if here { "damaged" } else { "whole" }.into());
        }
    }
}
