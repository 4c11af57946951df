//! AVI files: one video of grey frames. Uncompressed frames are read here, all others by ffmpeg.

mod decoder;
mod faults;
mod pixels;
mod riff;
#[cfg(test)]
mod tests;

use super::layout::SampleType;
use crate::error::SessionError;
use decoder::{Coding, Decoder};
pub(crate) use faults::DECODED_FROM;
use faults::Faults;
use pixels::{Pixels, Wrong};
use riff::Chunk;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

const KIND: &str = ".avi";

/// Most bytes of an uncompressed frame; a larger size counts as damage.
const MOST_BYTES: usize = 1 << 30;

/// What is in an AVI.
#[derive(Debug)]
pub(super) struct Movie {
    pub rows: usize,
    pub cols: usize,
    pub samples: SampleType,
    /// Time from one frame to the next that the header states, s.
    pub interval_s: Option<f64>,
    /// Number of frames that the file lists, whole or not.
    pub slots: usize,
    /// Numbers of frames without data: by the format, the frame before counts again.
    pub empty: Vec<usize>,
    /// Numbers of frames that end too early or have a damaged head.
    pub torn: Vec<usize>,
    /// What is wrong with the end of the file, if anything is.
    pub damage: Option<String>,
    /// Whether codes are of limited range: black is 16 and white 235.
    pub limited: bool,
    pixels: Pixels,
    /// How a compressed file is coded.
    coding: Option<Coding>,
    /// The place of each whole frame among those that the file lists, and where it lies.
    chunks: Vec<(usize, Chunk)>,
}

impl Movie {
    /// Reads the headers of a file and of all its frames, without the frames themselves.
    ///
    /// # Errors
    /// The file cannot be read, is no AVI, has no video, or shows frames of several colours.
    pub fn open(path: &Path) -> Result<Self, SessionError> {
        let file = File::open(path).map_err(|e| SessionError::io(path, e))?;
        let found = riff::walk(file).map_err(|e| riff_error(path, e))?;
        let format = |detail: &str| SessionError::format(path, KIND, detail);
        let header = found.video.ok_or_else(|| format("it has no video stream"))?;
        let pixels = Pixels::of(&header).map_err(|detail| format(&detail))?;
        let coding = match pixels {
            Pixels::Compressed(code) => Some(Coding::of(path, code)?),
            _ => None,
        };
        // What ffmpeg delivers has the size of the coding, whatever the header states.
        let [rows, cols] = coding.as_ref().and_then(|c| c.size).unwrap_or([header.rows, header.cols]);
        let samples = coding.as_ref().map_or_else(|| pixels.samples(), Coding::samples);
        let limited = coding.as_ref().is_some_and(|c| c.limited);
        let size = rows.checked_mul(cols).and_then(|n| n.checked_mul(4)).filter(|n| *n <= MOST_BYTES);
        if rows == 0 || cols == 0 || size.is_none() {
            return Err(format(&format!("its header states frames of {rows} x {cols} pixels")));
        }
        let slots = found.chunks.len();
        let (mut chunks, mut empty, mut torn) = (Vec::new(), Vec::new(), Vec::new());
        for (slot, chunk) in found.chunks.into_iter().enumerate() {
            if chunk.bytes == 0 {
                empty.push(slot);
            } else if chunk.whole && pixels.stride(rows, cols, chunk.bytes).is_some() {
                chunks.push((slot, chunk));
            } else {
                torn.push(slot);
            }
        }
        let (interval_s, damage) = (header.interval_s, found.damage);
        Ok(Self { rows, cols, samples, interval_s, slots, empty, torn, damage, limited, pixels, coding, chunks })
    }

    /// What is taken of a video that is coded with colours.
    pub fn taken_of_colours(&self) -> Option<&'static str> {
        self.coding.as_ref().and_then(Coding::taken_of_colours)
    }

    /// Number of whole frames.
    pub fn frames(&self) -> usize {
        self.chunks.len()
    }
}

/// A frame, row by row, and what is wrong with it.
pub(super) struct Decoded {
    pub values: Vec<f32>,
    pub damage: Option<String>,
}

/// Reads frames of a movie: any order for uncompressed frames, best forwards for others.
#[derive(Debug)]
pub(super) struct MovieReader {
    file: File,
    decoder: Option<Decoder>,
    /// What is damaged in a compressed file, once ffmpeg has said any error.
    faults: Option<Faults>,
    buffer: Vec<u8>,
}

impl MovieReader {
    pub fn open(path: &Path) -> Result<Self, SessionError> {
        let file = File::open(path).map_err(|e| SessionError::io(path, e))?;
        Ok(Self { file, decoder: None, faults: None, buffer: Vec::new() })
    }

    /// Whole frame number `index`, row by row. Damage is seen in compressed frames only.
    pub fn read(&mut self, path: &Path, movie: &Movie, index: usize) -> Result<Decoded, SessionError> {
        if let Some(coding) = &movie.coding {
            // ffmpeg delivers neither frames without data nor torn ones.
            let decoder = match self.decoder.take().filter(|d| d.next <= index) {
                Some(decoder) => decoder,
                None => Decoder::start(path, movie, coding)?,
            };
            return self.decoder.insert(decoder).frame(path, movie, coding, &mut self.faults, index);
        }
        let (_, chunk) = movie.chunks[index];
        self.buffer.resize(chunk.bytes as usize, 0);
        let start = SeekFrom::Start(chunk.start);
        let read = self.file.seek(start).and_then(|_| self.file.read_exact(&mut self.buffer));
        read.map_err(|e| SessionError::io(path, e))?;
        let values = movie.pixels.decode(&self.buffer, movie.rows, movie.cols);
        let values = values.map_err(|wrong| match wrong {
            Wrong::Damaged(detail) => SessionError::format(path, KIND, format!("frame {index}: {detail}")),
            Wrong::Colours => {
                let remedy = "take one channel: ffmpeg -i IN.avi -pix_fmt gray -c:v rawvideo OUT.avi";
                SessionError::value(path, format!("frame {index}"), "levels of grey", "colours", remedy)
            }
        })?;
        Ok(Decoded { values, damage: None })
    }
}

fn riff_error(path: &Path, error: std::io::Error) -> SessionError {
    match error.kind() {
        std::io::ErrorKind::InvalidData | std::io::ErrorKind::UnexpectedEof => SessionError::format(path, KIND, error),
        _ => SessionError::io(path, error),
    }
}
