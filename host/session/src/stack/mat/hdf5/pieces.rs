//! Chunks of an array: where each lies, and what was done to it.

use super::bytes::{Fields, Source, damaged, unsupported};
use super::dataset::Filter;
use super::objects::tree_node;
use crate::stack::codec;
use std::collections::HashMap;
use std::io::Result;

const DEFLATE: u64 = 1;
const SHUFFLE: u64 = 2;
const FLETCHER32: u64 = 3;

/// A chunk in the file.
#[derive(Clone, Copy, Debug)]
pub(super) struct Piece {
    address: u64,
    bytes: u64,
    /// The filters that were left out, a bit each.
    left_out: u64,
}

/// All chunks of an array of the given size by their place in the grid. `tree` is the address of their tree.
pub(super) fn pieces(
    source: &mut Source,
    tree: u64,
    size: &[u64],
    chunk: &[u64],
) -> Result<HashMap<Vec<usize>, Piece>> {
    let mut pieces = HashMap::new();
    // No chunk has been written.
    if tree == u64::MAX {
        return Ok(pieces);
    }
    // A key: bytes, filters that were left out, and the first number along each axis, with one for the number's bytes.
    let key = 8 + 8 * (size.len() + 1);
    let most = size.iter().zip(chunk).fold(1, |n: u64, (size, chunk)| n.saturating_mul(size.div_ceil(*chunk)));
    let most = most.min(source.size / key as u64);
    let mut nodes = vec![(tree, None)];
    let mut visited = 0;
    while let Some((address, level)) = nodes.pop() {
        visited += 1;
        let (level, entries) = tree_node(source, address, 1, key, level)?;
        for entry in entries.chunks_exact(key + 8) {
            let mut fields = Fields(entry);
            let (bytes, left_out) = (fields.number(4)?, fields.number(4)?);
            let place = size.iter().zip(chunk).map(|_| fields.number(8)).collect::<Result<Vec<u64>>>()?;
            fields.take(8)?;
            let address = fields.number(8)?;
            if level > 0 {
                nodes.push((address, Some(level - 1)));
                continue;
            }
            let place = place.iter().zip(chunk).map(|(at, chunk)| (at / chunk) as usize).collect();
            pieces.insert(place, Piece { address, bytes, left_out });
        }
        if visited > 2 * most + 64 || nodes.len() as u64 > 2 * most + 64 || pieces.len() as u64 > most {
            return Err(damaged(format!("more than the {most} chunks that the array can have")));
        }
    }
    Ok(pieces)
}

impl Piece {
    /// The numbers of the chunk, `most` bytes.
    pub fn read(&self, source: &mut Source, filters: &[Filter], most: usize) -> Result<Vec<u8>> {
        // What does not shrink grows by less than this.
        let limit = most + most / 8 + 1024;
        if self.bytes > limit as u64 {
            return Err(damaged(format!("a chunk of {} bytes that holds {most}", self.bytes)));
        }
        let mut bytes = source.read(self.address, self.bytes)?;
        for (i, filter) in filters.iter().enumerate().rev() {
            if self.left_out >> i & 1 == 1 {
                continue;
            }
            bytes = match filter.id {
                DEFLATE => codec::zlib(&bytes, limit)?,
                SHUFFLE => codec::unshuffle(&bytes, filter.values.first().map_or(1, |size| *size as usize)),
                FLETCHER32 => checked(bytes)?,
                id => return Err(unsupported(format!("filter {id}{}", name_of(id)))),
            };
        }
        Ok(bytes)
    }
}

/// What people call a filter that is not read.
fn name_of(filter: u64) -> &'static str {
    match filter {
        4 => " (szip)",
        5 => " (nbit)",
        6 => " (scale and offset)",
        32000 => " (LZF)",
        32001 | 32026 => " (Blosc)",
        32004 => " (LZ4)",
        32008 => " (bitshuffle)",
        32015 => " (Zstandard)",
        _ => "",
    }
}

/// Takes a checksum off the end.
fn checked(mut bytes: Vec<u8>) -> Result<Vec<u8>> {
    let at = bytes.len().checked_sub(4).ok_or_else(|| damaged("a chunk ends before its checksum"))?;
    let stated = Fields(&bytes[at..]).number(4)? as u32;
    bytes.truncate(at);
    if fletcher32(&bytes) != stated {
        return Err(damaged("the checksum of a chunk is wrong"));
    }
    Ok(bytes)
}

/// Fletcher's checksum over big-endian words of 16 bits, as HDF5 has it.
fn fletcher32(bytes: &[u8]) -> u32 {
    let folded = |sum: u32| (sum & 0xffff) + (sum >> 16);
    let (mut first, mut second) = (0u32, 0u32);
    let (words, odd) = bytes.as_chunks::<2>();
    for block in words.chunks(360) {
        for word in block {
            first += u32::from(u16::from_be_bytes(*word));
            second += first;
        }
        (first, second) = (folded(first), folded(second));
    }
    if let [last] = odd {
        first += u32::from(*last) << 8;
        second += first;
        (first, second) = (folded(first), folded(second));
    }
    folded(second) << 16 | folded(first)
}
