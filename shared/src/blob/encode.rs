//! Writing a network file.

use super::layout::{
    CRC, CRC_LEN, FILE_LEN_AT, HEADER_AT, HEADER_LEN_AT, Layout, MAGIC, MAX_HEADER_LEN, SCHEMA_AT, SCHEMA_KEY, VERSION,
    VERSION_AT,
};
use super::{BlobError, Header, HeaderField, Section, Weights};
use half::f16;

/// Length of the file that [`encode`] writes for this header, bytes.
///
/// # Errors
/// [`BlobError::Header`] where the header holds what no network can have.
pub fn encoded_len(header: &Header) -> Result<usize, BlobError> {
    let mut buffer = [0; MAX_HEADER_LEN];
    header.check()?;
    Ok(Layout::new(header_bytes(header, &mut buffer)?.len(), &header.section_lens()?)?.file_len)
}

/// Writes a network file to the start of `out` and gives its length, bytes.
///
/// # Errors
/// [`BlobError::Header`] where the header holds what no network can have, [`BlobError::SectionLength`] where the
/// weights do not match it, [`BlobError::NonFinite`], and [`BlobError::NoRoom`].
pub fn encode(header: &Header, weights: &Weights<'_>, out: &mut [u8]) -> Result<usize, BlobError> {
    header.check()?;
    let mut buffer = [0; MAX_HEADER_LEN];
    let head = header_bytes(header, &mut buffer)?;
    let lens = header.section_lens()?;
    let layout = Layout::new(head.len(), &lens)?;
    let room = BlobError::NoRoom { expected: layout.file_len as u64, found: out.len() as u64 };
    let file = out.get_mut(..layout.file_len).ok_or(room)?;
    file.fill(0);
    write_preamble(file, head.len());
    file[HEADER_AT..HEADER_AT + head.len()].copy_from_slice(head);
    for (section, halves) in weights.halves() {
        check_finite(section, halves)?;
    }
    for (i, ((section, words), expected)) in weights.words().into_iter().zip(lens.in_order()).enumerate() {
        if words.len() as u64 != expected {
            return Err(BlobError::SectionLength { section, expected, found: words.len() as u64 });
        }
        let (at, bytes) = layout.sections[i];
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

/// Whether all weights of a section are finite.
pub(super) fn check_finite(section: Section, halves: &[f16]) -> Result<(), BlobError> {
    match halves.iter().position(|half| !half.is_finite()) {
        Some(index) => Err(BlobError::NonFinite { section, index: index as u32 }),
        None => Ok(()),
    }
}

impl<'a> Weights<'a> {
    /// The sections of halves.
    pub(super) fn halves(&self) -> [(Section, &'a [f16]); 4] {
        let maps = [self.offset_dn.unwrap_or(&[]), self.inverse_gain.unwrap_or(&[])];
        [
            (Section::Filters, self.filters),
            (Section::Rcan, self.rcan),
            (Section::Offset, maps[0]),
            (Section::InverseGain, maps[1]),
        ]
    }

    /// All sections in the order of the file, as bits.
    fn words(&self) -> [(Section, &'a [u16]); 5] {
        let [filters, rcan, offset, gain] =
            self.halves().map(|(section, halves)| (section, bytemuck::cast_slice(halves)));
        [filters, (Section::Index, self.index), rcan, offset, gain]
    }
}
