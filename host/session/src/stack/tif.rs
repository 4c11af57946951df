//! Multi-page TIFF files: one grey page for each frame, all of the same size and sample type.

mod lzw;

use super::announced;
use super::layout::{SampleType, Shape, StackScale};
use super::number::Number;
use super::ome;
use crate::error::SessionError;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;
use tiff::decoder::ifd::Value;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::{ByteOrder, Tag};
use tiff::{ColorType, TiffError};

const KIND: &str = ".tif";

/// Largest page that is read, bytes in memory, where its pixels are float32. The header of a compressed page may state
/// any size; no sensor needs more than this, so a larger size counts as damage.
const MAX_PAGE_BYTES: usize = 1 << 30;

/// Most bytes of a description that are read.
const MOST_DESCRIPTION: u64 = 1 << 26;

/// The TIFF numbers of the compressions that are read: none, LZW, Deflate twice, JPEG, and PackBits.
const COMPRESSIONS: [u16; 6] = [1, 5, 8, 32946, 7, 32773];

const LZW: u16 = 5;

const EXPECTED: &str = "pages of grey, without compression or with LZW, Deflate, PackBits or JPEG";
const REMEDY: &str = "save the frames as grey without compression, e.g. in ImageJ or with tifffile";

type Tiff = Decoder<BufReader<File>>;

/// An open TIFF.
#[derive(Debug)]
pub(super) struct TifSource {
    decoder: Tiff,
    pub(super) scale: StackScale,
    /// Where all frames lie one behind the other and only the first is listed.
    behind: Option<Behind>,
    shape: Shape,
}

/// Frames in one piece.
#[derive(Clone, Copy, Debug)]
struct Behind {
    start: u64,
    frame_bytes: usize,
    number: Number,
    big_endian: bool,
}

impl TifSource {
    pub(super) fn open(path: &Path) -> Result<(Shape, Self), SessionError> {
        let file = File::open(path).map_err(|e| SessionError::io(path, e))?;
        let size = file.metadata().map_err(|e| SessionError::io(path, e))?.len();
        let mut decoder = Decoder::new(BufReader::new(file)).map_err(|e| error(path, e))?;
        let mut shape = page(path, &mut decoder, size)?;
        let description = description(&mut decoder, size).map_err(|e| error(path, e))?;
        let announced = announced::frames(path, &description, [shape.rows, shape.cols])?;
        let piece = piece(&mut decoder, &shape).map_err(|e| error(path, e))?;
        let per_unit = |tag: Tag, decoder: &mut Tiff| {
            decoder.find_tag(tag).ok().flatten().and_then(|v| match v {
                Value::Rational(n, d) if d > 0 => Some(f64::from(n) / f64::from(d)),
                _ => None,
            })
        };
        let resolution = [Tag::YResolution, Tag::XResolution].map(|tag| per_unit(tag, &mut decoder));
        let scale = ome::scale(&description, resolution);
        while decoder.more_images() {
            decoder.next_image().map_err(|e| error(path, e))?;
            let next = page(path, &mut decoder, size)?;
            if (next.rows, next.cols, next.samples) != (shape.rows, shape.cols, shape.samples) {
                return Err(SessionError::Shape {
                    path: path.into(),
                    expected: format!("every page of {} x {} {}", shape.rows, shape.cols, shape.samples.name()),
                    found: format!("page {} of {} x {} {}", shape.len, next.rows, next.cols, next.samples.name()),
                    remedy: "write all frames with the same size and sample type",
                });
            }
            shape.len += 1;
        }
        let mut behind = None;
        if let Some(announced) = announced.filter(|n| *n > shape.len) {
            behind = piece.filter(|piece| shape.len == 1 && piece.holds(announced, size));
            if behind.is_none() {
                let remedy = "frames are lost: copy the file again from where it was written, or, if it has no more, \
                              save it again, so that its description is right";
                let (expected, found) = (format!("{announced}, as its description says"), shape.len);
                return Err(SessionError::value(path, "frames", expected, found, remedy));
            }
            shape.len = announced;
        }
        let bytes = shape.rows.saturating_mul(shape.cols).saturating_mul(SampleType::F32.bytes());
        if bytes > MAX_PAGE_BYTES {
            return Err(SessionError::format(
                path,
                KIND,
                format!("a page of {} x {} pixels is too large", shape.rows, shape.cols),
            ));
        }
        let mut limits = Limits::default();
        limits.decoding_buffer_size = bytes;
        limits.intermediate_buffer_size = limits.intermediate_buffer_size.max(bytes);
        Ok((shape, Self { decoder: decoder.with_limits(limits), scale, behind, shape }))
    }

