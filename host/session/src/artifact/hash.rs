//! Hashes of files.

use super::error::ArtifactError;
use sha2::{Digest, Sha256};
use std::io::Read;
use std::path::Path;

/// SHA-256 of the content of a file, 64 hexadecimal digits; of a folder, that of the names and hashes of its files.
///
/// # Errors
/// The file cannot be read.
pub fn file_hash(path: &Path) -> Result<String, ArtifactError> {
    if path.is_dir() {
        return folder_hash(path);
    }
    let mut file = std::fs::File::open(path).map_err(|e| ArtifactError::io(path, e))?;
    let mut hash = Sha256::new();
    let mut buffer = vec![0u8; 1 << 20];
    loop {
        match file.read(&mut buffer).map_err(|e| ArtifactError::io(path, e))? {
            0 => return Ok(digits(hash)),
            n => hash.update(&buffer[..n]),
        }
    }
}

fn folder_hash(folder: &Path) -> Result<String, ArtifactError> {
    let entries = std::fs::read_dir(folder).map_err(|e| ArtifactError::io(folder, e))?;
    let paths = entries.map(|e| Ok(e?.path())).collect::<std::io::Result<Vec<_>>>();
    let mut paths = paths.map_err(|e| ArtifactError::io(folder, e))?;
    paths.sort();
    let mut hash = Sha256::new();
    for path in paths {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        hash.update(format!("{name}\n{}\n", file_hash(&path)?));
    }
    Ok(digits(hash))
}

fn digits(hash: Sha256) -> String {
    hash.finalize().iter().map(|b| format!("{b:02x}")).collect()
}
