//! The programs ffmpeg and ffprobe, which read and write compressed videos.

use crate::error::SessionError;
use std::ffi::OsString;
use std::io::ErrorKind;
use std::path::Path;
use std::process::{Command, Output, Stdio};

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

/// A message without the addresses of decoders, which differ from run to run: `[ffv1 @ 0x55] slice CRC mismatch` is
/// `slice CRC mismatch`. Empty where nothing of it says what is wrong.
pub(crate) fn plain(message: &str) -> String {
    let mut text = message.trim();
    while let Some((_, after)) = text.split_once("] ").filter(|(before, _)| before.starts_with('[')) {
        text = after.trim_start();
    }
    // The time in the file, which is not that of the recording, is another message; so is the number of repetitions.
    let aside = (text.starts_with("at ") && text.ends_with("seconds")) || text.starts_with("Last message repeated");
    let text = if aside { "" } else { text };
    text.chars().filter(|c| !c.is_control()).take(200).collect()
}

/// Why one of the programs failed, in one line that is the same in every run; never empty.
pub(crate) fn reason(path: &Path, out: &Output) -> String {
    let text = String::from_utf8_lossy(&out.stderr);
    let named = [format!("file:{}: ", path.display()), format!("{}: ", path.display())];
    let last = text.lines().map(plain).rfind(|line| !line.is_empty());
    match last.map(|line| named.iter().fold(line, |line, name| line.replace(name, ""))) {
        Some(line) => line,
        None => match out.status.code() {
            Some(code) if code != 0 => format!("it ended with exit code {code} and gave no reason"),
            Some(_) => "it gave no reason".into(),
            None => "it was ended by the system and gave no reason".into(),
        },
    }
}

/// What to do where a video to be read needs a program that is not there.
const TO_READ: &str = "or convert the video to grey frames without compression";
/// The same for a video that is to be written.
const TO_WRITE: &str = "or choose an output that needs no other program: .npy, .tif or .zarr";

/// The program cannot be started, which a video to be read at `path` needs.
pub(crate) fn missing(path: &Path, program: &'static str, error: &std::io::Error) -> SessionError {
    not_started(path, program, error, TO_READ)
}

/// The program cannot be started, which a video to be written at `path` needs.
pub(crate) fn missing_to_write(path: &Path, program: &'static str, error: &std::io::Error) -> SessionError {
    not_started(path, program, error, TO_WRITE)
}

fn not_started(path: &Path, program: &'static str, error: &std::io::Error, instead: &'static str) -> SessionError {
    match error.kind() {
        ErrorKind::NotFound => SessionError::Program { path: path.into(), program, instead },
        _ => SessionError::format(path, "video", format!("{program} cannot be started: {error}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::ExitStatus;

    #[test]
    fn a_reason_is_one_line_without_addresses_and_never_empty() {
        let said = |text: &str| {
            let (status, stdout, stderr) = (ExitStatus::default(), Vec::new(), text.as_bytes().to_vec());
            reason("rec/1.avi".as_ref(), &Output { status, stdout, stderr })
        };
        let raw = "[ffv1 @ 0x55318f] Invalid version in global header\n    Last message repeated 1 times\n[ffv1 @ 0x7] \
                   [error] Invalid version in global header\n";
        assert_eq!(said(raw), "Invalid version in global header");
        assert_eq!(
            said("file:rec/1.avi: Invalid data found when processing input"),
            "Invalid data found when \
                   processing input"
        );
        assert!([said(""), said("\n  \n")].iter().all(|text| text.contains("no reason")));
    }
}