    pub(super) fn read(&mut self, path: &Path, i: usize) -> Result<Vec<f32>, SessionError> {
        if let Some(behind) = &self.behind {
            return behind.read(self.decoder.inner(), i).map_err(|e| SessionError::io(path, e));
        }
        self.decoder.seek_to_image(i).map_err(|e| error(path, e))?;
        let image = match self.decoder.read_image() {
            Ok(image) => image,
            Err(e) => {
                let again = compression(&mut self.decoder).ok().filter(|code| *code == LZW);
                let values = again
                    .and_then(|_| lzw::page(&mut self.decoder, &self.shape, number(self.shape.samples)).ok().flatten());
                return values.ok_or_else(|| error(path, e));
            }
        };
        // The numbers are those of the file: what zero looks like does not change them, and the decoder does.
        let inverted = white_is_zero(&mut self.decoder).map_err(|e| error(path, e))?;
        match image {
            DecodingResult::U8(v) if inverted => Ok(v.into_iter().map(|n| f32::from(!n)).collect()),
            DecodingResult::U16(v) if inverted => Ok(v.into_iter().map(|n| f32::from(!n)).collect()),
            DecodingResult::U8(v) => Ok(v.into_iter().map(f32::from).collect()),
            DecodingResult::U16(v) => Ok(v.into_iter().map(f32::from).collect()),
            DecodingResult::F32(v) => Ok(v),
            _ => Err(SessionError::format(path, KIND, format!("page {i} has another sample type than the first"))),
        }
    }
}

impl Behind {
    /// Whether a file of `size` bytes holds so many frames.
    fn holds(&self, frames: usize, size: u64) -> bool {
        let bytes = (self.frame_bytes as u64).checked_mul(frames as u64);
        bytes.and_then(|n| n.checked_add(self.start)).is_some_and(|end| end <= size)
    }

    fn read(&self, file: &mut BufReader<File>, i: usize) -> std::io::Result<Vec<f32>> {
        file.seek(SeekFrom::Start(self.start + i as u64 * self.frame_bytes as u64))?;
        let mut bytes = vec![0; self.frame_bytes];
        file.read_exact(&mut bytes)?;
        Ok(self.number.decode(&bytes, self.big_endian))
    }
}

fn number(samples: SampleType) -> Number {
    match samples {
        SampleType::U8 => Number::U8,
        SampleType::U16 => Number::U16,
        SampleType::F32 => Number::F32,
    }
}

/// A TIFF could not be read: it is damaged, or it has pages of a kind that is not read.
fn error(path: &Path, error: TiffError) -> SessionError {
    match error {
        TiffError::UnsupportedError(what) => SessionError::value(path, "pages", EXPECTED, what, REMEDY),
        other => SessionError::tif(path, other),
    }
}

/// The description of the first page; empty without one. Bytes that are no UTF-8 are taken for Latin-1, in which some
/// programs write the sign for micro.
fn description(decoder: &mut Tiff, size: u64) -> Result<String, TiffError> {
    let mut tags = decoder.image_ifd();
    let Some(entry) = tags.find_entry(Tag::ImageDescription) else { return Ok(String::new()) };
    // Of other types a number may have several bytes; a description has one a letter.
    let mut bytes = vec![0; entry.count().min(size).min(MOST_DESCRIPTION) as usize];
    let read = tags.find_tag_bytes(Tag::ImageDescription, &mut bytes, 0)?.unwrap_or(0);
    bytes.truncate(read);
    if let Some(end) = bytes.iter().position(|b| *b == 0) {
        bytes.truncate(end);
    }
    Ok(String::from_utf8(bytes).unwrap_or_else(|e| e.as_bytes().iter().map(|b| char::from(*b)).collect()))
}

fn white_is_zero(decoder: &mut Tiff) -> Result<bool, TiffError> {
    Ok(decoder.find_tag_unsigned::<u16>(Tag::PhotometricInterpretation)? == Some(0))
}

fn compression(decoder: &mut Tiff) -> Result<u16, TiffError> {
    Ok(decoder.find_tag_unsigned::<u16>(Tag::Compression)?.unwrap_or(1))
}

