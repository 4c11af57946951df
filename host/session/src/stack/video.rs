//! Writes a stack as a video for the eye: .avi (grey, not compressed) or .mp4, through ffmpeg.
//!
//! A video has 8 bits: zero is black, and the largest value of all frames is white. The frames are kept in a temporary
//! file until that value is known.

use super::layout::StackSpec;
use crate::error::SessionError;
use crate::ffmpeg::{self, FFMPEG};
use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::Path;
use std::process::{Command, Stdio};

/// Frames a second where the time between frames is not known.
const RATE_HZ: f64 = 20.0;

/// Keeps frames until the video can be written.
#[derive(Debug)]
pub(super) struct VideoWriter {
    kept: BufWriter<File>,
    largest: f32,
}

impl VideoWriter {
    /// Starts a video. ffmpeg is asked for at once, so that no work is lost without it.
    pub fn create(folder: &Path, shown: &Path) -> Result<Self, SessionError> {
        need_ffmpeg(shown)?;
        let kept = tempfile::tempfile_in(folder).map_err(|e| SessionError::io(shown, e))?;
        Ok(Self { kept: BufWriter::new(kept), largest: 0.0 })
    }

    pub fn push(&mut self, values: &[f32]) -> std::io::Result<()> {
        self.largest = values.iter().fold(self.largest, |most, v| most.max(*v));
        values.iter().try_for_each(|v| self.kept.write_all(&v.to_le_bytes()))
    }

    /// Writes the video to `path`, a file that exists and is empty.
    pub fn finish(
        self,
        path: &Path,
        shown: &Path,
        spec: &StackSpec,
        interval_s: Option<f64>,
    ) -> Result<(), SessionError> {
        let io = |e| SessionError::io(shown, e);
        let mut kept = self.kept.into_inner().map_err(|e| io(e.into_error()))?;
        kept.seek(SeekFrom::Start(0)).map_err(io)?;
        let mut kept = BufReader::new(kept);
        let mut command = command(path, shown, spec, interval_s);
        let mut child = command.spawn().map_err(|e| ffmpeg::missing_to_write(shown, FFMPEG, &e))?;
        let factor = if self.largest > 0.0 { 255.0 / self.largest } else { 0.0 };
        let mut frame = vec![0; 4 * spec.rows * spec.cols];
        let mut written = Ok(());
        if let Some(mut pipe) = child.stdin.take() {
            for _ in 0..spec.frames {
                kept.read_exact(&mut frame).map_err(io)?;
                let value = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
                let grey: Vec<u8> = frame.chunks_exact(4).map(|b| (factor * value(b)).round() as u8).collect();
                written = written.and_then(|()| pipe.write_all(&grey));
            }
        }
        let out = child.wait_with_output().map_err(io)?;
        if !out.status.success() || written.is_err() {
            let expected = "a video that ffmpeg can write";
            let remedy = "choose .npy, .tif or .zarr, which need no other program";
            return Err(SessionError::value(shown, "video", expected, ffmpeg::reason(path, &out), remedy));
        }
        Ok(())
    }
}

/// Refuses to begin a video without ffmpeg.
pub(super) fn need_ffmpeg(shown: &Path) -> Result<(), SessionError> {
    let found = ffmpeg::command(FFMPEG).arg("-version").stdout(Stdio::null()).stderr(Stdio::null()).status();
    found.map(drop).map_err(|e| ffmpeg::missing_to_write(shown, FFMPEG, &e))
}

fn command(path: &Path, shown: &Path, spec: &StackSpec, interval_s: Option<f64>) -> Command {
    let rate = interval_s.map_or(RATE_HZ, |s| 1.0 / s);
    let mut command = Command::new(FFMPEG);
    command.args(["-v", "error", "-y", "-f", "rawvideo", "-pix_fmt", "gray"]);
    command.args(["-s", &format!("{}x{}", spec.cols, spec.rows), "-r", &rate.to_string(), "-i", "-"]);
    if shown.extension().is_some_and(|e| e.eq_ignore_ascii_case("mp4")) {
        // The usual players need even sides and halved colours.
        let even = "pad=ceil(iw/2)*2:ceil(ih/2)*2";
        command.args(["-vf", even, "-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "18", "-f", "mp4"]);
    } else {
        command.args(["-c:v", "rawvideo", "-pix_fmt", "gray", "-f", "avi"]);
    }
    command.arg(ffmpeg::file(path));
    command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped());
    command
}
