//! What is known of each frame: its position and its time.

use super::{ImportRequest, LengthUnit, Times, positions};
use crate::error::SessionError;
use crate::manifest::{ObjectGrid, Role};
use crate::stack::{FrameReader, Part};
use crate::table::{self, FrameInfo, Wanted};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Positions of the frames, and where they are from: the table that is asked for, names of files, or the only table of
/// positions in their folder. `None` where there are none. Positions in pixels are marked (`other` holds `unit`).
pub(super) fn positions(
    frames: &FrameReader,
    request: &ImportRequest<'_>,
    role: Option<Role>,
    notes: &mut Vec<String>,
) -> Result<Option<(Vec<FrameInfo>, PathBuf)>, SessionError> {
    let of = |path: &Path, notes: &mut Vec<String>| {
        of_table(path, frames, request, notes).map(|infos| Some((infos, path.to_path_buf())))
    };
    if let Some(path) = request.positions {
        return of(path, notes);
    }
    // Names of files are positions only where each file is one frame.
    let files: Vec<&Path> = frames.parts().iter().map(|p| p.path.as_path()).collect();
    if files.len() == frames.len()
        && let Some(found) = positions::in_names(&files, request.unit)?
    {
        notes.push("positions are those in the names of the files".into());
        return Ok(Some((found.iter().enumerate().map(of_name).collect(), frames.path().into())));
    }
    match &tables_of_positions(frames.path())[..] {
        [path] => {
            notes.push(format!("positions are those in {}", path.display()));
            of(path, notes)
        }
        [first, second, ..] => {
            let name = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let found = format!("several: {} and {}", name(first), name(second));
            let remedy = "choose one: --positions FILE; or write scene= in front of frames that show no beads";
            Err(SessionError::value(frames.path(), "tables of positions", "at most one", found, remedy))
        }
        [] if role == Some(Role::Bead) => Err(SessionError::value(
            frames.path(),
            "positions",
            "a stage position for each bead frame",
            "none in names of files, and no table beside them",
            "give a table: --positions FILE",
        )),
        [] => Ok(None),
    }
}

fn of_name((frame, ([x_um, y_um, z_um], unit)): (usize, &([f64; 3], LengthUnit))) -> FrameInfo {
    let mut info = FrameInfo { x_um: *x_um, y_um: *y_um, z_um: *z_um, ..FrameInfo::plain(frame, 0.0) };
    if *unit == LengthUnit::Px {
        info.other.insert("unit".into(), "px".into());
    }
    info
}

/// The table in which Miniscope V4 writes how the head of the animal is turned: it holds no positions.
const HEAD: &str = "headOrientation.csv";

/// The tables in the folder of a folder recording that may hold positions: all but those of a recorder, and those that
/// can be read and have other columns.
fn tables_of_positions(folder: &Path) -> Vec<PathBuf> {
    if super::times::table_of(folder).is_some() {
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
    let object = request.like.as_ref().map_or(
        ObjectGrid { rows: frames.rows(), cols: frames.cols(), pixel_um: request.pixel_um.unwrap_or(1.0) },
        |like| like.object,
    );
    let wanted = Wanted { frames: frames.len(), exposure_ms: 0.0, positions: true, object: &object };
    let (infos, of_table) = table::read(path, &wanted)?;
    notes.extend(of_table);
    by_file_names(path, infos, frames)
}

/// Sorts the rows of a table with a column of file names into the order of the files.
fn by_file_names(path: &Path, mut infos: Vec<FrameInfo>, frames: &FrameReader) -> Result<Vec<FrameInfo>, SessionError> {
    let column = ["file", "filename", "file_name", "name", "image"];
    let named = infos.first().and_then(|info| info.other.keys().find(|k| column.contains(&k.to_lowercase().as_str())));
    let Some(column) = named.cloned().filter(|_| frames.parts().len() == frames.len()) else { return Ok(infos) };
    let stem = |name: &str| Path::new(name).file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let places: HashMap<String, usize> =
        frames.parts().iter().enumerate().map(|(i, p)| (stem(&p.path.to_string_lossy()), i)).collect();
    let mut taken = vec![false; infos.len()];
    for info in &mut infos {
        let name = info.other.get(&column).cloned().unwrap_or_default();
        let place = places.get(&stem(&name)).filter(|i| !std::mem::replace(&mut taken[**i], true));
        info.frame = *place.ok_or_else(|| {
            let field = format!("column `{column}`, row {}", info.frame);
            SessionError::value(path, field, "each file of the folder once", name, "correct the table")
        })?;
    }
    infos.sort_by_key(|info| info.frame);
    Ok(infos)
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
    (time_s * 1e7).round() / 1e7
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
