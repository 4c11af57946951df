//! Reading a network file in place.

use super::encode::check_finite;
use super::layout::{
    ALIGN, CRC, CRC_LEN, FILE_LEN_AT, HEADER_AT, HEADER_LEN_AT, Layout, MAGIC, MAX_HEADER_LEN, SCHEMA_AT, SCHEMA_KEY,
    VERSION, VERSION_AT,
};
use super::{BlobError, Header, HeaderField, Weights};

/// A network: its header, and its weights where the file lies.
#[derive(Clone, Debug)]
pub struct Network<'a> {
    /// Shapes.
    pub header: Header,
    /// Weights.
    pub weights: Weights<'a>,
}

impl<'a> Network<'a> {
    /// Reads a file of which every bit has been checked: length, magic, version, schema, CRC, header, weights.
    ///
    /// # Errors
    /// The first thing that is wrong with `bytes`. No bytes make it panic or read elsewhere.
    pub fn decode(bytes: &'a [u8]) -> Result<Self, BlobError> {
        let (body, crc) = check_preamble(bytes)?;
        let found = CRC.checksum(body);
        if crc != found {
            return Err(BlobError::Crc { expected: crc, found });
        }
        let network = Self::view(bytes)?;
        for (section, halves) in network.weights.halves() {
            check_finite(section, halves)?;
        }
        Ok(network)
    }

    /// Reads a file that [`Network::decode`] has accepted before, without going through all its bytes again.
    ///
    /// # Errors
    /// As `decode`, save that neither checksum nor weights are looked at.
    pub fn view(bytes: &'a [u8]) -> Result<Self, BlobError> {
        check_preamble(bytes)?;
        let header_len = u32_at(bytes, HEADER_LEN_AT) as usize;
        let header = decode_header(bytes, header_len)?;
        let layout = Layout::new(header_len, &header.section_lens()?)?;
        if layout.file_len != bytes.len() {
            return Err(wrong_section(&layout, &header, bytes.len()));
        }
        let [filters, index, rcan, offset, gain] =
            layout.sections.map(|(at, len)| bytes.get(at..at + len).unwrap_or_default());
        let sensor = header.sensor;
        let weights = Weights {
            filters: numbers(filters)?,
            index: numbers(index)?,
            rcan: numbers(rcan)?,
            offset_dn: if sensor.has_offset_map { Some(numbers(offset)?) } else { None },
            inverse_gain: if sensor.has_gain_map { Some(numbers(gain)?) } else { None },
        };
        Ok(Self { header, weights })
    }
}

/// Checks all that stands before the header; gives what the CRC covers, and the CRC that the file carries.
fn check_preamble(bytes: &[u8]) -> Result<(&[u8], u32), BlobError> {
    let found = bytes.len() as u64;
    if bytes.len() < HEADER_AT + CRC_LEN {
        return Err(BlobError::TooShort { expected: (HEADER_AT + CRC_LEN) as u64, found });
    }
    if !bytes.as_ptr().addr().is_multiple_of(ALIGN) {
        return Err(misaligned(bytes));
    }
    if bytes[..8] != MAGIC {
        return Err(BlobError::Magic { expected: MAGIC, found: array_at(bytes, 0) });
    }
    let version = u16::from_le_bytes(array_at(bytes, VERSION_AT));
    if version != VERSION {
        return Err(BlobError::Version { expected: VERSION, found: version });
    }
    let schema = u64::from_le_bytes(array_at(bytes, SCHEMA_AT));
    if schema != SCHEMA_KEY {
        return Err(BlobError::Schema { expected: SCHEMA_KEY, found: schema });
    }
    let expected = u64::from(u32_at(bytes, FILE_LEN_AT));
    if found < expected {
        return Err(BlobError::TooShort { expected, found });
    }
    if found > expected {
        return Err(BlobError::TooLong { expected, found });
    }
    let (body, crc) = bytes.split_at(bytes.len() - CRC_LEN);
    Ok((body, u32_at(crc, 0)))
}

fn decode_header(bytes: &[u8], len: usize) -> Result<Header, BlobError> {
    let unreadable = BlobError::Header { field: HeaderField::Encoding };
    let end = HEADER_AT.checked_add(len).filter(|_| len <= MAX_HEADER_LEN).ok_or(unreadable)?;
    let encoded = bytes.get(HEADER_AT..end).ok_or(unreadable)?;
    let (header, rest) = postcard::take_from_bytes::<Header>(encoded).map_err(|_| unreadable)?;
    if !rest.is_empty() {
        return Err(unreadable);
    }
    header.check()?;
    Ok(header)
}

/// Names the first section that runs past the end of the file, or else the last one, which is too short for it.
fn wrong_section(layout: &Layout, header: &Header, file_len: usize) -> BlobError {
    let end = file_len.saturating_sub(CRC_LEN);
    let lens = header.section_lens().map_or([0; 5], |lens| lens.in_order());
    let past = layout.sections.iter().position(|(at, len)| at + len > end).unwrap_or(lens.len() - 1);
    let found = end.saturating_sub(layout.sections[past].0) / 2;
    BlobError::SectionLength { section: super::Section::ALL[past], expected: lens[past], found: found as u64 }
}

/// Little-endian halves, or words, in place.
fn numbers<T: bytemuck::AnyBitPattern>(bytes: &[u8]) -> Result<&[T], BlobError> {
    const { assert!(cfg!(target_endian = "little"), "weights are read in place, so the target must be little-endian") };
    bytemuck::try_cast_slice(bytes).map_err(|_| misaligned(bytes))
}

fn misaligned(bytes: &[u8]) -> BlobError {
    BlobError::Misaligned { expected: ALIGN as u32, found: (bytes.as_ptr().addr() % ALIGN) as u32 }
}

fn array_at<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    let mut array = [0; N];
    array.copy_from_slice(&bytes[at..at + N]);
    array
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(array_at(bytes, at))
}
