//! Recordings of other programs become sessions: by reference to their files, or as a copy.
//!
//! [`import`] reads every frame once, so that what it reports ([`Found`]) is what is in the files: frames that are
//! torn, repeated or missing, and the rate by the timestamps. It leaves out nothing without a line in the report.

mod describe;
mod files_of_rows;
mod found;
mod losses;
mod miniscope;
mod notes;
mod positions;
mod stamps;
mod survey;
#[cfg(test)]
mod tests;
mod times;
mod written;

pub use found::Found;
pub use losses::{DamagedFrame, Losses, Torn, losses_of};
pub use miniscope::Metadata;
pub use notes::notes_on;
pub use times::{Gap, Times};
pub use written::Written;
pub(crate) use written::not_written;

use crate::error::SessionError;
use crate::manifest::{ArrayGeometry, Manifest, ObjectGrid, Optics, Role, SensorSpec, StackEntry};
use crate::stack::FrameReader;
use crate::table::FrameInfo;
use crate::write::{Existing, SessionWriter};
use std::path::{Path, PathBuf};
use survey::{Copy, Survey};

/// Name of the report in the folder of a session that was imported.
pub const REPORT: &str = "import.json";

/// Unit of positions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LengthUnit {
    /// Micrometres.
    Um,
    /// Millimetres.
    Mm,
    /// Object pixels.
    Px,
}

impl std::str::FromStr for LengthUnit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "um" | "µm" => Ok(Self::Um),
            "mm" => Ok(Self::Mm),
            "px" => Ok(Self::Px),
            _ => Err("expected um, mm or px".into()),
        }
    }
}

/// One recording to import.
#[derive(Clone, Debug)]
pub struct Source {
    /// What its frames show; `None`: beads where there are positions, else scenes.
    pub role: Option<Role>,
    /// File of frames, or folder of numbered .avi or .tif files, or of Zarr.
    pub path: PathBuf,
}

impl Source {
    /// A reader of its frames. `variable` names the array of a .mat file, and says nothing of other files.
    ///
    /// # Errors
    /// As [`FrameReader::open_variable`].
    pub fn frames(&self, variable: Option<&str>) -> Result<FrameReader, SessionError> {
        FrameReader::open_variable(&self.path, variable.filter(|_| is_mat(&self.path)))
    }
}

fn is_mat(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("mat"))
}

/// What to import, and as what.
#[derive(Clone, Debug)]
pub struct ImportRequest<'a> {
    /// The recordings; each becomes a stack.
    pub sources: &'a [Source],
    /// Folder of the session to write.
    pub output: &'a Path,
    /// Sizes of sensor, array, optics and object; `None`: those of a camera whose pixels are the object's.
    pub like: Option<Manifest>,
    /// Side of an object pixel, um, without `like`; `None`: as the files say, or 1.
    pub pixel_um: Option<f64>,
    /// Exposure, ms; `None`: the time between frames.
    pub exposure_ms: Option<f64>,
    /// Bits of the converter; `None`: that of `like`, or the fewest of 8, 10, 12, 14 and 16 that hold all values.
    pub bit_depth: Option<u32>,
    /// Table of positions of the bead frames; `None`: names of files, or the only table in their folder.
    pub positions: Option<&'a Path>,
    /// Name of the array of .mat files that hold more than one.
    pub variable: Option<&'a str>,
    /// Unit of positions in names that state none.
    pub unit: Option<LengthUnit>,
    /// Whether to copy the frames into the session.
    pub copy: bool,
    /// Whether to replace a session that was imported before.
    pub replace: bool,
}

/// A recording that is open, with what its folder says of it.
#[derive(Debug)]
struct Opened {
    frames: FrameReader,
    metadata: Option<Metadata>,
    times: Option<Times>,
    infos: Option<Vec<FrameInfo>>,
    /// Where the positions are from: a table, or the recording by the names of its files.
    positions: PathBuf,
    /// Whether the positions are in object pixels, not um.
    in_pixels: bool,
    role: Role,
    notes: Vec<String>,
    /// What could not be read of what lies beside the frames.
    warnings: Vec<String>,
}

