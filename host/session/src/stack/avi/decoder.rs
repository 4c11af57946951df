//! Compressed frames, decoded by the program `ffmpeg` and read from its output one at a time.

use super::super::layout::SampleType;
use super::KIND;
use crate::error::SessionError;
use crate::ffmpeg::{self, FFMPEG, FFPROBE};
use std::io::Read;
use std::path::Path;
use std::process::{Child, ChildStdout, Stdio};

/// A running ffmpeg; dropped, it is ended.
#[derive(Debug)]
pub(super) struct Decoder {
    child: Child,
    out: ChildStdout,
    /// Index of the frame that comes next.
    pub next: usize,
    samples: SampleType,
    buffer: Vec<u8>,
}

/// How ffmpeg calls the pixels of a file, such as `gray` or `yuv420p`.
fn pixel_format(path: &Path) -> Result<String, SessionError> {
    let mut probe = ffmpeg::command(FFPROBE);
    probe.args(["-v", "error", "-select_streams", "v:0", "-show_entries", "stream=pix_fmt"]);
    probe.args(["-of", "default=nokey=1:noprint_wrappers=1"]).arg(ffmpeg::file(path));
    let out = probe.output().map_err(|e| ffmpeg::missing(path, FFPROBE, &e))?;
    let text = String::from_utf8_lossy(&out.stdout).trim().to_string();
    if !out.status.success() || text.is_empty() || text == "unknown" {
        let error = String::from_utf8_lossy(&out.stderr).trim().to_string();
        return Err(SessionError::format(path, KIND, format!("ffprobe cannot read it: {error}")));
    }
    Ok(text)
}

/// Type of the samples of a compressed file.
pub(super) fn samples(path: &Path) -> Result<SampleType, SessionError> {
    let format = pixel_format(path)?;
    let deep = ["9", "10", "12", "14", "16", "48", "64"].iter().any(|bits| {
        let name = format.trim_end_matches("le").trim_end_matches("be");
        name.ends_with(bits) && !name.ends_with("nv12") && !name.ends_with("nv16")
    });
    Ok(if deep { SampleType::U16 } else { SampleType::U8 })
}

impl Decoder {
    /// Starts at the first frame of a file with frames of this size.
    pub fn start(path: &Path, [rows, cols]: [usize; 2], samples: SampleType) -> Result<Self, SessionError> {
        let format = pixel_format(path)?;
        // The luma of a colour format, or its green: a conversion to grey would change the codes.
        let plane = match format.as_str() {
            f if f.starts_with("gray") || f == "pal8" || f.starts_with("mono") => None,
            f if f.starts_with("yuv") || f.starts_with("nv") => Some("extractplanes=y"),
            _ => Some("extractplanes=g"),
        };
        let mut command = ffmpeg::command(FFMPEG);
        command.args(["-v", "error", "-i"]).arg(ffmpeg::file(path)).args(["-map", "0:v:0"]);
        command.args(ffmpeg::each_frame_once(path)?);
        if let Some(plane) = plane {
            command.args(["-vf", plane]);
        }
        let name = if samples == SampleType::U16 { "gray16le" } else { "gray" };
        command.args(["-pix_fmt", name, "-f", "rawvideo", "-"]);
        command.stdout(Stdio::piped()).stderr(Stdio::null());
        let mut child = command.spawn().map_err(|e| ffmpeg::missing(path, FFMPEG, &e))?;
        let out = child.stdout.take().ok_or_else(|| SessionError::format(path, KIND, "ffmpeg has no output"))?;
        Ok(Self { child, out, next: 0, samples, buffer: vec![0; rows * cols * samples.bytes()] })
    }

    /// Frame `index`, which is not before [`Decoder::next`].
    pub fn frame(&mut self, path: &Path, index: usize) -> Result<Vec<f32>, SessionError> {
        while self.next <= index {
            self.out.read_exact(&mut self.buffer).map_err(|_| {
                let detail = format!("ffmpeg delivers {} frames, the file lists more: a frame is damaged", self.next);
                SessionError::format(path, KIND, detail)
            })?;
            self.next += 1;
        }
        Ok(match self.samples {
            SampleType::U16 => {
                self.buffer.chunks_exact(2).map(|b| f32::from(u16::from_le_bytes([b[0], b[1]]))).collect()
            }
            _ => self.buffer.iter().map(|b| f32::from(*b)).collect(),
        })
    }
}

impl Drop for Decoder {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
