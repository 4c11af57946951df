//! The commit mark of a slot.

use super::mapped::UNIT;
use crate::blob::CRC;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// First bytes of every mark; the last of them is the version of the mark.
const MAGIC: [u8; 8] = *b"OMMARK\0\x01";
const CRC_AT: usize = 20;

/// One of the two places for a network file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum Slot {
    /// The first.
    A,
    /// The second.
    B,
}

impl Slot {
    /// Both.
    pub const ALL: [Self; 2] = [Self::A, Self::B];

    /// The other slot.
    pub const fn other(self) -> Self {
        match self {
            Self::A => Self::B,
            Self::B => Self::A,
        }
    }
}

/// The commit mark of a slot: it identifies the file in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Mark {
    /// Number of the commit. The file of the higher number is the newer one.
    pub generation: u32,
    /// Length of the file, bytes.
    pub len: u32,
    /// CRC-32 at the end of the file.
    pub crc: u32,
}

impl Mark {
    /// The mark of a complete file; `None` where it has less than four bytes or more than 32 bits can count.
    pub(super) fn of(file: &[u8], generation: u32) -> Option<Self> {
        let crc = u32::from_le_bytes(*file.last_chunk()?);
        Some(Self { generation, len: u32::try_from(file.len()).ok()?, crc })
    }

    /// Whether this file was committed after `other`. Generations may wrap.
    pub(super) const fn is_newer_than(&self, other: &Self) -> bool {
        let ahead = self.generation.wrapping_sub(other.generation);
        ahead != 0 && ahead <= u32::MAX / 2
    }

    pub(super) fn encode(&self) -> [u8; UNIT] {
        let mut bytes = [0xff; UNIT];
        let fields = MAGIC
            .into_iter()
            .chain(self.generation.to_le_bytes())
            .chain(self.len.to_le_bytes())
            .chain(self.crc.to_le_bytes());
        bytes.iter_mut().zip(fields).for_each(|(byte, field)| *byte = field);
        let crc = CRC.checksum(&bytes[..CRC_AT]);
        bytes[CRC_AT..CRC_AT + 4].copy_from_slice(&crc.to_le_bytes());
        bytes
    }

    /// The mark at the beginning of `bytes`, if there is one.
    pub(super) fn decode(bytes: &[u8]) -> Option<Self> {
        let (signed, rest) = bytes.split_first_chunk::<CRC_AT>()?;
        let crc = u32::from_le_bytes(*rest.first_chunk()?);
        let (magic, fields) = signed.split_first_chunk::<8>()?;
        if *magic != MAGIC || crc != CRC.checksum(signed) {
            return None;
        }
        let (fields, _) = fields.as_chunks::<4>();
        let [generation, len, crc] = *<&[[u8; 4]; 3]>::try_from(fields).ok()?;
        let number = u32::from_le_bytes;
        Some(Self { generation: number(generation), len: number(len), crc: number(crc) })
    }
}
