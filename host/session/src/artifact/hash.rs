//! Hashes of files.

use super::error::ArtifactError;
use sha2::{Digest, Sha256};
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

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

/// Bytes at the start and at the end of a file that [`state_of_files`] reads.
const EACH_END: u64 = 1 << 16;

/// SHA-256 of the state of files and of all files of folders: their names, sizes, times of change, and first and last
/// 64 KiB. It changes when a file is replaced or written to, and takes little time, whatever their sizes.
///
/// # Errors
/// A file cannot be read.
pub fn state_of_files(paths: &[PathBuf]) -> Result<String, ArtifactError> {
    let mut hash = Sha256::new();
    paths.iter().try_for_each(|path| add_state(&mut hash, path))?;
    Ok(digits(hash))
}

fn add_state(hash: &mut Sha256, path: &Path) -> Result<(), ArtifactError> {
    let io = |e| ArtifactError::io(path, e);
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    if path.is_dir() {
        hash.update(format!("{name}/\n"));
        return in_folder(path)?.iter().try_for_each(|inner| add_state(hash, inner));
    }
    let mut file = std::fs::File::open(path).map_err(io)?;
    let about = file.metadata().map_err(io)?;
    let changed = about.modified().ok().and_then(|t| t.duration_since(UNIX_EPOCH).ok()).unwrap_or_default();
    // File systems differ in the fractions of seconds that they keep.
    hash.update(format!("{name} {} {}\n", about.len(), changed.as_secs()));
    for start in [0, about.len().saturating_sub(EACH_END)] {
        let mut bytes = Vec::new();
        file.seek(SeekFrom::Start(start)).map_err(io)?;
        Read::by_ref(&mut file).take(EACH_END).read_to_end(&mut bytes).map_err(io)?;
        hash.update(&bytes);
    }
    Ok(())
}

fn folder_hash(folder: &Path) -> Result<String, ArtifactError> {
    let mut hash = Sha256::new();
    for path in in_folder(folder)? {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        hash.update(format!("{name}\n{}\n", file_hash(&path)?));
    }
    Ok(digits(hash))
}

/// What is in a folder, sorted by name.
fn in_folder(folder: &Path) -> Result<Vec<PathBuf>, ArtifactError> {
    let entries = std::fs::read_dir(folder).map_err(|e| ArtifactError::io(folder, e))?;
    let paths = entries.map(|e| Ok(e?.path())).collect::<std::io::Result<Vec<_>>>();
    let mut paths = paths.map_err(|e| ArtifactError::io(folder, e))?;
    paths.sort();
    Ok(paths)
}

fn digits(hash: Sha256) -> String {
    hash.finalize().iter().map(|b| format!("{b:02x}")).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::time::{Duration, SystemTime};

    #[test]
    fn the_state_of_files_changes_with_their_ends_their_times_and_their_names() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("0.avi");
        let then = SystemTime::now() - Duration::from_secs(60);
        let write = |bytes: &[u8], time: SystemTime| {
            std::fs::write(&path, bytes).unwrap();
            std::fs::File::options().write(true).open(&path).unwrap().set_modified(time).unwrap();
            state_of_files(&[folder.path().into()]).unwrap()
        };
        let mut bytes = vec![7; 300_000];
        let first = write(&bytes, then);
        assert_eq!(write(&bytes, then), first);
        assert_ne!(write(&bytes, then + Duration::from_secs(2)), first);
        for at in [0, 299_999] {
            bytes[at] = 8;
            assert_ne!(write(&bytes, then), first, "{at}");
            bytes[at] = 7;
        }
        assert_eq!(write(&bytes, then), first);
        std::fs::rename(&path, folder.path().join("1.avi")).unwrap();
        assert_ne!(state_of_files(&[folder.path().into()]).unwrap(), first);
    }
}
