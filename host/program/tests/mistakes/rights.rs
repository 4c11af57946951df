//! The program with the rights of a user who owns nothing.

use crate::common::contents;
use std::fs::Permissions;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::Command;
use std::sync::LazyLock;
use tempfile::TempDir;

/// Sets the permissions of a file or folder, and gives those that it had.
pub fn set_mode(path: &Path, mode: u32) -> u32 {
    let before = std::fs::metadata(path).unwrap().mode();
    std::fs::set_permissions(path, Permissions::from_mode(mode)).unwrap();
    before
}

/// The program, to be run on a desk by a user without rights there. As root: by the user `nobody`, to whom the desk is
/// opened and who has a copy of the program. Else by the user of the tests, for whom a read-only folder is one.
pub fn as_nobody(desk: &Path) -> Command {
    const NOBODY: u32 = 65534;
    static COPY: LazyLock<TempDir> = LazyLock::new(|| {
        let folder = tempfile::Builder::new().permissions(Permissions::from_mode(0o755)).tempdir().unwrap();
        // Copied by another process: a file that this one has open for writing, or a child of it that another thread
        // starts meanwhile, cannot be run.
        let copied = Command::new("cp").arg(env!("CARGO_BIN_EXE_ommatidia")).arg(folder.path()).status().unwrap();
        assert!(copied.success(), "the program cannot be copied");
        folder
    });
    if std::fs::metadata(desk).unwrap().uid() != 0 {
        return Command::new(env!("CARGO_BIN_EXE_ommatidia"));
    }
    std::fs::set_permissions(desk, Permissions::from_mode(0o777)).unwrap();
    for path in contents(desk).keys() {
        let path = desk.join(path);
        let inside = path.ancestors().take_while(|a| *a != desk);
        inside.filter(|a| a.is_dir()).for_each(|a| {
            std::fs::set_permissions(a, Permissions::from_mode(0o777)).unwrap();
        });
        let mode = std::fs::metadata(&path).unwrap().mode();
        std::fs::set_permissions(&path, Permissions::from_mode(mode | 0o444)).unwrap();
    }
    let mut command = Command::new(COPY.path().join("ommatidia"));
    command.uid(NOBODY).gid(NOBODY).env("HOME", desk);
    command
}
