//! Opens a session and checks all of it before anything is computed.

use super::error::SessionError;
use super::import::{self, Losses};
use super::manifest::{MANIFEST, Manifest, Role, StackEntry};
use super::stack::{ComputedFrames, FrameReader, SampleType};
use super::table::{self, FrameInfo, Wanted};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A measured session that is complete and consistent.
#[derive(Clone, Debug)]
pub struct Session {
    dir: PathBuf,
    manifest: Manifest,
    stacks: Vec<Stack>,
}

/// One stack of a session.
#[derive(Clone, Debug)]
pub struct Stack {
    entry: StackEntry,
    dir: PathBuf,
    info: Vec<FrameInfo>,
    /// What in its table was not read as it stands.
    notes: Vec<String>,
    /// Computes the frames of a stack that has no file.
    computed: Option<Arc<dyn ComputedFrames>>,
}

/// A stack of a session whose frames are computed when they are read.
#[derive(Clone, Debug)]
pub struct ComputedStack {
    /// Entry of the stack in the manifest; no file of that name needs to exist.
    pub entry: StackEntry,
    /// Metadata of each frame, in the order of the frames.
    pub info: Vec<FrameInfo>,
    /// Computes the frames.
    pub frames: Arc<dyn ComputedFrames>,
}

impl Session {
    /// Opens the session in folder `dir` and checks its manifest, its tables, and the header and size of every stack.
    ///
    /// The values of frames and truths are checked when they are read, because a scan may be larger than memory.
    ///
    /// # Errors
    /// A file is missing, is damaged, or differs from the manifest in format version, sample type or shape; a table
    /// lacks a column or holds an impossible value; or a bead lies outside the object grid.
    pub fn open(dir: impl AsRef<Path>) -> Result<Self, SessionError> {
        let dir = dir.as_ref();
        let folder = std::fs::metadata(dir).map_err(|e| SessionError::io(dir, e))?.is_dir();
        let path = dir.join(MANIFEST);
        if !folder || path.symlink_metadata().is_err_and(|e| e.kind() == ErrorKind::NotFound) {
            let found = if folder { "a folder without it" } else { "a file" };
            let remedy = "name the folder that holds session.toml; `ommatidia import` makes one of a recording";
            return Err(SessionError::value(dir, "session", "a folder with a session.toml", found, remedy));
        }
        let text = std::fs::read_to_string(&path).map_err(|e| SessionError::io(&path, e))?;
        let manifest = Manifest::parse(&path, &text)?;
        let stacks = manifest.stacks.iter().map(|entry| Stack::open(dir, &path, &manifest, entry));
        let stacks = stacks.collect::<Result<_, _>>()?;
        Ok(Self { dir: dir.into(), manifest, stacks })
    }

    /// A session whose frames are computed when they are read. `name` stands for its folder in error messages.
    pub fn computed(name: &Path, manifest: Manifest, stacks: Vec<ComputedStack>) -> Self {
        let stack = |s: ComputedStack| Stack {
            entry: s.entry,
            dir: name.into(),
            info: s.info,
            notes: Vec::new(),
            computed: Some(s.frames),
        };
        Self { dir: name.into(), manifest, stacks: stacks.into_iter().map(stack).collect() }
    }

    /// Whether its frames are computed rather than read from files.
    pub fn is_computed(&self) -> bool {
        self.stacks.iter().any(|s| s.computed.is_some())
    }

    /// Path of the session's folder.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// The manifest.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// What in its tables was not read as it stands: units that were converted, decimal commas, frames from 1.
    pub fn notes(&self) -> Vec<String> {
        self.stacks.iter().flat_map(|s| s.notes.iter().cloned()).collect()
    }

    /// Path of the manifest.
    pub fn manifest_path(&self) -> PathBuf {
        self.dir.join(MANIFEST)
    }

    /// All stacks, in the order of the manifest.
    pub fn stacks(&self) -> &[Stack] {
        &self.stacks
    }

    /// The stacks of one role, in the order of the manifest.
    pub fn stacks_of(&self, role: Role) -> impl Iterator<Item = &Stack> {
        self.stacks.iter().filter(move |s| s.role() == role)
    }

