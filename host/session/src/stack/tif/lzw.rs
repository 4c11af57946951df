//! Pages with LZW that the decoder of the `tiff` package refuses: it reads a tile that reaches over the edge of the
//! page in pieces, and finds no end where a code stands for bytes of two of them. After section 13 of the specification
//! TIFF 6.0.

use super::Tiff;
use crate::stack::layout::Shape;
use crate::stack::number::Number;
use std::io::{Read, Seek, SeekFrom};
use tiff::TiffError;
use tiff::decoder::ChunkType;
use tiff::tags::{ByteOrder, Tag};

const CLEAR: usize = 256;
const END: usize = 257;
/// Codes have 9 to 12 bits.
const MOST_CODES: usize = 1 << 12;

/// The numbers of the current page; `None` where it is stored in a way that is not read here.
pub(super) fn page(decoder: &mut Tiff, shape: &Shape, number: Number) -> Result<Option<Vec<f32>>, TiffError> {
    let predictor = decoder.find_tag_unsigned::<u16>(Tag::Predictor)?.unwrap_or(1);
    // Differences of floats are stored in another way.
    if predictor > 2 || (predictor == 2 && number == Number::F32) {
        return Ok(None);
    }
    let tags = match decoder.get_chunk_type() {
        ChunkType::Strip => [Tag::StripOffsets, Tag::StripByteCounts],
        ChunkType::Tile => [Tag::TileOffsets, Tag::TileByteCounts],
    };
    let offsets = decoder.find_tag_unsigned_vec::<u64>(tags[0])?.unwrap_or_default();
    let lengths = decoder.find_tag_unsigned_vec::<u64>(tags[1])?.unwrap_or_default();
    let (wide, high) = decoder.chunk_dimensions();
    let (wide, high, size) = (wide as usize, high as usize, number.bytes());
    let whole = wide.checked_mul(high).and_then(|n| n.checked_mul(size)).filter(|n| *n <= super::MAX_PAGE_BYTES);
    let (Some(whole), false) = (whole, wide == 0 || high == 0) else { return Ok(None) };
    let across = shape.cols.div_ceil(wide);
    let pieces = across * shape.rows.div_ceil(high);
    if offsets.len() != pieces || lengths.len() != pieces {
        return Ok(None);
    }
    let big_endian = matches!(decoder.byte_order(), ByteOrder::BigEndian);
    let mut values = vec![0.0; shape.rows * shape.cols];
    for (i, (start, length)) in offsets.iter().zip(lengths).enumerate() {
        let (top, left) = (i / across * high, i % across * wide);
        let (rows, cols) = (high.min(shape.rows - top), wide.min(shape.cols - left));
        let mut coded = Vec::new();
        decoder.inner().seek(SeekFrom::Start(*start))?;
        decoder.inner().by_ref().take(length).read_to_end(&mut coded)?;
        // The last strip ends with the page, a tile does not.
        let bytes = decode(&coded, whole);
        if bytes.len() < wide * rows * size {
            return Ok(None);
        }
        let mut numbers = number.decode(&bytes, big_endian);
        if predictor == 2 {
            // What overflows begins again at zero.
            let codes = if number == Number::U8 { 256.0 } else { 65536.0 };
            for row in numbers.chunks_exact_mut(wide) {
                (1..wide).for_each(|c| row[c] = (row[c] + row[c - 1]) % codes);
            }
        }
        for r in 0..rows {
            let to = (top + r) * shape.cols + left;
            values[to..to + cols].copy_from_slice(&numbers[r * wide..r * wide + cols]);
        }
    }
    Ok(Some(values))
}

/// What some codes stand for, up to `most` bytes; shorter where they are damaged.
fn decode(coded: &[u8], most: usize) -> Vec<u8> {
    let mut out: Vec<u8> = Vec::with_capacity(most.min(coded.len().saturating_mul(4)));
    // Where each code of several bytes stands in what is decoded, from code 258 on.
    let mut known: Vec<(usize, usize)> = Vec::new();
    let mut before: Option<(usize, usize)> = None;
    let (mut bits, mut count, mut width) = (0u32, 0, 9);
    let mut bytes = coded.iter();
    while out.len() < most {
        while count < width {
            let Some(byte) = bytes.next() else { return out };
            (bits, count) = (bits << 8 | u32::from(*byte), count + 8);
        }
        count -= width;
        let code = (bits >> count) as usize & ((1 << width) - 1);
        bits &= (1 << count) - 1;
        if code == END {
            return out;
        }
        if code == CLEAR {
            known.clear();
            (before, width) = (None, 9);
            continue;
        }
        let start = out.len();
        // A code stands for what the one before it does, and the first byte of what the next one does.
        if let Some((at, length)) = before
            && known.len() + 258 < MOST_CODES
        {
            known.push((at, length + 1));
        }
        if code < CLEAR {
            out.push(code as u8);
        } else {
            let Some((at, length)) = known.get(code - 258).copied() else { return out };
            // It may be the one that is not complete yet.
            (at..at + length).for_each(|i| out.push(out[i]));
        }
        before = Some((start, out.len() - start));
        // The width grows one code early.
        width = match known.len() + 259 {
            2048.. => 12,
            1024.. => 11,
            512.. => 10,
            _ => 9,
        };
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Codes of 9 bits, one behind the other.
    fn packed(codes: &[u32]) -> Vec<u8> {
        let bits: Vec<u8> = codes.iter().flat_map(|code| (0..9).rev().map(move |b| (code >> b & 1) as u8)).collect();
        bits.chunks(8).map(|byte| byte.iter().enumerate().fold(0, |n, (i, bit)| n | bit << (7 - i))).collect()
    }

    #[test]
    fn the_example_of_the_specification_is_decoded_and_damage_ends_it() {
        let codes = [256, 7, 258, 8, 8, 258, 6, 257];
        assert_eq!(decode(&packed(&codes), 100), [7, 7, 7, 8, 8, 7, 7, 6]);
        assert_eq!(decode(&packed(&codes), 3), [7, 7, 7]);
        // A code that does not stand for anything yet, no end, and nothing at all.
        assert_eq!(decode(&packed(&[256, 7, 300]), 100), [7]);
        assert_eq!(decode(&packed(&[256, 7]), 100), [7]);
        assert_eq!(decode(&[], 100), [0u8; 0]);
        assert_eq!(decode(&packed(&[258; 40]), 100), [0u8; 0]);
    }
}