/// Imports recordings as a session. `progress` is called after each frame.
///
/// # Errors
/// A recording cannot be read, its sizes differ from those asked for, something is not known that only the user can say
/// (unit of positions, exposure), or the session cannot be written. Nothing is left behind then.
pub fn import(request: &ImportRequest<'_>, mut progress: impl FnMut()) -> Result<Vec<Found>, SessionError> {
    let mut opened = Vec::new();
    if let Some(name) = request.variable.filter(|_| !request.sources.iter().any(|s| is_mat(&s.path))) {
        let path = request.sources.first().map_or(request.output, |s| &s.path);
        let remedy = "leave the name out: only .mat files hold several arrays";
        return Err(SessionError::value(path, "variable", "none", name, remedy));
    }
    for source in request.sources {
        opened.push(open(source, request)?);
    }
    let Some(first) = opened.first() else {
        let remedy = "name at least one";
        return Err(SessionError::value(request.output, "recordings", "one or more", "none", remedy));
    };
    let manifest = manifest(request, first)?;
    let existing = if request.replace { Existing::ReplaceIfHas(REPORT) } else { Existing::Keep };
    let mut writer = SessionWriter::create(request.output, &manifest, existing)?;
    let mut found = Vec::new();
    for (i, mut recording) in opened.into_iter().enumerate() {
        let name = file_name(&found, recording.role);
        same_size(&recording.frames, &manifest)?;
        let frames = recording.frames.len();
        let mut infos = recording.infos.take();
        if let Some(infos) = infos.as_mut().filter(|_| recording.in_pixels) {
            crate::table::pixels_to_um(recording.frames.path(), &manifest.object, infos, &mut recording.notes)?;
        }
        if let Some(infos) = infos.as_ref().filter(|_| recording.role == Role::Bead) {
            on_the_grid(&recording, &manifest, infos)?;
        }
        let copy = request.copy.then(|| Copy::start(&writer, &format!("{name}.npy"), &recording.frames)).transpose()?;
        let survey = Survey::of(&mut recording.frames, copy, &mut progress)?;
        let exposure_ms = exposure_ms(request, &mut recording)?;
        // A table of positions, or a name, says nothing of the exposure.
        let unstated = |info: &&mut FrameInfo| info.exposure_ms == 0.0;
        infos.iter_mut().flatten().filter(unstated).for_each(|info| info.exposure_ms = exposure_ms);
        let file = match request.copy {
            true => format!("{name}.npy"),
            false => reference(recording.frames.path(), request.output)?,
        };
        let mut written: Vec<Written> = request.copy.then(|| Written::frames(file.clone())).into_iter().collect();
        let mut entry = StackEntry::plain(recording.role, file, exposure_ms);
        // A copy is a .npy file.
        entry.variable = request.variable.filter(|_| !request.copy && is_mat(&request.sources[i].path)).map(Into::into);
        // Where frames have other numbers than in the recording, or are damaged, the table says so.
        let parts = recording.frames.parts();
        let other = parts.len() > 1 || parts.iter().any(|p| p.listed > p.frames || !p.damaged.is_empty());
        if infos.is_some() || recording.times.is_some() || other {
            let given = infos.is_some();
            let plain = || (0..frames).map(|f| FrameInfo::plain(f, exposure_ms)).collect();
            let mut infos = infos.unwrap_or_else(plain);
            match &recording.times {
                Some(times) => describe::times_into(&mut infos, times),
                None if given => {}
                None => describe::rate_into(&mut infos, recording.frames.parts(), set_interval_s(&recording.frames)?),
            }
            describe::places_into(&mut infos, recording.frames.parts());
            entry.table = Some(format!("{name}.csv"));
            writer.table(&format!("{name}.csv"), &infos)?;
            written.push(Written::of(&writer, &format!("{name}.csv"))?);
        }
        if let Some(metadata) = &recording.metadata {
            let bytes = std::fs::read(&metadata.path).map_err(|e| SessionError::io(&metadata.path, e))?;
            writer.extra(&format!("{name}.metaData.json"), &bytes)?;
            written.push(Written::of(&writer, &format!("{name}.metaData.json"))?);
        }
        writer.add(entry.clone());
        found.push(Found { written, ..Found::new(&request.sources[i], entry, &recording, &survey) });
    }
    let largest = found.iter().map(|f| f.max_dn).fold(0.0, f64::max);
    writer.set_bit_depth(bit_depth(request, largest)?);
    let manifest = written::manifest(&writer)?;
    found.iter_mut().take(1).for_each(|first| first.written.push(manifest.clone()));
    let report = serde_json::to_string_pretty(&found).map_err(|e| SessionError::format(request.output, REPORT, e))?;
    writer.extra(REPORT, format!("{report}\n").as_bytes())?;
    writer.finish_checked()?;
    Ok(found)
}

