//! What to do about an error of the operating system.

use std::io::{Error, ErrorKind};

/// What a person can do where a file cannot be opened, read or written, in words that follow a semicolon.
pub fn remedy(error: &Error) -> &'static str {
    match error.kind() {
        ErrorKind::StorageFull => {
            "the disk is full: make room on it, or choose a folder on another disk, and run the command again"
        }
        ErrorKind::QuotaExceeded => {
            "your share of the disk is used up: make room, or choose a folder on another disk, and run the command \
             again"
        }
        ErrorKind::FileTooLarge => {
            "files of this size are not allowed there: raise the limit (`ulimit -f`), or choose a folder on another \
             disk, and run the command again"
        }
        ErrorKind::ReadOnlyFilesystem => "the disk cannot be written to: choose a folder on another disk",
        ErrorKind::PermissionDenied => "check the permissions",
        ErrorKind::NotFound => "check its name, and that it exists",
        _ => "check its name, that it exists, and its permissions",
    }
}
