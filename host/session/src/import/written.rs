//! The files that an import wrote, so that a later one replaces nothing else.

use super::REPORT;
use super::losses::list;
use crate::artifact::file_hash;
use crate::error::SessionError;
use crate::manifest::MANIFEST;
use crate::write::SessionWriter;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A file of a session that was imported.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Written {
    /// Its name in the folder of the session.
    pub name: String,
    /// SHA-256 of its content; `None` for copies of frames, which are known by their name alone.
    pub sha256: Option<String>,
}

impl Written {
    /// A copy of frames.
    pub(super) fn frames(name: String) -> Self {
        Self { name, sha256: None }
    }

    /// A file that is complete in the folder of a writer.
    pub(super) fn of(writer: &SessionWriter, name: &str) -> Result<Self, SessionError> {
        Ok(Self { name: name.into(), sha256: Some(writer.hash_of(name)?) })
    }
}

/// Which of `names`, those in a folder, `import` did not write there, or were changed since. A folder without the list
/// of an import holds none of its files.
///
/// # Errors
/// A file cannot be read.
pub(crate) fn not_written(folder: &Path, names: &[String]) -> std::io::Result<Vec<String>> {
    /// What is read of an entry of the report.
    #[derive(Deserialize)]
    struct Entry {
        written: Vec<Written>,
    }
    if !names.iter().any(|name| name == REPORT) {
        return Ok(shortened(names.to_vec()));
    }
    let Ok(entries) = serde_json::from_slice::<Vec<Entry>>(&std::fs::read(folder.join(REPORT))?) else {
        return Ok(vec![format!("a {REPORT} that does not list what was written")]);
    };
    let written: Vec<Written> = entries.into_iter().flat_map(|entry| entry.written).collect();
    let mut others = Vec::new();
    for name in names.iter().filter(|name| *name != REPORT) {
        let known = written.iter().find(|file| file.name == *name);
        let whole = folder.join(name);
        match known {
            _ if !whole.is_file() => others.push(name.clone()),
            None => others.push(name.clone()),
            Some(Written { sha256: None, .. }) => {}
            Some(Written { sha256: Some(hash), .. }) => {
                if file_hash(&whole).map_err(std::io::Error::other)? != *hash {
                    others.push(format!("{name} (changed since)"));
                }
            }
        }
    }
    Ok(shortened(others))
}

/// The first of many names.
fn shortened(names: Vec<String>) -> Vec<String> {
    if names.is_empty() { names } else { vec![list(&names)] }
}

/// The manifest, which belongs to all recordings of a session.
pub(super) fn manifest(writer: &SessionWriter) -> Result<Written, SessionError> {
    writer.write_manifest()?;
    Written::of(writer, MANIFEST)
}