/// The times of the frames of a recording that its folder holds, for reading a folder directly.
///
/// # Errors
/// A table of timestamps or the metadata cannot be read.
pub fn times_of(frames: &FrameReader) -> Result<Option<Times>, SessionError> {
    let folder = folder_of(frames.path());
    // A table of timestamps belongs to the recording in the same folder; one file of several is only a part of it.
    let Some(path) = stamps::table_of(&folder).filter(|_| frames.path().is_dir()) else { return Ok(None) };
    let metadata = miniscope::metadata(&folder)?;
    let set_s = metadata.as_ref().and_then(Metadata::interval_s).or(frames.scale().interval_s);
    let stamps = stamps::timestamps(&path, frames.parts().iter().map(|p| p.listed).sum(), set_s)?;
    if stamps.time_s.len() < 2 && frames.len() > 1 && set_s.is_none() {
        // All frames would have the same time.
        let remedy = "record it again, or give a row for each frame";
        return Err(SessionError::value(&path, "rows", "two or more", stamps.time_s.len(), remedy));
    }
    let per_file = metadata.and_then(|m| m.frames_per_file);
    Ok(Some(Times::of_table(&stamps, frames.parts(), frames.len(), per_file, set_s)))
}

/// As [`times_of`]; of a table that cannot be read, such as an empty one, what is wrong with it: its recording is read
/// like one without a table.
///
/// # Errors
/// A file cannot be opened.
pub fn times_or_why(frames: &FrameReader) -> Result<(Option<Times>, Option<String>), SessionError> {
    match times_of(frames) {
        Ok(times) => Ok((times, None)),
        Err(e @ SessionError::Io { .. }) => Err(e),
        Err(e) => Ok((None, Some(format!("{e}; its times are left out")))),
    }
}

/// What the report of an import says of the recording of a stack in the session at `session`; `None` without a report,
/// or where it is of other frames.
pub(crate) fn reported(session: &Path, file: &str, frames: usize) -> Option<Losses> {
    /// What is read of an entry of the report.
    #[derive(serde::Deserialize)]
    struct Entry {
        file: String,
        frames: usize,
        #[serde(flatten)]
        losses: Losses,
    }
    let text = std::fs::read(session.join(REPORT)).ok()?;
    let entries: Vec<Entry> = serde_json::from_slice(&text).ok()?;
    entries.into_iter().find(|entry| entry.file == file && entry.frames == frames).map(|entry| entry.losses)
}

/// The time from one frame to the next without timestamps, s: that of the metadata of a recording, else that of its
/// files. Recorders of miniscopes write another rate into the heads of their files than was set.
///
/// # Errors
/// The metadata cannot be read.
pub fn set_interval_s(frames: &FrameReader) -> Result<Option<f64>, SessionError> {
    let set = metadata_of(frames.path())?.and_then(|m| m.interval_s());
    Ok(set.or(frames.scale().interval_s))
}

/// The metadata of a recording: those in its folder, or beside an AVI of it.
fn metadata_of(path: &Path) -> Result<Option<Metadata>, SessionError> {
    let avi = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("avi"));
    if avi || path.is_dir() { miniscope::metadata(&folder_of(path)) } else { Ok(None) }
}

/// Whether the folder has a table of timestamps or the metadata of a recorder.
pub(crate) fn is_of_recorder(folder: &Path) -> bool {
    stamps::table_of(folder).is_some() || miniscope::is_there(folder)
}

fn folder_of(path: &Path) -> PathBuf {
    if path.is_dir() { path.into() } else { crate::artifact::folder_of(path).into() }
}