/// The first page as the first of frames in one piece; `None` where it is compressed, or does not lie in one piece.
fn piece(decoder: &mut Tiff, shape: &Shape) -> Result<Option<Behind>, TiffError> {
    let offsets = decoder.find_tag_unsigned_vec::<u64>(Tag::StripOffsets)?.unwrap_or_default();
    let counts = decoder.find_tag_unsigned_vec::<u64>(Tag::StripByteCounts)?.unwrap_or_default();
    let frame_bytes = shape.rows.saturating_mul(shape.cols).saturating_mul(shape.samples.bytes());
    let strips = || offsets.iter().copied().zip(counts.iter().copied());
    let in_a_row = strips().zip(strips().skip(1)).all(|((at, n), (next, _))| at.checked_add(n) == Some(next));
    let total = strips().try_fold(0u64, |sum, (_, n)| sum.checked_add(n));
    // ImageJ may state the bytes of all frames as those of the first.
    let whole = total == Some(frame_bytes as u64) || (counts.len() == 1 && total >= Some(frame_bytes as u64));
    let tiled = decoder.find_tag(Tag::TileOffsets)?.is_some();
    let (Some(start), false) = (offsets.first(), tiled) else { return Ok(None) };
    if !in_a_row || !whole || offsets.len() != counts.len() || compression(decoder)? != 1 {
        return Ok(None);
    }
    let number = number(shape.samples);
    let big_endian = matches!(decoder.byte_order(), ByteOrder::BigEndian);
    Ok(Some(Behind { start: *start, frame_bytes, number, big_endian }))
}

/// Checks the current page: it must be grey, of a supported sample type, and its data must lie inside the file.
fn page(path: &Path, decoder: &mut Tiff, size: u64) -> Result<Shape, SessionError> {
    let (cols, rows) = decoder.dimensions().map_err(|e| error(path, e))?;
    let color = decoder.colortype().map_err(|e| error(path, e))?;
    let format = decoder.find_tag_unsigned_vec::<u16>(Tag::SampleFormat).map_err(|e| error(path, e))?;
    let format = format.and_then(|f| f.first().copied()).unwrap_or(1);
    let samples = match (color, format) {
        (ColorType::Gray(8), 1) => SampleType::U8,
        (ColorType::Gray(16), 1) => SampleType::U16,
        (ColorType::Gray(32), 3) => SampleType::F32,
        _ => {
            let found = format!("{color:?}, sample format {format}");
            return Err(SessionError::SampleType {
                path: path.into(),
                expected: "grey uint8, uint16 or float32",
                found,
            });
        }
    };
    let compression = compression(decoder).map_err(|e| error(path, e))?;
    if !COMPRESSIONS.contains(&compression) {
        let found = format!("compression {compression}{}", name_of(compression));
        return Err(SessionError::value(path, "pages", EXPECTED, found, REMEDY));
    }
    if samples == SampleType::F32 && white_is_zero(decoder).map_err(|e| error(path, e))? {
        let expected = "zero as black (PhotometricInterpretation 1)";
        return Err(SessionError::value(path, "pages", expected, "float32 with zero as white", REMEDY));
    }
    let end = data_end(decoder).map_err(|e| error(path, e))?;
    if end > size {
        return Err(SessionError::Size { path: path.into(), expected: end, found: size });
    }
    Ok(Shape { len: 1, rows: rows as usize, cols: cols as usize, samples })
}

/// What people call a compression that is not read.
fn name_of(compression: u16) -> &'static str {
    match compression {
        2..=4 => " (fax)",
        6 => " (old JPEG)",
        33003 | 33005 | 34712 => " (JPEG 2000)",
        34887 => " (LERC)",
        34925 => " (LZMA)",
        34933 => " (PNG)",
        50000 | 34926 => " (Zstandard)",
        50001 | 34927 => " (WebP)",
        50002 => " (JPEG XL)",
        _ => "",
    }
}

/// End of the data of the current page, bytes from the start of the file.
fn data_end(decoder: &mut Tiff) -> Result<u64, TiffError> {
    let mut end = 0;
    for (offsets, counts) in [(Tag::StripOffsets, Tag::StripByteCounts), (Tag::TileOffsets, Tag::TileByteCounts)] {
        let offsets = decoder.find_tag_unsigned_vec::<u64>(offsets)?.unwrap_or_default();
        let counts = decoder.find_tag_unsigned_vec::<u64>(counts)?.unwrap_or_default();
        let ends = offsets.iter().zip(&counts).map(|(o, c)| o.saturating_add(*c));
        end = ends.fold(end, u64::max);
    }
    Ok(end)
}

#[cfg(test)]
mod tests;
