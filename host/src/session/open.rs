//! Opens a session and checks all of it before anything is computed.

use super::stack::{FrameReader, FrameSource, SampleType};
use super::table::{self, FrameInfo};
use super::{Manifest, Role, SessionError, StackEntry};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Name of the manifest in a session's folder.
pub const MANIFEST: &str = "session.toml";

/// A measured session that was found whole and consistent.
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
    /// Makes the frames where there is no file of them.
    maker: Option<Arc<dyn FrameSource>>,
}

impl Session {
    /// Opens the session in folder `dir`: manifest, tables, and the header and size of every stack.
    ///
    /// The values of frames and truths are checked when they are read, since a scan may be larger than memory.
    ///
    /// # Errors
    /// A file is missing, damaged, of another format version, sample type or shape than the manifest says, a table
    /// lacks a column or holds a value that cannot be, or a bead lies outside the field.
    pub fn open(dir: impl AsRef<Path>) -> Result<Self, SessionError> {
        let dir = dir.as_ref();
        let path = dir.join(MANIFEST);
        let text = std::fs::read_to_string(&path).map_err(|e| SessionError::io(&path, e))?;
        let manifest = Manifest::parse(&path, &text)?;
        let stacks = manifest.stacks.iter().map(|entry| Stack::open(dir, &path, &manifest, entry));
        let stacks = stacks.collect::<Result<_, _>>()?;
        Ok(Self { dir: dir.into(), manifest, stacks })
    }

    /// A session whose frames are made as they are asked for, `name` standing for its folder in messages: entries, what is known of
    /// each frame, and who makes it.
    pub(crate) fn made(
        name: &Path,
        manifest: Manifest,
        stacks: Vec<(StackEntry, Vec<FrameInfo>, Arc<dyn FrameSource>)>,
    ) -> Self {
        let stack = |(entry, info, maker)| Stack { entry, dir: name.into(), info, maker: Some(maker) };
        Self { dir: name.into(), manifest, stacks: stacks.into_iter().map(stack).collect() }
    }

    /// Whether its frames are made and not read.
    pub fn is_made(&self) -> bool {
        self.stacks.iter().any(|s| s.maker.is_some())
    }

    /// The session's folder.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// The manifest.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// The file of the manifest.
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

    /// The stacks of one role, of which there must be one at least.
    ///
    /// # Errors
    /// There is none.
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
            remedy: "measure that stack, or name its role",
        })
    }
}

impl Stack {
    fn open(dir: &Path, manifest_path: &Path, manifest: &Manifest, entry: &StackEntry) -> Result<Self, SessionError> {
        let frames = FrameReader::open(&dir.join(&entry.file))?;
        let sensor = [frames.len(), manifest.sensor.rows, manifest.sensor.cols];
        expect_shape(&frames, sensor, "make [sensor] and the frames agree")?;
        let required: &[&str] = if entry.role == Role::Bead { &["x_um", "y_um"] } else { &[] };
        let info = match &entry.table {
            Some(name) => table::read(&dir.join(name), frames.len(), entry.exposure_ms, required)?,
            None if required.is_empty() => (0..frames.len()).map(|i| FrameInfo::plain(i, entry.exposure_ms)).collect(),
            None => {
                return Err(SessionError::Missing {
                    path: manifest_path.into(),
                    field: format!("table of bead stack `{}`", entry.file),
                    found: "no such key".into(),
                    remedy: "a bead scan needs a table with x_um and y_um",
                });
            }
        };
        if let (Role::Bead, Some(name)) = (entry.role, &entry.table) {
            beads_inside(&dir.join(name), manifest, &info)?;
        }
        let object = [frames.len(), manifest.object.rows, manifest.object.cols];
        for (name, shape) in [(&entry.truth, object), (&entry.expected, sensor)] {
            if let Some(name) = name {
                companion(&dir.join(name), shape)?;
            }
        }
        Ok(Self { entry: entry.clone(), dir: dir.into(), info, maker: None })
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

    /// What is known of each frame, in their order.
    pub fn info(&self) -> &[FrameInfo] {
        &self.info
    }

    /// A reader of the frames, DN, [sensor rows, sensor cols].
    ///
    /// # Errors
    /// The file was taken away or changed since the session was opened.
    pub fn frames(&self) -> Result<FrameReader, SessionError> {
        match &self.maker {
            Some(maker) => Ok(FrameReader::made(&self.path(), Arc::clone(maker))),
            None => FrameReader::open(&self.path()),
        }
    }

    /// A reader of the known objects, [object rows, object cols], in a unit common to the stack.
    ///
    /// # Errors
    /// The file was taken away or changed since the session was opened.
    pub fn truth(&self) -> Result<Option<TruthReader>, SessionError> {
        self.entry.truth.as_ref().map(|f| FrameReader::open(&self.dir.join(f)).map(TruthReader)).transpose()
    }

    /// A reader of the noise-free frames, DN, [sensor rows, sensor cols], where a virtual instrument gave them.
    ///
    /// # Errors
    /// The file was taken away or changed since the session was opened.
    pub fn expected(&self) -> Result<Option<FrameReader>, SessionError> {
        self.entry.expected.as_ref().map(|f| FrameReader::open(&self.dir.join(f))).transpose()
    }
}

/// Reads known objects, and refuses negative light.
#[derive(Debug)]
pub struct TruthReader(FrameReader);

impl TruthReader {
    /// Number of objects.
    #[allow(clippy::len_without_is_empty)] // an empty stack cannot be opened
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Object of frame `i`, [object rows, object cols], >= 0.
    ///
    /// # Errors
    /// As [`FrameReader::read`], and a negative value.
    pub fn read(&mut self, i: usize) -> Result<ndarray::Array2<f32>, SessionError> {
        let object = self.0.read(i)?;
        match object.indexed_iter().find(|(_, v)| **v < 0.0) {
            None => Ok(object),
            Some(((r, c), v)) => Err(SessionError::value(
                self.0.path(),
                format!("object {i}, pixel ({r}, {c})"),
                "emitted light, zero or more",
                v,
                "subtract no background from a truth",
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

/// Checks a truth or an expectation: float32 and as many frames as the stack, of the right size.
fn companion(path: &Path, shape: [usize; 3]) -> Result<(), SessionError> {
    let frames = FrameReader::open(path)?;
    if frames.samples() != SampleType::F32 {
        let found = frames.samples().name().into();
        return Err(SessionError::SampleType { path: path.into(), expected: "float32", found });
    }
    expect_shape(&frames, shape, "one entry a frame, on the grid that the manifest names")
}

/// Refuses bead positions that are not on the object grid (its outer pixel edges included).
fn beads_inside(path: &Path, manifest: &Manifest, info: &[FrameInfo]) -> Result<(), SessionError> {
    let object = &manifest.object;
    for bead in info {
        let [r, c] = object.pixel_of_um(bead.y_um, bead.x_um);
        for (name, at, n, um) in [("y_um", r, object.rows, bead.y_um), ("x_um", c, object.cols, bead.x_um)] {
            let edge = n as f64 / 2.0 * object.pixel_um;
            if !(-0.5..=n as f64 - 0.5).contains(&at) {
                return Err(SessionError::value(
                    path,
                    format!("column `{name}`, frame {}", bead.frame),
                    format!("a position on the object grid, -{edge} to {edge} um"),
                    um,
                    "leave out the bead outside the field, check its unit, or enlarge [object]",
                ));
            }
        }
    }
    Ok(())
}
