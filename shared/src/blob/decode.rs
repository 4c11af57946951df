//! Reading a network file in place.

use super::error::{BlobError, Section};
use super::header::{Header, HeaderField, WatchWeights, Weights};
use super::layout::{
    ALIGN, CRC, CRC_LEN, FILE_LEN_AT, HEADER_AT, HEADER_LEN_AT, Layout, MAGIC, MAX_HEADER_LEN, SCHEMA_AT, SCHEMA_KEY,
    SCHEMA_KEY_2, SCHEMA_KEY_3, SCHEMA_KEY_4, SCHEMA_KEY_5, SECTIONS, VERSION, VERSION_2, VERSION_3, VERSION_4,
    VERSION_5, VERSION_AT,
};
use crate::nn::integer::Convolutions;
use crate::watch::Maps;
use core::cmp::Ordering;
use postcard::de_flavors::Flavor;
use serde::Deserialize;

/// A network that has been checked: its header, and its weights where they lie.
///
/// There is no other way to a network than the three that check it: [`Network::decode`], [`Network::new`], and
/// [`Verified::open`] for a file that was checked before. So whatever takes a `Network`, as
/// [`crate::pipeline::Pipeline`] does, need not look at its weights again.
#[derive(Clone, Debug)]
pub struct Network<'a> {
    header: Header,
    weights: Weights<'a>,
}

impl<'a> Network<'a> {
    /// A network of a header and weights that lie in memory.
    ///
    /// # Errors
    /// [`BlobError::Header`] where a value of the header is impossible, [`BlobError::SectionLength`] where a section of
    /// the weights has another length than the header says, [`BlobError::NonFinite`] where a weight is infinite or NaN,
    /// [`BlobError::Channel`] where a sum of integers could overflow, [`BlobError::Lens`] where a predicted frame
    /// could, [`BlobError::Statistic`] where a statistic of the watch has an impossible number.
    pub fn new(header: Header, weights: Weights<'a>) -> Result<Self, BlobError> {
        weights.check(&header)?;
        let maps = header.sensor;
        let offset_dn = weights.offset_dn.filter(|_| maps.has_offset_map);
        let inverse_gain = weights.inverse_gain.filter(|_| maps.has_gain_map);
        let convolutions = weights.convolutions.filter(|_| header.integers.is_some());
        Ok(Self { header, weights: Weights { offset_dn, inverse_gain, convolutions, ..weights } })
    }

    /// Reads a network file and checks every bit of it: length, magic, version, schema, CRC, header, that all
    /// weights are finite, and that no integer convolution and no predicted frame can overflow. Files of versions 2 to
    /// 5 are read as well.
    ///
    /// # Errors
    /// The first thing that is wrong with `bytes`. No bytes make it panic or read elsewhere.
    pub fn decode(bytes: &'a [u8]) -> Result<Self, BlobError> {
        Verified::check(bytes)?.open(bytes)
    }

    /// Reads a file, of which neither checksum nor weights are looked at.
    fn view(bytes: &'a [u8]) -> Result<Self, BlobError> {
        let header_len = u32_at(bytes, HEADER_LEN_AT) as usize;
        let header = decode_header(bytes, header_len)?;
        let layout = Layout::new(header_len, &header.section_lens()?)?;
        if layout.file_len != bytes.len() {
            return Err(wrong_section(&layout, &header, bytes.len()));
        }
        let [filters, index, rcan, offset, gain, integers, channels, predictor, watch, statistics] =
            layout.sections.map(|(at, len)| bytes.get(at..at + len).unwrap_or_default());
        let sensor = header.sensor;
        let weights = Weights {
            filters: numbers(filters)?,
            index: numbers(index)?,
            rcan: numbers(rcan)?,
            offset_dn: if sensor.has_offset_map { Some(numbers(offset)?) } else { None },
            inverse_gain: if sensor.has_gain_map { Some(numbers(gain)?) } else { None },
            convolutions: match header.integers {
                Some(_) => Some(Convolutions { weights: numbers(integers)?, channels: numbers(channels)? }),
                None => None,
            },
            predictor: numbers(predictor)?,
            watch: match header.watch {
                Some(_) => WatchWeights { maps: numbers(watch)?, statistics: numbers(statistics)? },
                None => WatchWeights::default(),
            },
        };
        Ok(Self { header, weights })
    }

    /// Its shapes, its name, and the memory that it needs.
    pub const fn header(&self) -> &Header {
        &self.header
    }

    /// The header alone.
    pub fn into_header(self) -> Header {
        self.header
    }

    /// The maps of its watch on the optics, if it has one.
    pub fn watch(&self) -> Option<Maps<'a>> {
        let watch = self.header.watch?;
        Some(Maps {
            frame: self.header.frame,
            block: watch.block,
            black_dn: watch.black_dn,
            least_light_dn: watch.least_light_dn,
            log_odds: watch.log_odds,
            weights: self.weights.watch.maps,
            statistics: self.weights.watch.statistics,
        })
    }

    /// Its weights, all of them finite and as many as the header says.
    pub const fn weights(&self) -> Weights<'a> {
        self.weights
    }
}

/// Proof that a network file has passed every check of [`Network::decode`]: its length and its checksum. It is kept
/// where the file itself cannot be borrowed for so long, and opens the file again without a second look at all its
/// bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Verified {
    len: usize,
    crc: u32,
}

