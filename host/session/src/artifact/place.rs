//! Folders and temporary files of outputs that must appear complete or not at all.

use std::path::Path;

/// The folder of a file; `.` for a bare file name.
pub fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// The name of a temporary file for `path` is `.NAME.` and random letters and this suffix.
const UNFINISHED: &str = ".unfinished";

/// A temporary folder beside `path`, private, removed unless kept.
///
/// # Errors
/// The folder of `path` is missing or not writable.
pub fn temporary_folder_beside(path: &Path) -> std::io::Result<tempfile::TempDir> {
    tempfile::Builder::new().prefix(&unfinished_prefix(path)).suffix(UNFINISHED).tempdir_in(folder_of(path))
}

/// A temporary file in the folder of `path`. It has the permissions of a new file and is removed unless persisted.
///
/// # Errors
/// The folder is missing or not writable.
pub fn temporary_beside(path: &Path) -> std::io::Result<tempfile::NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    let prefix = unfinished_prefix(path);
    builder.prefix(&prefix).suffix(UNFINISHED);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // Temporary files are private by default; this one becomes a result. The umask still applies.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(folder_of(path))
}

/// Moves a finished temporary folder to its place; a folder that is there goes, or stays where the move fails.
///
/// # Errors
/// The folder of `path` is not writable.
pub fn replace_folder(folder: tempfile::TempDir, path: &Path) -> std::io::Result<()> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // Temporary folders are private; this one becomes a result.
        std::fs::set_permissions(folder.path(), std::fs::Permissions::from_mode(0o755))?;
    }
    let aside = temporary_folder_beside(path)?;
    if path.exists() {
        std::fs::rename(path, aside.path().join("old"))?;
    }
    // From here on the folder is not removed on drop.
    let finished = folder.keep();
    std::fs::rename(&finished, path).inspect_err(|_| {
        let _ = std::fs::remove_dir_all(&finished);
        let _ = std::fs::rename(aside.path().join("old"), path);
    })
}

fn unfinished_prefix(path: &Path) -> String {
    format!(".{}.", path.file_name().map_or("file".into(), |name| name.to_string_lossy()))
}

/// Removes the temporary files and folders of `path` that killed programs have left. The caller must know that no other
/// program is
/// writing `path`. What cannot be removed stays.
pub fn remove_leftovers(path: &Path) {
    let Ok(entries) = std::fs::read_dir(folder_of(path)) else { return };
    for entry in entries.flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let inner = name.strip_prefix(&unfinished_prefix(path)).and_then(|n| n.strip_suffix(UNFINISHED));
        if inner.is_some_and(|letters| !letters.contains('.')) {
            let _ = if entry.path().is_dir() {
                std::fs::remove_dir_all(entry.path())
            } else {
                std::fs::remove_file(entry.path())
            };
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn only_what_belongs_to_the_file_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let left = temporary_beside(&at("a.npy")).unwrap().into_temp_path().keep().unwrap();
        let other = temporary_beside(&at("a")).unwrap().into_temp_path().keep().unwrap();
        std::fs::write(at("a.npy"), b"whole").unwrap();
        remove_leftovers(&at("a.npy"));
        assert!(!left.exists() && other.exists() && at("a.npy").exists());
    }
}
