//! One run at a time writes a file or folder.

use super::artifact::{folder_of, remove_leftovers};
use super::remedy::remedy;
use anyhow::{Context, bail};
use same_file::Handle;
use std::fs::{File, OpenOptions, TryLockError};
use std::path::{Path, PathBuf};

/// A lock of an output: a file `.NAME.lock` beside it that is locked by the operating system while the run lasts. A run
/// that is killed loses the lock with its process, and the next run takes over the file.
#[derive(Debug)]
pub struct Lock {
    path: PathBuf,
    /// Holds the lock until it is closed.
    _file: File,
}

impl Lock {
    /// The file by which an output is locked.
    pub(crate) fn path_of(output: &Path, share: Option<&str>) -> PathBuf {
        let name = output.file_name().map_or("folder".into(), |name| name.to_string_lossy().into_owned());
        let share = share.map_or(String::new(), |share| format!(".{share}"));
        folder_of(output).join(format!(".{name}{share}.lock"))
    }

    /// Locks an output, and removes what a killed run has left of it. Runs with different shares do not exclude each
    /// other.
    ///
    /// # Errors
    /// Another run holds the lock, or the folder is not writable.
    pub fn of(output: &Path, share: Option<&str>) -> anyhow::Result<Self> {
        let path = Self::path_of(output, share);
        let named = || output.display().to_string();
        loop {
            let opened = OpenOptions::new().create(true).truncate(false).write(true).open(&path);
            let file = opened.map_err(|e| {
                let text = format!("{}: cannot be written; {}", output.display(), remedy(&e));
                anyhow::Error::new(e).context(text)
            })?;
            match file.try_lock() {
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => {
                    bail!("{}: another run is writing it; wait for its end, or choose another name", output.display())
                }
                // A file system without locks: nothing more can be done.
                Err(TryLockError::Error(_)) => return Ok(Self { path, _file: file }),
            }
            // A run that ended meanwhile has removed the file: then another run may lock a new one.
            let ours = Handle::from_file(file.try_clone().with_context(named)?).with_context(named)?;
            if Handle::from_path(&path).is_ok_and(|there| there == ours) {
                remove_leftovers(output);
                return Ok(Self { path, _file: file });
            }
        }
    }
}

impl Drop for Lock {
    fn drop(&mut self) {
        // While it is locked, so that nobody else holds it. If it stays, the next run takes it over.
        let _ = std::fs::remove_file(&self.path);
    }
}
