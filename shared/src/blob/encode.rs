//! Writing a network file.

use super::error::BlobError;
use super::header::{Header, HeaderField, Weights};
use super::layout::{
    CRC, CRC_LEN, FILE_LEN_AT, HEADER_AT, HEADER_LEN_AT, Layout, MAGIC, MAX_HEADER_LEN, SCHEMA_AT, SCHEMA_KEY, VERSION,
    VERSION_AT,
};

/// Length of the file that [`encode`] writes for this header, bytes.
///
/// # Errors
/// [`BlobError::Header`] where a value of the header is impossible.
pub fn encoded_len(header: &Header) -> Result<usize, BlobError> {
    let mut buffer = [0; MAX_HEADER_LEN];
    header.check()?;
    Ok(Layout::new(header_bytes(header, &mut buffer)?.len(), &header.section_lens()?)?.file_len)
}

/// Writes a network file to the start of `out` and returns its length, bytes. The bytes behind it stay as they are.
///
/// # Errors
/// [`BlobError::Header`] where a value of the header is impossible, [`BlobError::SectionLength`] where a section of the
/// weights has another length than the header says, [`BlobError::NonFinite`] where a weight is infinite or NaN,
/// [`BlobError::NoRoom`] where `out` is too short.
pub fn encode(header: &Header, weights: &Weights<'_>, out: &mut [u8]) -> Result<usize, BlobError> {
    weights.check(header)?;
    let mut buffer = [0; MAX_HEADER_LEN];
    let head = header_bytes(header, &mut buffer)?;
    let layout = Layout::new(head.len(), &header.section_lens()?)?;
    let room = BlobError::NoRoom { expected: layout.file_len as u64, found: out.len() as u64 };
    let file = out.get_mut(..layout.file_len).ok_or(room)?;
    file.fill(0);
    write_preamble(file, head.len());
    file[HEADER_AT..HEADER_AT + head.len()].copy_from_slice(head);
    for ((_, words), (at, bytes)) in weights.words().into_iter().zip(layout.sections) {
        for (slot, word) in file[at..at + bytes].chunks_exact_mut(2).zip(words) {
            slot.copy_from_slice(&word.to_le_bytes());
        }
    }
    let (body, crc) = file.split_at_mut(layout.file_len - CRC_LEN);
    crc.copy_from_slice(&CRC.checksum(body).to_le_bytes());
    Ok(layout.file_len)
}

/// Encodes the header.
fn header_bytes<'a>(header: &Header, buffer: &'a mut [u8; MAX_HEADER_LEN]) -> Result<&'a [u8], BlobError> {
    let bytes = postcard::to_slice(header, buffer).map_err(|_| BlobError::Header { field: HeaderField::Encoding })?;
    Ok(bytes)
}

fn write_preamble(file: &mut [u8], header_len: usize) {
    let mut put = |at: usize, bytes: &[u8]| file[at..at + bytes.len()].copy_from_slice(bytes);
    put(0, &MAGIC);
    put(VERSION_AT, &VERSION.to_le_bytes());
    put(HEADER_LEN_AT, &(header_len as u32).to_le_bytes());
    put(SCHEMA_AT, &SCHEMA_KEY.to_le_bytes());
    let len = file.len() as u32;
    file[FILE_LEN_AT..FILE_LEN_AT + 4].copy_from_slice(&len.to_le_bytes());
}
