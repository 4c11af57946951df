//! Compressed frames, decoded by the program `ffmpeg` and read from its output one at a time.
//!
//! ffmpeg goes on where a frame is damaged: it invents the pixels that it cannot decode, or leaves the frame out. Both
//! show only in what it says. Its filter `showinfo` names each frame that it delivers, so that a number that is skipped
//! is a frame that was left out; where it says errors, ffprobe is asked for the frames that they are of ([`Faults`]).

use super::super::layout::SampleType;
use super::faults::Faults;
use super::{Decoded, KIND, Movie};
use crate::error::SessionError;
use crate::ffmpeg::{self, FFMPEG, FFPROBE};
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, ChildStderr, ChildStdout, Stdio};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

/// What ffprobe says of a compressed file.
#[derive(Debug)]
pub(super) struct Coding {
    /// How ffmpeg calls its pixels, such as `gray` or `yuv420p`.
    format: String,
    /// Whether codes are of limited range: black is 16 and white 235 (of 8 bits).
    pub limited: bool,
    /// Whether frames are stored in another order than they are shown in.
    reordered: bool,
}

/// A running ffmpeg; dropped, it is ended.
#[derive(Debug)]
pub(super) struct Decoder {
    child: Child,
    out: ChildStdout,
    said: Receiver<Said>,
    /// Place of the frame in `buffer` among those that the file lists; `None` before the first.
    at: Option<usize>,
    /// Whether there was a frame before that in `buffer`.
    has_before: bool,
    /// Whether ffmpeg has delivered its last frame.
    ended: bool,
    /// Index of the first frame that can still be asked for.
    pub next: usize,
    buffer: Vec<u8>,
    /// The frame before that in `buffer`.
    before: Vec<u8>,
    /// Whether ffmpeg has said any error.
    errors: bool,
}

/// What ffmpeg says up to one frame; after the last frame, what it says at the end.
#[derive(Debug, Default)]
struct Said {
    /// The number of the frame, by its time; `None` at the end.
    place: Option<usize>,
    /// Whether there was an error.
    error: bool,
}

/// The part of a frame that holds its light without its colours.
const LUMA: &str = "luma";

/// How long a frame that was delivered waits for its name: an ffmpeg that names none must not stop the reading.
const PATIENCE: Duration = Duration::from_secs(5);

impl Coding {
    /// Asks ffprobe for the coding of a file, whose header states the four letters `code`.
    pub fn of(path: &Path, code: [u8; 4]) -> Result<Self, SessionError> {
        let mut probe = ffmpeg::command(FFPROBE);
        probe.args(["-v", "error", "-select_streams", "v:0"]);
        probe.args([
            "-show_entries",
            "stream=codec_name,pix_fmt,color_range,has_b_frames",
            "-of",
            "default=noprint_wrappers=1",
        ]);
        let out = probe.arg(ffmpeg::file(path)).output().map_err(|e| ffmpeg::missing(path, FFPROBE, &e))?;
        let text = String::from_utf8_lossy(&out.stdout);
        let entry = |name: &str| {
            let found = text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix('='));
            found.unwrap_or("").trim().to_string()
        };
        let format = entry("pix_fmt");
        if !out.status.success() || format.is_empty() || format == "unknown" {
            let letters: String =
                code.iter().map(|b| if b.is_ascii_graphic() { char::from(*b) } else { '?' }).collect();
            let codec = entry("codec_name");
            let detail = match codec.as_str() {
                "unknown" => format!("ffmpeg does not know its coding, `{letters}`; a newer one may"),
                "" => format!("ffprobe cannot read it: {}", ffmpeg::reason(path, &out)),
                _ => format!("ffmpeg cannot read the header of its coding, {codec}: {}", ffmpeg::reason(path, &out)),
            };
            return Err(SessionError::format(path, KIND, detail));
        }
        // Formats of luma and colour have a limited range where none is stated; those named `yuvj` have the full one.
        let limited = (format.starts_with("yuv") || format.starts_with("nv"))
            && !format.starts_with("yuvj")
            && !["pc", "jpeg", "full"].contains(&entry("color_range").as_str());
        Ok(Self { format, limited, reordered: entry("has_b_frames").parse().unwrap_or(0) > 0 })
    }

    /// What is taken of a format with colours: its luma, or its green. A conversion to grey would change the codes.
    pub fn taken_of_colours(&self) -> Option<&'static str> {
        match self.format.as_str() {
            f if f.starts_with("gray") || f == "pal8" || f.starts_with("mono") => None,
            f if f.starts_with("yuv") || f.starts_with("nv") => Some(LUMA),
            _ => Some("green"),
        }
    }

    /// Type of the samples.
    pub fn samples(&self) -> SampleType {
        let name = self.format.trim_end_matches("le").trim_end_matches("be");
        let deep = ["9", "10", "12", "14", "16", "48", "64"].iter().any(|bits| name.ends_with(bits));
        if deep && !name.ends_with("nv12") && !name.ends_with("nv16") { SampleType::U16 } else { SampleType::U8 }
    }
}