fn open(source: &Source, request: &ImportRequest<'_>) -> Result<Opened, SessionError> {
    let frames = source.frames(request.variable)?;
    let mut notes = Vec::new();
    let (times, warning) = times_or_why(&frames)?;
    let mut warnings: Vec<String> = warning.into_iter().collect();
    notes.extend(times.iter().flat_map(Times::sure_notes));
    if let Some((times, unit)) = times.as_ref().and_then(|times| Some((times, times.assumed.clone()?))) {
        match times.doubtful_unit {
            true => warnings.push(format!("{}: {unit}; check the rate", source.path.display())),
            false => notes.push(unit),
        }
    }
    let metadata = metadata_of(&source.path)?;
    if let Some((path, why)) = metadata.as_ref().and_then(|m| Some((m.path.display(), m.unread.as_ref()?))) {
        notes.push(format!("{path}: is no JSON, nothing is taken from it: {why}"));
    }
    for (path, what) in metadata.iter().flat_map(|m| m.unused.iter().map(|what| (m.path.display(), what))) {
        warnings.push(format!("{path}: {what}: is not understood, and not used"));
    }
    notes.extend(notes_on(&frames));
    notes.extend(notes::on_colours(&frames));
    if let Some((metadata, roi)) = metadata.as_ref().and_then(|m| Some((m, m.roi?)))
        && roi != [frames.rows(), frames.cols()]
    {
        let (path, of) = (metadata.path.display(), [frames.rows(), frames.cols()]);
        notes.push(format!("{path}: states frames of {} x {}, the files have {} x {}", roi[0], roi[1], of[0], of[1]));
    }
    let wanted = source.role.is_none_or(|role| role == Role::Bead);
    let found = match wanted {
        true => describe::positions(&frames, request, source.role, &mut notes, &mut warnings)?,
        false => None,
    };
    warnings.extend(unequal_pixels(request, &frames));
    let role = source.role.unwrap_or(if found.is_some() { Role::Bead } else { Role::Scene });
    let in_pixels = found.as_ref().is_some_and(|found| found.in_pixels);
    let (infos, positions) = found.map_or((None, PathBuf::new()), |found| (Some(found.infos), found.from));
    Ok(Opened { frames, metadata, times, infos, positions, in_pixels, role, notes, warnings })
}

/// The name of a stack's files in the session, without suffix: its role, and a number from the second stack on.
fn file_name(found: &[Found], role: Role) -> String {
    match found.iter().filter(|f| f.role == role.name()).count() {
        0 => role.name().into(),
        n => format!("{}-{}", role.name(), n + 1),
    }
}

fn manifest(request: &ImportRequest<'_>, first: &Opened) -> Result<Manifest, SessionError> {
    let stem = request.sources[0].path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    if let Some(like) = &request.like {
        return Ok(Manifest { name: stem, stacks: Vec::new(), ..like.clone() });
    }
    let (rows, cols) = (first.frames.rows(), first.frames.cols());
    let pixel_um = pixel_um(request, &first.frames);
    let side = rows.min(cols);
    Ok(Manifest {
        format: 1,
        name: stem,
        sensor: SensorSpec { rows, cols, pixel_pitch_um: pixel_um, bit_depth: 16 },
        array: ArrayGeometry::grid(1, 1, 0.0),
        optics: Optics {
            magnification: 1.0,
            psf_window_px: 15.min(side - usize::from(side % 2 == 0)),
            wavelength_um: None,
        },
        object: ObjectGrid { rows, cols, pixel_um },
        stacks: Vec::new(),
    })
}

/// Side of an object pixel, um: as it is asked for, as the files say, or 1.
fn pixel_um(request: &ImportRequest<'_>, frames: &FrameReader) -> f64 {
    request.pixel_um.or(frames.scale().pixel_um.map(|[y, _]| y)).unwrap_or(1.0)
}

/// A warning of pixels that are no squares, where their sides are those that the files state.
fn unequal_pixels(request: &ImportRequest<'_>, frames: &FrameReader) -> Option<String> {
    let [y, x] = frames.scale().pixel_um.filter(|_| request.pixel_um.is_none() && request.like.is_none())?;
    let path = frames.path().display();
    ((y - x).abs() > 1e-3 * y.max(x)).then(|| {
        format!(
            "{path}: pixels are {y} um high and {x} um wide by the file, but a session has square ones: {y} um is \
             taken for both (--pixel-um)"
        )
    })
}