impl Verified {
    /// Checks every bit of a network file.
    ///
    /// # Errors
    /// The first thing that is wrong with `bytes`. No bytes make it panic or read elsewhere.
    pub fn check(bytes: &[u8]) -> Result<Self, BlobError> {
        let (body, crc) = check_preamble(bytes)?;
        let found = CRC.checksum(body);
        if crc != found {
            return Err(BlobError::Crc { expected: crc, found });
        }
        let network = Network::view(bytes)?;
        network.weights.check_numbers(&network.header)?;
        Ok(Self { len: bytes.len(), crc })
    }

    /// Reads the file that was checked. Its header is decoded again; checksum and weights are not computed or looked at
    /// again.
    ///
    /// # Errors
    /// [`BlobError::TooShort`], [`BlobError::TooLong`] or [`BlobError::Crc`] where `bytes` are another file than the
    /// one that was checked, which ends with this checksum; otherwise as [`Network::decode`], and only where its memory
    /// has changed since.
    pub fn open(self, bytes: &[u8]) -> Result<Network<'_>, BlobError> {
        let (_, found) = check_preamble(bytes)?;
        check_len(self.len as u64, bytes.len() as u64)?;
        if found != self.crc {
            return Err(BlobError::Crc { expected: self.crc, found });
        }
        Network::view(bytes)
    }
}

/// Checks everything before the header. Returns the bytes that the CRC covers, and the CRC that the file carries.
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
    let expected = match version {
        VERSION => SCHEMA_KEY,
        VERSION_5 => SCHEMA_KEY_5,
        VERSION_4 => SCHEMA_KEY_4,
        VERSION_3 => SCHEMA_KEY_3,
        VERSION_2 => SCHEMA_KEY_2,
        found => return Err(BlobError::Version { expected: VERSION, found }),
    };
    let found_key = u64::from_le_bytes(array_at(bytes, SCHEMA_AT));
    if found_key != expected {
        return Err(BlobError::Schema { expected, found: found_key });
    }
    let expected = u64::from(u32_at(bytes, FILE_LEN_AT));
    check_len(expected, found)?;
    let (body, crc) = bytes.split_at(bytes.len() - CRC_LEN);
    Ok((body, u32_at(crc, 0)))
}

fn check_len(expected: u64, found: u64) -> Result<(), BlobError> {
    match found.cmp(&expected) {
        Ordering::Less => Err(BlobError::TooShort { expected, found }),
        Ordering::Equal => Ok(()),
        Ordering::Greater => Err(BlobError::TooLong { expected, found }),
    }
}

fn decode_header(bytes: &[u8], len: usize) -> Result<Header, BlobError> {
    let unreadable = BlobError::Header { field: HeaderField::Encoding };
    let end = HEADER_AT.checked_add(len).filter(|_| len <= MAX_HEADER_LEN).ok_or(unreadable)?;
    let encoded = bytes.get(HEADER_AT..end).ok_or(unreadable)?;
    // What headers of older versions lack are their last bytes, which would be zeros: the watch, before version 5 the
    // passes, before version 4 the bits of a feature, before version 3 the scales of integers.
    let version = u16::from_le_bytes(array_at(bytes, VERSION_AT));
    let zeros = match version {
        VERSION => 0,
        VERSION_5 => 1,
        VERSION_4 => 2,
        _ => 3,
    };
    let mut decoder = postcard::Deserializer::from_flavor(Followed { bytes: encoded, zeros });
    let header = Header::deserialize(&mut decoder).map_err(|_| unreadable)?;
    let unused = u8::from(version == VERSION_3 && header.integers.is_none());
    match decoder.finalize() {
        Ok(Followed { bytes: [], zeros }) if zeros == unused => {}
        _ => return Err(unreadable),
    }
    // Version 2 has no integers, before version 5 there was one pass, and before version 6 no watch: their bytes are
    // those that say so.
    let later = (version == VERSION_2 && header.integers.is_some())
        || (version < VERSION_5 && header.passes.is_some())
        || (version < VERSION && header.watch.is_some());
    if later {
        return Err(unreadable);
    }
    header.check()?;
    Ok(header)
}

/// Bytes that zeros follow. The decoder reads them in place: a longer copy would be on the stack.
struct Followed<'a> {
    bytes: &'a [u8],
    zeros: u8,
}

impl<'a> Flavor<'a> for Followed<'a> {
    type Remainder = Self;
    type Source = &'a [u8];

    fn pop(&mut self) -> postcard::Result<u8> {
        if let Some((first, rest)) = self.bytes.split_first() {
            self.bytes = rest;
            return Ok(*first);
        }
        self.zeros = self.zeros.checked_sub(1).ok_or(postcard::Error::DeserializeUnexpectedEnd)?;
        Ok(0)
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.bytes.len() + usize::from(self.zeros))
    }

    fn try_take_n(&mut self, n: usize) -> postcard::Result<&'a [u8]> {
        let (taken, rest) = self.bytes.split_at_checked(n).ok_or(postcard::Error::DeserializeUnexpectedEnd)?;
        self.bytes = rest;
        Ok(taken)
    }

    fn finalize(self) -> postcard::Result<Self> {
        Ok(self)
    }
}

/// Names the first section that runs past the end of the file, or else the last one, which is too short for it.
fn wrong_section(layout: &Layout, header: &Header, file_len: usize) -> BlobError {
    let end = file_len.saturating_sub(CRC_LEN);
    let lens = header.section_lens().map_or([0; SECTIONS], |lens| lens.in_order());
    let past = layout.sections.iter().position(|(at, len)| at + len > end).unwrap_or(lens.len() - 1);
    let found = end.saturating_sub(layout.sections[past].0) / 2;
    BlobError::SectionLength { section: Section::ALL[past], expected: lens[past], found: found as u64 }
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
