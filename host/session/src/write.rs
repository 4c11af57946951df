//! Writes a session; its folder appears complete or not at all.

use super::error::SessionError;
use super::manifest::{MANIFEST, Manifest, StackEntry};
use super::stack::{FrameWriter, StackSpec};
use super::table::FrameInfo;
use crate::artifact;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// What to do if the folder exists already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Existing {
    /// Fail, unless the folder is empty.
    Keep,
    /// Replace the folder if it holds a file of this name, which marks replaceable sessions; fail otherwise.
    ReplaceIfHas(&'static str),
}

/// Writes a session into a temporary folder beside the target; [`SessionWriter::finish`] moves it to the target.
#[derive(Debug)]
pub struct SessionWriter {
    target: PathBuf,
    existing: Existing,
    folder: TempDir,
    manifest: Manifest,
}

impl SessionWriter {
    /// Starts a session at `target` with the sizes of `manifest`. Its stacks are added with [`SessionWriter::add`];
    /// those listed in `manifest` are ignored.
    ///
    /// # Errors
    /// A size is impossible, the target exists and may not be replaced, or its parent folder is missing or not
    /// writable.
    pub fn create(target: &Path, manifest: &Manifest, existing: Existing) -> Result<Self, SessionError> {
        manifest.check(&target.join(MANIFEST))?;
        may_write(target, existing)?;
        let folder = artifact::temporary_folder_beside(target).map_err(|e| SessionError::io(target, e))?;
        let manifest = Manifest { stacks: Vec::new(), ..manifest.clone() };
        Ok(Self { target: target.into(), existing, folder, manifest })
    }

    /// A writer of the frames of file `name` in the session.
    ///
    /// # Errors
    /// As [`FrameWriter::create`].
    pub fn frames(&self, name: &str, spec: StackSpec) -> Result<FrameWriter, SessionError> {
        FrameWriter::create_as(&self.folder.path().join(name), &self.target.join(name), spec)
    }

    /// Writes table `name` with one row for each frame: stage position, exposure, light level, time, the temperature if
    /// every frame has one, and the columns in [`FrameInfo::other`] of the first frame.
    ///
    /// # Errors
    /// The disk is full.
    pub fn table(&self, name: &str, rows: &[FrameInfo]) -> Result<(), SessionError> {
        let failed = |e: csv::Error| SessionError::format(&self.target.join(name), ".csv", e);
        let mut csv = csv::Writer::from_writer(Vec::new());
        let mut header: Vec<&str> = ["frame", "x_um", "y_um", "z_um", "exposure_ms", "illumination", "time_s"].to_vec();
        let with_temperature = rows.iter().all(|r| r.temperature_c.is_some());
        if with_temperature {
            header.push("temperature_c");
        }
        let other: Vec<&String> = rows.first().map(|r| r.other.keys().collect()).unwrap_or_default();
        header.extend(other.iter().map(|s| s.as_str()));
        csv.write_record(&header).map_err(failed)?;
        for row in rows {
            let numbers = [row.x_um, row.y_um, row.z_um, row.exposure_ms, row.illumination, row.time_s];
            let mut record = vec![row.frame.to_string()];
            record.extend(numbers.iter().map(f64::to_string));
            record.extend(row.temperature_c.filter(|_| with_temperature).map(|t| t.to_string()));
            record.extend(other.iter().map(|k| row.other.get(*k).cloned().unwrap_or_default()));
            csv.write_record(&record).map_err(failed)?;
        }
        let bytes = csv.into_inner().map_err(|e| failed(e.into_error().into()))?;
        self.extra(name, &bytes)
    }

    /// Writes another file into the session, e.g. the ground truth of a virtual instrument.
    ///
    /// # Errors
    /// The disk is full.
    pub fn extra(&self, name: &str, bytes: &[u8]) -> Result<(), SessionError> {
        let path = self.folder.path().join(name);
        std::fs::write(&path, bytes).map_err(|e| SessionError::io(&self.target.join(name), e))
    }

    /// Sets the bits of the converter, where they are known only after all frames were seen.
    pub fn set_bit_depth(&mut self, bits: u32) {
        self.manifest.sensor.bit_depth = bits;
    }

    /// Adds a stack to the manifest.
    pub fn add(&mut self, entry: StackEntry) {
        self.manifest.stacks.push(entry);
    }

    /// As [`SessionWriter::finish`], of a session that can be opened: a session that is refused later would block its
    /// place.
    ///
    /// # Errors
    /// As [`SessionWriter::finish`] and [`crate::Session::open`].
    pub fn finish_checked(self) -> Result<(), SessionError> {
        self.write_manifest()?;
        crate::Session::open(self.folder.path()).map_err(|e| e.moved(self.folder.path(), &self.target))?;
        self.finish()
    }

    /// SHA-256 of a file that is complete.
    pub(crate) fn hash_of(&self, name: &str) -> Result<String, SessionError> {
        let failed = |e: artifact::ArtifactError| SessionError::io(&self.target.join(name), std::io::Error::other(e));
        artifact::file_hash(&self.folder.path().join(name)).map_err(failed)
    }

    /// Writes the manifest as it stands. [`SessionWriter::finish`] writes it again.
    pub(crate) fn write_manifest(&self) -> Result<(), SessionError> {
        let path = self.target.join(MANIFEST);
        let text = toml::to_string(&self.manifest).map_err(|e| SessionError::format(&path, "session.toml", e))?;
        self.extra(MANIFEST, text.as_bytes())
    }

    /// Completes the session: the folder appears at its target.
    ///
    /// # Errors
    /// The disk is full, or another program created the target meanwhile. Nothing is left behind.
    pub fn finish(self) -> Result<(), SessionError> {
        self.write_manifest()?;
        may_write(&self.target, self.existing)?;
        artifact::replace_folder(self.folder, &self.target).map_err(|e| SessionError::io(&self.target, e))
    }
}

fn may_write(target: &Path, existing: Existing) -> Result<(), SessionError> {
    let free = match std::fs::read_dir(target) {
        Ok(mut entries) => entries.next().is_none(),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => true,
        Err(e) => return Err(SessionError::io(target, e)),
    };
    match existing {
        _ if free => Ok(()),
        Existing::ReplaceIfHas(name) if target.join(name).is_file() && target.join(MANIFEST).is_file() => Ok(()),
        _ => Err(SessionError::Taken { path: target.into() }),
    }
}
