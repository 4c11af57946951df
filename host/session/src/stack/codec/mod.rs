//! Compressions of chunks. Each states how many bytes it may yield, so that no file takes more memory than it should.

mod blosc;

pub(super) use blosc::blosc;

use flate2::read::{MultiGzDecoder, ZlibDecoder};
use std::io::{Error, ErrorKind, Read, Result};

pub(super) fn zlib(bytes: &[u8], most: usize) -> Result<Vec<u8>> {
    limited(ZlibDecoder::new(bytes), most)
}

pub(super) fn gzip(bytes: &[u8], most: usize) -> Result<Vec<u8>> {
    limited(MultiGzDecoder::new(bytes), most)
}

pub(super) fn zstd(bytes: &[u8], most: usize) -> Result<Vec<u8>> {
    let decoder = ruzstd::decoding::StreamingDecoder::new(bytes).map_err(|e| damaged(e.to_string()))?;
    limited(decoder, most)
}

/// One block of LZ4 without a frame.
pub(super) fn lz4(bytes: &[u8], most: usize) -> Result<Vec<u8>> {
    // A block makes at most 255 bytes of one.
    let mut out = vec![0; most.min(bytes.len().saturating_mul(255))];
    let length = lz4_flex::block::decompress_into(bytes, &mut out).map_err(|e| damaged(e.to_string()))?;
    out.truncate(length);
    Ok(out)
}

/// The bytes of numbers that lie together by their place in the number, put back into numbers.
pub(super) fn unshuffle(bytes: &[u8], size: usize) -> Vec<u8> {
    let numbers = bytes.len() / size.max(1);
    let mut out = bytes.to_vec();
    for (place, plane) in bytes.chunks_exact(numbers.max(1)).take(size).enumerate() {
        plane.iter().enumerate().for_each(|(i, byte)| out[i * size + place] = *byte);
    }
    out
}

pub(super) fn damaged(detail: impl Into<String>) -> Error {
    Error::new(ErrorKind::InvalidData, detail.into())
}

fn limited(reader: impl Read, most: usize) -> Result<Vec<u8>> {
    let mut out = Vec::new();
    let read = reader.take(most as u64 + 1).read_to_end(&mut out);
    read.map_err(|e| damaged(e.to_string()))?;
    if out.len() > most { Err(damaged(format!("it holds more than {most} bytes"))) } else { Ok(out) }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use flate2::Compression;
    use flate2::write::ZlibEncoder;
    use std::io::Write;

    #[test]
    fn what_yields_too_much_or_ends_early_is_refused() {
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
        encoder.write_all(&[7; 1000]).unwrap();
        let bytes = encoder.finish().unwrap();
        assert_eq!(zlib(&bytes, 1000).unwrap(), [7; 1000]);
        assert!(zlib(&bytes, 999).unwrap_err().to_string().contains("more than 999"));
        assert!(zlib(&bytes[..bytes.len() - 6], 1000).is_err());
        // Five literals: 5 << 4, then the bytes.
        assert_eq!(lz4(b"\x50hello", 5).unwrap(), b"hello");
        assert!(lz4(b"\x50hello", 4).is_err() && lz4(b"\x50hell", 5).is_err());
    }

    #[test]
    fn shuffled_bytes_become_numbers_again_and_the_rest_stays() {
        assert_eq!(unshuffle(&[1, 3, 5, 2, 4, 6, 9], 2), [1, 2, 3, 4, 5, 6, 9]);
        assert_eq!(unshuffle(&[1, 2, 3], 1), [1, 2, 3]);
        assert_eq!(unshuffle(&[1], 4), [1]);
        assert!(unshuffle(&[], 4).is_empty());
    }
}
