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
    /// Rows and columns of the frames that ffmpeg delivers, where ffprobe states them. The header of the file may state
    /// others.
    pub size: Option<[usize; 2]>,
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
    /// The last error that it said.
    last_error: String,
}

/// What ffmpeg says up to one frame; after the last frame, what it says at the end.
#[derive(Debug, Default)]
struct Said {
    /// The number of the frame, by its time; `None` at the end.
    place: Option<usize>,
    /// The last error, if there was one.
    error: Option<String>,
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
            "stream=codec_name,pix_fmt,width,height,color_range,has_b_frames",
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
        Ok(Self::stated(entry))
    }

    /// The coding by the entries of ffprobe.
    fn stated(entry: impl Fn(&str) -> String) -> Self {
        let format = entry("pix_fmt");
        // Formats of luma and colour have a limited range where none is stated; those named `yuvj` have the full one.
        let limited = is_luma(&format)
            && !format.starts_with("yuvj")
            && !["pc", "jpeg", "full"].contains(&entry("color_range").as_str());
        let side = |name: &str| entry(name).parse::<usize>().ok().filter(|n| *n > 0);
        let size = side("height").zip(side("width")).map(|(rows, cols)| [rows, cols]);
        Self { format, limited, reordered: entry("has_b_frames").parse().unwrap_or(0) > 0, size }
    }

    /// What is taken of a format with colours: its luma, or its green. A conversion to grey would change the codes.
    pub fn taken_of_colours(&self) -> Option<&'static str> {
        match self.format.as_str() {
            f if f.starts_with("gray") || f == "pal8" || f.starts_with("mono") => None,
            f if is_luma(f) => Some(LUMA),
            _ => Some("green"),
        }
    }

    /// Bits of a sample, by the end of the name: `gray10le`, `yuv420p12le`, `rgb48le`.
    fn bits(&self) -> u32 {
        let name = self.format.trim_end_matches("le").trim_end_matches("be");
        // Their numbers count the bits of a pixel, or are none of bits.
        if ["nv12", "nv16", "nv21", "nv24", "nv42"].contains(&name) {
            return 8;
        }
        let ends = [("9", 9), ("10", 10), ("12", 12), ("14", 14), ("16", 16), ("48", 16), ("64", 16), ("nv20", 10)];
        ends.iter().find(|(end, _)| name.ends_with(end)).map_or(8, |(_, bits)| *bits)
    }

    /// Type of the samples.
    pub fn samples(&self) -> SampleType {
        if self.bits() > 8 { SampleType::U16 } else { SampleType::U8 }
    }

    /// How ffmpeg calls grey of as many bits: of more bits, it would multiply the codes.
    fn delivered(&self) -> String {
        match self.bits() {
            8 => "gray".into(),
            bits => format!("gray{bits}le"),
        }
    }
}

/// Whether a format has luma and colours, in planes (`yuv420p`, `nv12`, `p010le`) or in turns (`yuyv422`, `uyvy422`).
fn is_luma(format: &str) -> bool {
    let planes_of_two = ["p0", "p2", "p4"].iter().any(|start| format.starts_with(start));
    let in_turns = ["uyvy", "yvyu", "uyyvyy", "y210", "y212", "y216", "ayuv", "vuya", "vuyx", "xv30", "xv36", "uyva"];
    format.starts_with("yuv")
        || format.starts_with("yuyv")
        || format.starts_with("nv")
        || planes_of_two
        || in_turns.iter().any(|start| format.starts_with(start))
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
        command.args(["-pix_fmt", &coding.delivered(), "-f", "rawvideo", "-"]);
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
        let (at, has_before, ended, next, errors, last_error) = (None, false, false, 0, false, String::new());
        Ok(Self { child, out, said, at, has_before, ended, next, buffer, before, errors, last_error })
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
            None => {
                let because = if self.last_error.is_empty() { "" } else { ": " };
                let detail = format!("ffmpeg decodes none of its frames{because}{}", self.last_error);
                return Err(SessionError::format(path, KIND, detail));
            }
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
        self.errors |= said.error.is_some();
        if let Some(text) = said.error.filter(|text| !text.is_empty()) {
            self.last_error = text;
        }
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
    let (mut error, mut line) = (None, Vec::new());
    while lines.read_until(b'\n', &mut line).is_ok_and(|n| n > 0) {
        let text = String::from_utf8_lossy(&line);
        if let Some(place) = frame_in(&text) {
            if to.send(Said { place, error: error.take() }).is_err() {
                return;
            }
        } else if is_error(&text) {
            error = Some(said_in(&text)).filter(|text| !text.is_empty()).or(error).or(Some(String::new()));
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

/// What an error says, without the names of what says it.
fn said_in(line: &str) -> String {
    ffmpeg::plain(line.split_once("[error] ").or(line.split_once("[fatal] ")).map_or(line, |(_, text)| text))
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
    #[test]
    fn the_coding_is_what_ffprobe_states() {
        let of = |text: &'static str| {
            let entry = |name: &str| text.split(' ').find_map(|e| e.strip_prefix(name)?.strip_prefix('='));
            Coding::stated(|name| entry(name).unwrap_or("").to_string())
        };
        // The size is that of the frames that are delivered.
        let coding = of("pix_fmt=yuvj420p width=80 height=64 color_range=pc has_b_frames=0");
        assert_eq!((coding.size, coding.limited, coding.reordered), (Some([64, 80]), false, false));
        let coding = of("pix_fmt=uyvy422 width=80 height=0 color_range=unknown has_b_frames=2");
        assert_eq!((coding.size, coding.limited, coding.reordered), (None, true, true));
        assert!(!of("pix_fmt=gray10le").limited);
    }

    #[test]
    fn codes_are_delivered_as_they_are_stored() {
        let of = |format: &str| {
            let coding = Coding { format: format.into(), limited: false, reordered: false, size: None };
            (coding.delivered(), coding.samples(), coding.taken_of_colours())
        };
        use SampleType::{U8, U16};
        for (format, delivered, samples, taken) in [
            ("gray", "gray", U8, None),
            ("gray10le", "gray10le", U16, None),
            ("gray12le", "gray12le", U16, None),
            ("gray16be", "gray16le", U16, None),
            ("yuv420p", "gray", U8, Some("luma")),
            ("yuv420p10le", "gray10le", U16, Some("luma")),
            ("p010le", "gray10le", U16, Some("luma")),
            ("nv12", "gray", U8, Some("luma")),
            ("yuyv422", "gray", U8, Some("luma")),
            ("uyvy422", "gray", U8, Some("luma")),
            ("gbrp14le", "gray14le", U16, Some("green")),
            ("rgb48le", "gray16le", U16, Some("green")),
            ("bgr24", "gray", U8, Some("green")),
            ("pal8", "gray", U8, None),
        ] {
            assert_eq!(of(format), (delivered.to_string(), samples, taken), "{format}");
        }
        assert_eq!(said_in("[vist#0:0/rawvideo @ 0x5] [error] [dec:raw @ 0x7] Invalid data\n"), "Invalid data");
    }
}