fn same_size(frames: &FrameReader, manifest: &Manifest) -> Result<(), SessionError> {
    let (found, expected) = ([frames.rows(), frames.cols()], [manifest.sensor.rows, manifest.sensor.cols]);
    if found == expected {
        return Ok(());
    }
    Err(SessionError::Shape {
        path: frames.path().into(),
        expected: format!("frames of {} x {}", expected[0], expected[1]),
        found: format!("{} x {}", found[0], found[1]),
        remedy: "import recordings of one sensor, and an instrument or session of the same sensor with --like",
    })
}

/// Rejects positions of beads outside the object grid, as the session would be: in the user's file, with what of the
/// import can be wrong.
fn on_the_grid(recording: &Opened, manifest: &Manifest, infos: &[FrameInfo]) -> Result<(), SessionError> {
    let in_names = recording.positions == recording.frames.path();
    let parts = recording.frames.parts();
    for (i, info) in infos.iter().enumerate() {
        let named = parts.get(i).filter(|_| in_names).map(|part| &part.path);
        let of_bead = std::slice::from_ref(info);
        let of = named.unwrap_or(&recording.positions);
        crate::table::beads_inside(of, &manifest.object, of_bead).map_err(|e| match e {
            SessionError::Value { path, field, expected, found, .. } => {
                let field = if in_names { field.replace("column", "position") } else { field };
                let remedy = "check the unit of the positions (--unit for those in names), and that the object has the \
                              size of the instrument (--like); leave out beads outside the field";
                SessionError::Value { path, field, expected, found, remedy }
            }
            other => other,
        })?;
    }
    Ok(())
}

fn exposure_ms(request: &ImportRequest<'_>, recording: &mut Opened) -> Result<f64, SessionError> {
    if let Some(ms) = request.exposure_ms {
        return Ok(ms);
    }
    let by_times = recording.times.as_ref().and_then(|t| t.interval_s);
    let Some(interval) = by_times.map_or_else(|| set_interval_s(&recording.frames), |s| Ok(Some(s)))? else {
        let (path, remedy) = (recording.frames.path(), "state it: --exposure-ms");
        return Err(SessionError::value(path, "exposure", "a time in ms", "none in the files", remedy));
    };
    let ms = (1e6 * interval).round() / 1e3;
    recording.notes.push(format!("no exposure is stated: the time between frames, {ms} ms, is taken (--exposure-ms)"));
    Ok(ms)
}

/// Bits of the converter: as asked for, as the instrument has it, or the fewest that hold the largest value.
fn bit_depth(request: &ImportRequest<'_>, largest: f64) -> Result<u32, SessionError> {
    let top = |bits: u32| (2f64).powi(bits as i32) - 1.0;
    let given = request.bit_depth.or(request.like.as_ref().map(|m| m.sensor.bit_depth));
    let bits = given.unwrap_or_else(|| [8, 10, 12, 14, 16].into_iter().find(|b| largest <= top(*b)).unwrap_or(32));
    if largest > top(bits) {
        let (expected, remedy) = (format!("at most {} DN, {bits} bits", top(bits)), "correct --bit-depth");
        return Err(SessionError::value(&request.sources[0].path, "largest value", expected, largest, remedy));
    }
    Ok(bits)
}

/// The path of a recording as the manifest has it: relative where recording and session share a folder, so that both
/// may be moved together.
fn reference(path: &Path, output: &Path) -> Result<String, SessionError> {
    let whole = path.canonicalize().map_err(|e| SessionError::io(path, e))?;
    let parent = crate::artifact::folder_of(output).canonicalize().map_err(|e| SessionError::io(output, e))?;
    let named = match whole.strip_prefix(&parent) {
        Ok(inner) => Path::new("..").join(inner),
        Err(_) => whole,
    };
    named.to_str().map(str::to_string).ok_or_else(|| {
        let remedy = "rename it, or import a copy (--copy)";
        SessionError::value(path, "path", "UTF-8 text, as a manifest has", "other bytes", remedy)
    })
}
