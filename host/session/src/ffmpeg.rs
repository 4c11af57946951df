//! The programs ffmpeg and ffprobe, which read and write compressed videos.

use crate::error::SessionError;
use std::ffi::OsString;
use std::io::ErrorKind;
use std::path::Path;
use std::process::{Command, Stdio};

pub(crate) const FFMPEG: &str = "ffmpeg";
pub(crate) const FFPROBE: &str = "ffprobe";

/// One of the programs, without input from the terminal.
pub(crate) fn command(program: &str) -> Command {
    let mut command = Command::new(program);
    command.stdin(Stdio::null());
    command
}

/// A file as an argument: its name is never taken for an option or a protocol.
pub(crate) fn file(path: &Path) -> OsString {
    let mut name = OsString::from("file:");
    name.push(path);
    name
}

/// The options that neither repeat nor drop frames; before version 5.1 they had another name.
pub(crate) fn each_frame_once(path: &Path) -> Result<[&'static str; 2], SessionError> {
    let out = command(FFMPEG).arg("-version").output().map_err(|e| missing(path, FFMPEG, &e))?;
    let text = String::from_utf8_lossy(&out.stdout);
    let version = text.strip_prefix("ffmpeg version ").unwrap_or("").trim_start_matches('n');
    let mut numbers = version.split(['.', '-', ' ']).map(|n| n.parse::<u32>().ok());
    let old = match (numbers.next().flatten(), numbers.next().flatten()) {
        (Some(major), minor) => (major, minor.unwrap_or(0)) < (5, 1),
        _ => false,
    };
    Ok(if old { ["-vsync", "0"] } else { ["-fps_mode", "passthrough"] })
}

/// The program cannot be started.
pub(crate) fn missing(path: &Path, program: &'static str, error: &std::io::Error) -> SessionError {
    match error.kind() {
        ErrorKind::NotFound => SessionError::Program { path: path.into(), program },
        _ => SessionError::format(path, "video", format!("{program} cannot be started: {error}")),
    }
}
