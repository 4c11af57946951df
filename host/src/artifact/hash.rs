//! Hashes of files.

use super::error::ArtifactError;
use sha2::{Digest, Sha256};
use std::io::Read;
use std::path::Path;

/// SHA-256 of the content of a file, 64 hexadecimal digits.
///
/// # Errors
/// The file cannot be read.
pub fn file_hash(path: &Path) -> Result<String, ArtifactError> {
    let mut file = std::fs::File::open(path).map_err(|e| ArtifactError::io(path, e))?;
    let mut hash = Sha256::new();
    let mut buffer = vec![0u8; 1 << 20];
    loop {
        match file.read(&mut buffer).map_err(|e| ArtifactError::io(path, e))? {
            0 => return Ok(hash.finalize().iter().map(|b| format!("{b:02x}")).collect()),
            n => hash.update(&buffer[..n]),
        }
    }
}
