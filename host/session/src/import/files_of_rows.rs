//! Tables whose rows name the files of a recording: they need not be in the order of the files.

use crate::error::SessionError;
use crate::stack::Part;
use crate::table::FrameInfo;
use std::collections::HashMap;
use std::path::Path;

/// Names of a column that names files, without capitals and separators.
const NAMES: [&str; 11] = [
    "file",
    "files",
    "filename",
    "filenames",
    "filepath",
    "name",
    "image",
    "imagename",
    "imagefile",
    "imgname",
    "path",
];

/// Sorts the rows of a table with a column of file names into the order of the files; rows of one file are in the order
/// of its frames. The column is one of a usual name, or one whose cells are the names of the files.
///
/// # Errors
/// A column of a usual name does not name each file once for each of its frames.
pub(super) fn in_order(
    path: &Path,
    mut infos: Vec<FrameInfo>,
    parts: &[Part],
    notes: &mut Vec<String>,
) -> Result<Vec<FrameInfo>, SessionError> {
    let files = Files::of(parts);
    let columns: Vec<String> = infos.first().map(|info| info.other.keys().cloned().collect()).unwrap_or_default();
    if parts.is_empty() {
        return Ok(infos);
    }
    let plain = |name: &str| name.to_lowercase().chars().filter(|c| c.is_alphanumeric()).collect::<String>();
    let usual = |column: &&String| NAMES.contains(&plain(column).as_str());
    // A number alone may count anything.
    let telling = |column: &&String| infos.iter().any(|i| i.other[*column].contains(|c: char| !c.is_ascii_digit()));
    let fits = |column: &&String| (usual(column) || telling(column)) && files.places(&infos, column).is_ok();
    // A column `name` of a recording whose files have many frames may name something else.
    let meant = |column: &&String| usual(column) && parts.len() == infos.len();
    let Some(column) = columns.iter().find(fits).or_else(|| columns.iter().find(meant)) else { return Ok(infos) };
    let places = files.places(&infos, column).map_err(|row| {
        let field = format!("column `{column}`, row {}", infos[row].frame);
        let found = infos[row].other[column].clone();
        SessionError::value(path, field, "each file of the folder once for each frame", found, "correct the table")
    })?;
    notes.push(format!("{}: column `{column}` says which file each row belongs to", path.display()));
    infos.iter_mut().zip(places).for_each(|(info, place)| info.frame = place);
    infos.sort_by_key(|info| info.frame);
    Ok(infos)
}

/// The files of a recording by their names.
struct Files<'a> {
    parts: &'a [Part],
    by_name: HashMap<String, usize>,
}

impl<'a> Files<'a> {
    fn of(parts: &'a [Part]) -> Self {
        let mut by_name = HashMap::new();
        for (i, part) in parts.iter().enumerate() {
            let lower = |text: Option<&std::ffi::OsStr>| text.unwrap_or_default().to_string_lossy().to_lowercase();
            by_name.insert(lower(part.path.file_stem()), i);
            by_name.insert(lower(part.path.file_name()), i);
        }
        Self { parts, by_name }
    }

    /// The frame of each row by the file that a column names, or the first row that has none.
    fn places(&self, infos: &[FrameInfo], column: &str) -> Result<Vec<usize>, usize> {
        let mut taken = vec![0; self.parts.len()];
        let mut starts = vec![0];
        starts.extend(self.parts.iter().scan(0, |frames, part| {
            *frames += part.frames;
            Some(*frames)
        }));
        let place = |(row, info): (usize, &FrameInfo)| {
            let file = info.other.get(column).and_then(|cell| self.named(cell)).ok_or(row)?;
            let frame = taken[file];
            taken[file] += 1;
            if frame < self.parts[file].frames { Ok(starts[file] + frame) } else { Err(row) }
        };
        infos.iter().enumerate().map(place).collect()
    }

    /// The file that a cell names: with or without its folder, as any system writes it, and with or without suffix.
    fn named(&self, cell: &str) -> Option<usize> {
        let name = cell.trim().rsplit(['/', '\\']).next()?.to_lowercase();
        let of = |name: &str| self.by_name.get(name).copied();
        of(&name).or_else(|| of(&Path::new(&name).file_stem()?.to_string_lossy()))
    }
}
