//! Multi-page TIFF files: one grey page for each frame, all of the same size and sample type.

use super::layout::{SampleType, Shape, StackScale};
use super::ome;
use crate::error::SessionError;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;
use tiff::ColorType;
use tiff::TiffError;
use tiff::decoder::ifd::Value;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::Tag;

const KIND: &str = ".tif";

/// Largest page that is read, bytes. The header of a compressed page may state any size; no sensor needs more than
/// this, so a larger size counts as damage.
const MAX_PAGE_BYTES: usize = 1 << 30;

/// An open TIFF.
#[derive(Debug)]
pub(super) struct TifSource {
    decoder: Decoder<BufReader<File>>,
    pub(super) scale: StackScale,
}

impl TifSource {
    pub(super) fn open(path: &Path) -> Result<(Shape, Self), SessionError> {
        let file = File::open(path).map_err(|e| SessionError::io(path, e))?;
        let size = file.metadata().map_err(|e| SessionError::io(path, e))?.len();
        let mut decoder = Decoder::new(BufReader::new(file)).map_err(|e| SessionError::tif(path, e))?;
        let mut shape = page(path, &mut decoder, size)?;
        let description = description(path, &mut decoder)?;
        one_channel(path, &description)?;
        let per_unit = |tag: Tag, decoder: &mut Decoder<BufReader<File>>| {
            decoder.find_tag(tag).ok().flatten().and_then(|v| match v {
                Value::Rational(n, d) if d > 0 => Some(f64::from(n) / f64::from(d)),
                _ => None,
            })
        };
        let resolution = [Tag::YResolution, Tag::XResolution].map(|tag| per_unit(tag, &mut decoder));
        let scale = ome::scale(&description, resolution);
        while decoder.more_images() {
            decoder.next_image().map_err(|e| SessionError::tif(path, e))?;
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
        let bytes = shape.rows.saturating_mul(shape.cols).saturating_mul(shape.samples.bytes());
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
        Ok((shape, Self { decoder: decoder.with_limits(limits), scale }))
    }

    pub(super) fn read(&mut self, path: &Path, i: usize) -> Result<Vec<f32>, SessionError> {
        let image = self
            .decoder
            .seek_to_image(i)
            .and_then(|()| self.decoder.read_image())
            .map_err(|e| SessionError::tif(path, e))?;
        match image {
            DecodingResult::U8(v) => Ok(v.into_iter().map(f32::from).collect()),
            DecodingResult::U16(v) => Ok(v.into_iter().map(f32::from).collect()),
            DecodingResult::F32(v) => Ok(v),
            _ => Err(SessionError::format(path, KIND, format!("page {i} has another sample type than the first"))),
        }
    }
}

/// The description of the first page; empty without one.
fn description(path: &Path, decoder: &mut Decoder<BufReader<File>>) -> Result<String, SessionError> {
    let description = decoder.find_tag(Tag::ImageDescription).map_err(|e| SessionError::tif(path, e))?;
    Ok(description.and_then(|value| value.into_string().ok()).unwrap_or_default())
}

/// Checks that a description, OME-XML or that of ImageJ, does not announce several channels or planes: their pages
/// would
/// be taken for frames.
fn one_channel(path: &Path, text: &str) -> Result<(), SessionError> {
    let digits = |rest: &str| rest.chars().take_while(char::is_ascii_digit).collect::<String>().parse::<usize>().ok();
    let announced = |name: &str| text.find(name).and_then(|at| digits(&text[at + name.len()..]));
    let axes = [("channels", "SizeC=\"", "channels="), ("focal planes", "SizeZ=\"", "slices=")];
    // ImageJ calls a plain stack of frames slices.
    let plain_stack = announced("frames=").is_none() && announced("channels=").is_none();
    for (axis, ome, imagej) in axes {
        let of_imagej = announced(imagej).filter(|_| axis == "channels" || !plain_stack);
        if let Some(found) = announced(ome).or(of_imagej).filter(|n| *n > 1) {
            let remedy = "save one channel in one focal plane as a stack of its own";
            return Err(SessionError::value(path, axis, "1", found, remedy));
        }
    }
    Ok(())
}

/// Checks the current page: it must be grey, of a supported sample type, and its data must lie inside the file.
fn page(path: &Path, decoder: &mut Decoder<BufReader<File>>, size: u64) -> Result<Shape, SessionError> {
    let (cols, rows) = decoder.dimensions().map_err(|e| SessionError::tif(path, e))?;
    let color = decoder.colortype().map_err(|e| SessionError::tif(path, e))?;
    let format = decoder.find_tag_unsigned_vec::<u16>(Tag::SampleFormat).map_err(|e| SessionError::tif(path, e))?;
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
    let end = data_end(decoder).map_err(|e| SessionError::tif(path, e))?;
    if end > size {
        return Err(SessionError::Size { path: path.into(), expected: end, found: size });
    }
    Ok(Shape { len: 1, rows: rows as usize, cols: cols as usize, samples })
}

/// End of the data of the current page, bytes from the start of the file.
fn data_end(decoder: &mut Decoder<BufReader<File>>) -> Result<u64, TiffError> {
    let mut end = 0;
    for (offsets, counts) in [(Tag::StripOffsets, Tag::StripByteCounts), (Tag::TileOffsets, Tag::TileByteCounts)] {
        let offsets = decoder.find_tag_unsigned_vec::<u64>(offsets)?.unwrap_or_default();
        let counts = decoder.find_tag_unsigned_vec::<u64>(counts)?.unwrap_or_default();
        let ends = offsets.iter().zip(&counts).map(|(o, c)| o.saturating_add(*c));
        end = ends.fold(end, u64::max);
    }
    Ok(end)
}
