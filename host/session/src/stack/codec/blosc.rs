//! Blosc 1: blocks that are shuffled by bytes or by bits and compressed by one of several methods. After c-blosc's
//! README_CHUNK_FORMAT.

use super::{damaged, lz4, unshuffle, zlib, zstd};
use std::io::Result;

const HEADER: usize = 16;
const BYTE_SHUFFLED: u8 = 1;
const STORED: u8 = 1 << 1;
const BIT_SHUFFLED: u8 = 1 << 2;
const NOT_SPLIT: u8 = 1 << 4;
/// A block is split into the planes of its bytes where a number has at most this many bytes and the block at least so
/// many numbers.
const MOST_PLANES: usize = 16;
const LEAST_NUMBERS: usize = 128;

/// What a chunk of Blosc holds, at most so many bytes.
pub fn blosc(bytes: &[u8], most: usize) -> Result<Vec<u8>> {
    let [version, _, flags, size, ..] = *bytes else { return Err(damaged("it has no header")) };
    if !(1..=2).contains(&version) {
        return Err(damaged(format!("version {version} of Blosc is not read")));
    }
    let (length, block) = (word(bytes, 4)?, word(bytes, 8)?);
    if length > most {
        return Err(damaged(format!("it holds {length} bytes, more than {most}")));
    }
    if flags & STORED != 0 {
        let stored = bytes.get(HEADER..HEADER + length);
        return stored.map(<[u8]>::to_vec).ok_or_else(|| damaged("it ends early"));
    }
    if length > 0 && (block == 0 || block > length) {
        return Err(damaged(format!("blocks of {block} bytes")));
    }
    let mut out = Vec::new();
    for i in 0..length.div_ceil(block.max(1)) {
        let whole = block.min(length - i * block);
        let mut at = word(bytes, HEADER + 4 * i)?;
        let size = usize::from(size).max(1);
        let planes = flags & NOT_SPLIT == 0 && size <= MOST_PLANES && block / size >= LEAST_NUMBERS && whole == block;
        let parts = if planes { size } else { 1 };
        let part = whole / parts;
        let mut data = Vec::new();
        for _ in 0..parts {
            let length = word(bytes, at)?;
            let packed = (at + 4).checked_add(length).and_then(|end| bytes.get(at + 4..end));
            let packed = packed.ok_or_else(|| damaged("it ends early"))?;
            at += 4 + length;
            match length == part {
                true => data.extend_from_slice(packed),
                false => data.extend(unpacked(flags >> 5, packed, part)?),
            }
        }
        if data.len() != whole {
            return Err(damaged(format!("block {i} holds {} bytes, not {whole}", data.len())));
        }
        out.extend(match (flags & BYTE_SHUFFLED != 0, flags & BIT_SHUFFLED != 0) {
            (true, _) => unshuffle(&data, size),
            (_, true) => bit_unshuffle(&data, size),
            _ => data,
        });
    }
    Ok(out)
}

fn word(bytes: &[u8], at: usize) -> Result<usize> {
    let word = bytes.get(at..).and_then(|b| b.first_chunk::<4>()).ok_or_else(|| damaged("it ends early"))?;
    Ok(u32::from_le_bytes(*word) as usize)
}

fn unpacked(method: u8, packed: &[u8], most: usize) -> Result<Vec<u8>> {
    match method {
        1 => lz4(packed, most),
        3 => zlib(packed, most),
        4 => zstd(packed, most),
        0 => Err(damaged("Blosc's own method, blosclz, is not read: write the array again with lz4, zstd or zlib")),
        _ => {
            Err(damaged(format!("method {method} of Blosc is not read: write the array again with lz4, zstd or zlib")))
        }
    }
}

/// The bits of numbers that lie together by their place in the number, put back into numbers.
fn bit_unshuffle(bytes: &[u8], size: usize) -> Vec<u8> {
    let mut out = bytes.to_vec();
    let numbers = bytes.len() / size;
    // Blocks of another number of numbers are not shuffled.
    if !numbers.is_multiple_of(8) {
        return out;
    }
    let row = numbers / 8;
    out[..numbers * size].fill(0);
    for place in 0..size {
        for bit in 0..8 {
            let from = (place * 8 + bit) * row;
            for (i, eight) in bytes[from..from + row].iter().enumerate() {
                (0..8).for_each(|k| out[(8 * i + k) * size + place] |= (eight >> k & 1) << bit);
            }
        }
    }
    out
}
