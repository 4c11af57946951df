//! What to do about an error of the operating system, and how errors are shown to people.

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

/// The texts of an error and its causes, outermost first; a cause whose text the one before already holds is left out.
/// What to do about an error of the operating system follows, where the text does not say it. Never empty.
///
/// ```
/// let disk = std::io::Error::other("disk full");
/// let error = anyhow::Error::new(disk).context("a.npy: disk full").context("nothing was written");
/// assert_eq!(ommatidia_session::causes(error.as_ref()), ["nothing was written", "a.npy: disk full"]);
/// ```
pub fn causes(error: &(dyn std::error::Error + 'static)) -> Vec<String> {
    let chain = || std::iter::successors(Some(error), |e| e.source());
    let mut lines: Vec<String> = Vec::new();
    for cause in chain().map(ToString::to_string) {
        if lines.last().is_none_or(|last| !last.contains(&cause)) {
            lines.push(cause);
        }
    }
    let system = chain().find_map(|cause| cause.downcast_ref::<Error>());
    // Of other errors it is not known here whether they are of a file.
    let of_files = |e: &&Error| {
        use ErrorKind::{FileTooLarge, QuotaExceeded, ReadOnlyFilesystem, StorageFull};
        matches!(e.kind(), FileTooLarge | QuotaExceeded | ReadOnlyFilesystem | StorageFull)
    };
    if let (Some(system), Some(last)) = (system.filter(of_files), lines.last_mut()) {
        let remedy = remedy(system);
        if !chain().any(|cause| cause.to_string().contains(remedy)) {
            *last = format!("{last}; {remedy}");
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_remedy_of_a_full_disk_is_said_once() {
        let error = anyhow::Error::new(Error::from_raw_os_error(28)).context("a.npy");
        let found = causes(error.as_ref());
        assert!(found[0] == "a.npy" && found[1].contains("the disk is full: make room"), "{found:?}");
        let error = error.context(remedy(&Error::from(ErrorKind::StorageFull)));
        let whole = causes(error.as_ref()).join(" ");
        assert_eq!(whole.matches("the disk is full").count(), 1, "{whole}");
    }
}