impl Decoder {
    /// Starts at the first frame of a file.
    pub fn start(path: &Path, movie: &Movie, coding: &Coding) -> Result<Self, SessionError> {
        let plane = match coding.taken_of_colours() {
            None => "",
            Some(LUMA) => "extractplanes=y,",
            Some(_) => "extractplanes=g,",
        };
        let mut command = ffmpeg::command(FFMPEG);
        command.args(["-hide_banner", "-nostats", "-v", "level+info", "-i"]);
        command.arg(ffmpeg::file(path)).args(["-map", "0:v:0"]).args(ffmpeg::each_frame_once(path)?);
        command.args(["-vf", &format!("{plane}showinfo=checksum=0")]);
        let name = if movie.samples == SampleType::U16 { "gray16le" } else { "gray" };
        command.args(["-pix_fmt", name, "-f", "rawvideo", "-"]);
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().map_err(|e| ffmpeg::missing(path, FFMPEG, &e))?;
        let silent = || SessionError::format(path, KIND, "ffmpeg has no output");
        let out = child.stdout.take().ok_or_else(silent)?;
        let stderr = child.stderr.take().ok_or_else(silent)?;
        let (to, said) = channel();
        // Ends with ffmpeg, which is ended with the decoder.
        std::thread::spawn(move || listen(stderr, &to));
        let bytes = movie.rows * movie.cols * movie.samples.bytes();
        let (buffer, before) = (vec![0; bytes], vec![0; bytes]);
        let (at, has_before, ended, next, errors) = (None, false, false, 0, false);
        Ok(Self { child, out, said, at, has_before, ended, next, buffer, before, errors })
    }

    /// Whole frame `index`, which is not before [`Decoder::next`]. Where it cannot be decoded, the frame before stands
    /// in its place, or the next one at the start of a file. `faults` are found where they are needed.
    pub fn frame(
        &mut self,
        path: &Path,
        movie: &Movie,
        coding: &Coding,
        faults: &mut Option<Faults>,
        index: usize,
    ) -> Result<Decoded, SessionError> {
        // By their times frames are counted as the file lists them, without data or not.
        let place = if coding.reordered { index } else { movie.chunks[index].0 };
        while !self.ended && self.at.is_none_or(|at| at < place) {
            self.advance(movie.slots, coding.reordered);
        }
        self.next = index + 1;
        let stands = |which: &str| Some(format!("it cannot be decoded; the frame {which} stands in its place"));
        let (bytes, damage) = match self.at {
            Some(at) if at == place => {
                if self.errors && faults.is_none() {
                    *faults = Some(Faults::of(path, movie, coding.reordered)?);
                }
                (&self.buffer, faults.as_ref().and_then(|faults| faults.at(place)).map(str::to_string))
            }
            Some(at) if at > place && self.has_before => (&self.before, stands("before")),
            Some(at) if at > place => (&self.buffer, stands("after it")),
            Some(_) => (&self.buffer, stands("before")),
            None => return Err(SessionError::format(path, KIND, "ffmpeg decodes none of its frames")),
        };
        let values = match movie.samples {
            SampleType::U16 => bytes.chunks_exact(2).map(|b| f32::from(u16::from_le_bytes([b[0], b[1]]))).collect(),
            _ => bytes.iter().map(|b| f32::from(*b)).collect(),
        };
        Ok(Decoded { values, damage })
    }

    /// Takes the next frame that ffmpeg delivers.
    fn advance(&mut self, slots: usize, reordered: bool) {
        std::mem::swap(&mut self.buffer, &mut self.before);
        let delivered = self.out.read_exact(&mut self.buffer).is_ok();
        // It is said before the frame is delivered.
        let said = self.said.recv_timeout(PATIENCE).unwrap_or_default();
        self.errors |= said.error;
        if !delivered {
            // The last frame stays where it is.
            std::mem::swap(&mut self.buffer, &mut self.before);
            self.ended = true;
            return;
        }
        self.has_before = self.at.is_some();
        let next = self.at.map_or(0, |at| at + 1);
        let stated = said.place.filter(|place| !reordered && (next..slots).contains(place));
        self.at = Some(stated.unwrap_or(next));
    }
}

/// Passes on what ffmpeg says, frame by frame.
fn listen(stderr: ChildStderr, to: &Sender<Said>) {
    let mut lines = BufReader::new(stderr);
    let (mut error, mut line) = (false, Vec::new());
    while lines.read_until(b'\n', &mut line).is_ok_and(|n| n > 0) {
        let text = String::from_utf8_lossy(&line);
        if let Some(place) = frame_in(&text) {
            if to.send(Said { place, error: std::mem::take(&mut error) }).is_err() {
                return;
            }
        } else {
            error |= is_error(&text);
        }
        line.clear();
    }
    // Nobody hears it where the frames of interest are read.
    let _ = to.send(Said { place: None, error });
}

/// The number of the frame that a line of `showinfo` names: its time in units of the stream, which in an AVI is the
/// time from one frame to the next. `Some(None)`: a frame without a time.
fn frame_in(line: &str) -> Option<Option<usize>> {
    let (_, after) = line.strip_prefix("[Parsed_showinfo")?.split_once(" pts:")?;
    Some(after.split_whitespace().next().and_then(|time| time.parse().ok()))
}

/// Whether a line is an error: `[ffv1 @ 0x55] [error] slice CRC mismatch`.
fn is_error(line: &str) -> bool {
    line.contains("[error] ") || line.contains("[fatal] ")
}

impl Drop for Decoder {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_ffmpeg_are_understood() {
        let info = "[Parsed_showinfo_1 @ 0x55] [info] n:  16 pts:     17 pts_time:0.28 pos: 303824 fmt:gray \n";
        assert_eq!(frame_in(info), Some(Some(17)));
        assert_eq!(frame_in("[Parsed_showinfo_0 @ 0x55] [info] config in time_base: 1/60, frame_rate: 60/1"), None);
        assert_eq!(frame_in("[Parsed_showinfo_0 @ 0x55] [info] n: 0 pts:   NOPTS pts_time:NOPTS"), Some(None));
        assert!(is_error("[ffv1 @ 0x56] [error] slice CRC mismatch 8C3036CA!at 0.283333 seconds"));
        assert!(!is_error("[swscaler @ 0x1] [warning] deprecated pixel format used"));
    }
}
