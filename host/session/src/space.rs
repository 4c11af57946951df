//! Room on a disk, asked for before hours of work.

use crate::error::SessionError;
use std::path::Path;

/// Outputs of fewer bytes are begun without a question: where they do not fit, that shows at once.
const SMALL: u64 = 64 << 20;

/// Refuses to begin what does not fit: `bytes` more in `folder`, for the output that messages name `shown`. A file
/// system that does not say how much room it has is believed to have enough; outputs below 64 MiB are not asked about.
///
/// # Errors
/// There is less room.
///
/// ```
/// let folder = tempfile::tempdir().unwrap();
/// let output = folder.path().join("x.tif");
/// assert!(ommatidia_session::need_space(folder.path(), &output, 10).is_ok());
/// let error = ommatidia_session::need_space(folder.path(), &output, u64::MAX).unwrap_err().to_string();
/// assert!(error.contains("make room"), "{error}");
/// ```
pub fn need_space(folder: &Path, shown: &Path, bytes: u64) -> Result<(), SessionError> {
    match fs4::available_space(folder) {
        Ok(free) if bytes >= SMALL && 0 < free && free < bytes => Err(SessionError::value(
            shown,
            "room on the disk",
            format!("at least {}, which the whole output needs", size(bytes)),
            size(free),
            "make room, or choose a folder on another disk",
        )),
        _ => Ok(()),
    }
}

/// Refuses to begin a file that is larger than the system allows this process to write (`ulimit -f`): the system ends a
/// process that goes beyond it, without a word. Where no such limit is known, there is none.
///
/// # Errors
/// A file of `bytes` bytes is too large; messages name it `shown`.
pub fn need_file_size(shown: &Path, bytes: u64) -> Result<(), SessionError> {
    let limit = std::fs::read_to_string("/proc/self/limits").ok().as_deref().and_then(file_size_limit);
    match limit {
        Some(limit) if bytes > limit => Err(SessionError::value(
            shown,
            "size of the file",
            format!("at most {}, the limit of the system for a file", size(limit)),
            format!("about {}", size(bytes)),
            "raise the limit (`ulimit -f unlimited`), or write fewer frames",
        )),
        _ => Ok(()),
    }
}

/// The largest file, bytes, by the list of limits that Linux gives a process; `None` where it is unlimited.
fn file_size_limit(limits: &str) -> Option<u64> {
    limits.lines().find_map(|line| line.strip_prefix("Max file size"))?.split_whitespace().next()?.parse().ok()
}

/// A number of bytes for people: `34.3 GB`.
fn size(bytes: u64) -> String {
    match bytes {
        0..1_000_000 => format!("{:.1} kB", bytes as f64 / 1e3),
        1_000_000..1_000_000_000 => format!("{:.1} MB", bytes as f64 / 1e6),
        _ => format!("{:.1} GB", bytes as f64 / 1e9),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_limit_of_a_file_is_read() {
        let list = "Limit                     Soft Limit           Hard Limit           Units     \n\
                    Max cpu time              unlimited            unlimited            seconds   \n\
                    Max file size             1024000              unlimited            bytes     \n";
        assert_eq!(file_size_limit(list), Some(1_024_000));
        assert_eq!(file_size_limit(&list.replace("1024000", "unlimited")), None);
    }
}
