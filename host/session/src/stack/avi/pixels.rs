//! How the pixels of an AVI are stored.

use super::super::layout::SampleType;
use super::riff::Video;

/// Codes of 8-bit grey frames without compression.
const GREY: [&[u8; 4]; 4] = [b"GREY", b"Y800", b"Y8  ", b"Y08 "];
/// Codes of 16-bit grey frames without compression, little-endian: ours by FOURCC, and that of ffmpeg.
const GREY_16: [&[u8; 4]; 2] = [b"Y16 ", &[b'Y', b'1', 0, 16]];

/// How pixels are stored.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Pixels {
    /// One sample a pixel.
    Grey {
        samples: SampleType,
        upwards: bool,
        /// Grey level of each code, for a palette that is not the identity.
        levels: Option<Vec<u8>>,
    },
    /// Blue, green and red bytes, which must be equal.
    Colours { bytes: usize, upwards: bool },
    /// Compressed, with this code: ffmpeg reads it.
    Compressed([u8; 4]),
}

/// Why the pixels of a frame cannot be read.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Wrong {
    /// What is damaged.
    Damaged(&'static str),
    /// Blue, green and red differ.
    Colours,
}

impl Pixels {
    pub fn of(video: &Video) -> Result<Self, String> {
        let upwards = video.upwards;
        let grey = |samples, levels| Ok(Self::Grey { samples, upwards, levels });
        if GREY.contains(&&video.code) {
            return grey(SampleType::U8, None);
        }
        if GREY_16.contains(&&video.code) {
            return grey(SampleType::U16, None);
        }
        match (video.code, video.bits) {
            ([0, 0, 0, 0] | [b'D', b'I', b'B', b' '], 8) => {
                let palette = video.palette.clone().transpose()?;
                let identity = |p: &Vec<u8>| p.iter().enumerate().all(|(i, v)| i == usize::from(*v));
                grey(SampleType::U8, palette.filter(|p| !identity(p)))
            }
            ([0, 0, 0, 0] | [b'D', b'I', b'B', b' '], bits @ (24 | 32)) => {
                Ok(Self::Colours { bytes: usize::from(bits / 8), upwards })
            }
            ([0, 0, 0, 0], bits) => Err(format!(
                "uncompressed frames of {bits} bits a pixel, without a code of their format, are not supported; record \
                 as FFV1, or as grey with the code Y16 or Y800"
            )),
            (code, _) => Ok(Self::Compressed(code)),
        }
    }

    pub fn samples(&self) -> SampleType {
        match self {
            Self::Grey { samples, .. } => *samples,
            Self::Colours { .. } | Self::Compressed(_) => SampleType::U8,
        }
    }

    /// Bytes from one row to the next in a frame of `bytes` bytes; `None` where the frame is too short. Some programs
    /// fill rows up to a multiple of four bytes.
    pub fn stride(&self, rows: usize, cols: usize, bytes: u32) -> Option<usize> {
        let row = match self {
            Self::Grey { samples, .. } => cols * samples.bytes(),
            Self::Colours { bytes, .. } => cols * bytes,
            Self::Compressed(_) => return Some(0),
        };
        let fits = |stride: usize| rows * stride <= bytes as usize;
        [row.next_multiple_of(4), row].into_iter().find(|stride| fits(*stride))
    }

    /// The pixels of a frame, row by row.
    pub fn decode(&self, data: &[u8], rows: usize, cols: usize) -> Result<Vec<f32>, Wrong> {
        let stride = self.stride(rows, cols, data.len() as u32).ok_or(Wrong::Damaged("it is too short"))?;
        let mut values = Vec::with_capacity(rows * cols);
        for r in 0..rows {
            match self {
                Self::Grey { samples, upwards, levels } => {
                    let row = &data[if *upwards { rows - 1 - r } else { r } * stride..];
                    match (samples, levels) {
                        (SampleType::U16, _) => values.extend(
                            row[..2 * cols].chunks_exact(2).map(|b| f32::from(u16::from_le_bytes([b[0], b[1]]))),
                        ),
                        (_, None) => values.extend(row[..cols].iter().map(|b| f32::from(*b))),
                        (_, Some(levels)) => values.extend(
                            row[..cols].iter().map(|b| f32::from(levels.get(usize::from(*b)).copied().unwrap_or(0))),
                        ),
                    }
                }
                Self::Colours { bytes, upwards } => {
                    let row = &data[if *upwards { rows - 1 - r } else { r } * stride..];
                    for pixel in row[..bytes * cols].chunks_exact(*bytes) {
                        if pixel[0] != pixel[1] || pixel[1] != pixel[2] {
                            return Err(Wrong::Colours);
                        }
                        values.push(f32::from(pixel[0]));
                    }
                }
                Self::Compressed(_) => return Err(Wrong::Damaged("it is compressed")),
            }
        }
        Ok(values)
    }
}