    /// The stacks of one role, in the order of the manifest; at least one.
    ///
    /// # Errors
    /// The session has no stack of this role.
    pub fn need(&self, role: Role) -> Result<Vec<&Stack>, SessionError> {
        let found: Vec<_> = self.stacks_of(role).collect();
        if !found.is_empty() {
            return Ok(found);
        }
        let roles: Vec<_> = self.stacks.iter().map(|s| format!("`{}`", s.role().name())).collect();
        Err(SessionError::Missing {
            path: self.manifest_path(),
            field: format!("a [[stack]] with role = \"{}\"", role.name()),
            found: format!("roles {}", if roles.is_empty() { "none".into() } else { roles.join(", ") }),
            remedy: "measure such a stack, or correct the role of one that is there",
        })
    }
}

impl Stack {
    fn open(dir: &Path, manifest_path: &Path, manifest: &Manifest, entry: &StackEntry) -> Result<Self, SessionError> {
        let path = dir.join(&entry.file);
        if matches!(path.try_exists(), Ok(false)) {
            let remedy = "check its name, and move it back, or correct `file` in the manifest";
            let (field, expected) = (format!("file of a {} stack", entry.role.name()), format!("`{}`", entry.file));
            return Err(SessionError::value(manifest_path, field, expected, "nothing of that name", remedy));
        }
        let frames = FrameReader::open_variable(&path, entry.variable.as_deref())?;
        let sensor = [frames.len(), manifest.sensor.rows, manifest.sensor.cols];
        expect_shape(&frames, sensor, "correct [sensor] in the manifest, or the frames")?;
        let positions = entry.role == Role::Bead;
        let (info, notes) = match &entry.table {
            Some(name) => {
                let wanted = Wanted {
                    frames: frames.len(),
                    exposure_ms: entry.exposure_ms,
                    positions,
                    object: &manifest.object,
                };
                table::read(&dir.join(name), &wanted)?
            }
            None if !positions => {
                ((0..frames.len()).map(|i| FrameInfo::plain(i, entry.exposure_ms)).collect(), Vec::new())
            }
            None => {
                return Err(SessionError::Missing {
                    path: manifest_path.into(),
                    field: format!("table of bead stack `{}`", entry.file),
                    found: "no key `table`".into(),
                    remedy: "give the bead scan a table with the columns x_um and y_um",
                });
            }
        };
        if let (Role::Bead, Some(name)) = (entry.role, &entry.table) {
            table::beads_inside(&dir.join(name), &manifest.object, &info)?;
        }
        let object = [frames.len(), manifest.object.rows, manifest.object.cols];
        for (name, shape) in [(&entry.truth, object), (&entry.expected, sensor)] {
            if let Some(name) = name {
                companion(&dir.join(name), shape)?;
            }
        }
        Ok(Self { entry: entry.clone(), dir: dir.into(), info, notes, computed: None })
    }

    /// What its frames show.
    pub fn role(&self) -> Role {
        self.entry.role
    }

    /// Its entry in the manifest.
    pub fn entry(&self) -> &StackEntry {
        &self.entry
    }

    /// Number of frames, at least one.
    #[allow(clippy::len_without_is_empty)] // an empty stack cannot be opened
    pub fn len(&self) -> usize {
        self.info.len()
    }

    /// The file of the frames.
    pub fn path(&self) -> PathBuf {
        self.dir.join(&self.entry.file)
    }

    /// Metadata of each frame, in the order of the frames.
    pub fn info(&self) -> &[FrameInfo] {
        &self.info
    }

    /// Metadata of the frames whose data are whole, in the order of the frames: of those that the table does not mark
    /// as damaged ([`FrameInfo::is_damaged`]).
    pub fn whole(&self) -> impl Iterator<Item = &FrameInfo> {
        self.info.iter().filter(|info| !info.is_damaged())
    }

    /// What a user should know of frames that are marked as damaged, with `what` becomes of them; None: there are none.
    pub fn damaged_note(&self, what: &str) -> Option<String> {
        let frames: Vec<usize> = self.info.iter().filter(|i| i.is_damaged()).map(|info| info.frame).collect();
        let first: Vec<String> = frames.iter().take(8).map(ToString::to_string).collect();
        let more = if frames.len() > first.len() { ", ..." } else { "" };
        (!frames.is_empty()).then(|| {
            format!(
                "{}: {} of {} frames are marked as damaged ({}{more}): {what}",
                self.path().display(),
                frames.len(),
                self.len(),
                first.join(", ")
            )
        })
    }

    /// What is lost of its recording, by the report of `import` in the folder of the session, else by the recording
    /// itself; nothing where neither says it. Damaged frames are not listed: those are marked in the table
    /// ([`FrameInfo::is_damaged`]).
    pub fn losses(&self) -> Losses {
        if self.computed.is_some() {
            return Losses::default();
        }
        let live = || self.frames().ok().and_then(|frames| import::losses_of(&frames).ok());
        let found = import::reported(&self.dir, &self.entry.file, self.len()).or_else(live);
        Losses { damaged_frames: Vec::new(), ..found.unwrap_or_default() }
    }

    /// A reader of the frames, [sensor rows, sensor cols], DN.
    ///
    /// # Errors
    /// The file was removed or changed since the session was opened.
    pub fn frames(&self) -> Result<FrameReader, SessionError> {
        match &self.computed {
            Some(frames) => Ok(FrameReader::computed(&self.path(), Arc::clone(frames))),
            None => FrameReader::open_variable(&self.path(), self.entry.variable.as_deref()),
        }
    }

    /// A reader of the known objects, [object rows, object cols], in one unit for the stack; `None` if the stack has
    /// none.
    ///
    /// # Errors
    /// The file was removed or changed since the session was opened.
    pub fn truth(&self) -> Result<Option<TruthReader>, SessionError> {
        self.entry.truth.as_ref().map(|f| FrameReader::open(&self.dir.join(f)).map(TruthReader)).transpose()
    }

    /// A reader of the noise-free frames of a virtual instrument, [sensor rows, sensor cols], DN; `None` if the stack
    /// has none.
    ///
    /// # Errors
    /// The file was removed or changed since the session was opened.
    pub fn expected(&self) -> Result<Option<FrameReader>, SessionError> {
        self.entry.expected.as_ref().map(|f| FrameReader::open(&self.dir.join(f))).transpose()
    }
}

/// Reads known objects one at a time and rejects negative light.
#[derive(Debug)]
pub struct TruthReader(FrameReader);

impl TruthReader {
    /// Number of objects.
    #[allow(clippy::len_without_is_empty)] // an empty stack cannot be opened
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Reads the object of frame `i`, [object rows, object cols], >= 0.
    ///
    /// # Errors
    /// As [`FrameReader::read`]; or the object has a negative value.
    pub fn read(&mut self, i: usize) -> Result<ndarray::Array2<f32>, SessionError> {
        let object = self.0.read(i)?;
        match object.indexed_iter().find(|(_, v)| **v < 0.0) {
            None => Ok(object),
            Some(((r, c), v)) => Err(SessionError::value(
                self.0.path(),
                format!("object {i}, pixel ({r}, {c})"),
                "emitted light, zero or more",
                v,
                "do not subtract a background from a truth",
            )),
        }
    }
}

fn expect_shape(frames: &FrameReader, expected: [usize; 3], remedy: &'static str) -> Result<(), SessionError> {
    let found = [frames.len(), frames.rows(), frames.cols()];
    if found == expected {
        return Ok(());
    }
    let path = frames.path().into();
    Err(SessionError::Shape { path, expected: format!("{expected:?}"), found: format!("{found:?}"), remedy })
}

/// Checks a file of truths or expectations: it must be float32 and have the given shape, [frames, rows, cols].
fn companion(path: &Path, shape: [usize; 3]) -> Result<(), SessionError> {
    let frames = FrameReader::open(path)?;
    if frames.samples() != SampleType::F32 {
        let found = frames.samples().name().into();
        return Err(SessionError::SampleType { path: path.into(), expected: "float32", found });
    }
    expect_shape(&frames, shape, "write one entry for each frame, on the grid that the manifest states")
}
