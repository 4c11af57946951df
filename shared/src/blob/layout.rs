//! Offsets in the file.

use super::error::{BlobError, Section};
use super::header::{Header, SectionLens};
use crc::{CRC_32_ISO_HDLC, Crc};
use postcard_schema::key::Key;

/// The first eight bytes of every network file.
pub const MAGIC: [u8; 8] = *b"OMMATIDI";
/// Version of the layout. It changes with everything that the schema key does not cover.
pub const VERSION: u16 = 6;
/// The version before, whose header lacks its last field, the watch. Such files are read as well.
pub(super) const VERSION_5: u16 = 5;
/// The version before that, whose header lacks the passes, too. Such files are read as well.
pub(super) const VERSION_4: u16 = 4;
/// The version before that, whose scales of integers lack their last field. Such files are read as well.
pub(super) const VERSION_3: u16 = 3;
/// The version before that, whose header lacks its last three fields. Such files are read as well.
pub(super) const VERSION_2: u16 = 2;
/// Hash of every name and type in [`Header`]: it changes when one of them does.
pub const SCHEMA_KEY: u64 = u64::from_le_bytes(Key::for_path::<Header>("ommatidia/blob").to_bytes());
/// Hash of the header of version 5.
pub(super) const SCHEMA_KEY_5: u64 = 0xa332_4f41_7910_4a39;
/// Hash of the header of version 4.
pub(super) const SCHEMA_KEY_4: u64 = 0x03b7_9614_b0da_b2c6;
/// Hash of the header of version 3.
pub(super) const SCHEMA_KEY_3: u64 = 0x9721_b2ba_9583_b3e3;
/// Hash of the header of version 2.
pub(super) const SCHEMA_KEY_2: u64 = 0x98b4_274f_6e7f_975e;
/// Alignment of the file and of each section in it, bytes.
pub const ALIGN: usize = 16;

pub(super) const VERSION_AT: usize = 8;
pub(super) const HEADER_LEN_AT: usize = 12;
pub(super) const SCHEMA_AT: usize = 16;
pub(super) const FILE_LEN_AT: usize = 24;
pub(super) const HEADER_AT: usize = 32;
pub(super) const CRC_LEN: usize = 4;
/// Number of sections.
pub(super) const SECTIONS: usize = Section::ALL.len();
/// The longest header that a file may have, bytes.
pub(super) const MAX_HEADER_LEN: usize = 1024;

/// CRC-32 as in Ethernet, zip and PNG.
pub(crate) const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// Byte ranges of the sections in the file, and the file's length.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Layout {
    /// Start and length in bytes, in the order of [`Section::ALL`].
    pub sections: [(usize, usize); SECTIONS],
    /// Length of the file with its CRC, bytes.
    pub file_len: usize,
}

impl Layout {
    /// The layout of a file with `header_len` bytes of header and sections of `lens` numbers of 16 bits.
    ///
    /// # Errors
    /// [`BlobError::SectionLength`] where the file would have 4 GiB or more.
    pub fn new(header_len: usize, lens: &SectionLens) -> Result<Self, BlobError> {
        let mut at = HEADER_AT + header_len;
        let mut sections = [(0, 0); SECTIONS];
        for ((slot, section), halves) in sections.iter_mut().zip(Section::ALL).zip(lens.in_order()) {
            let too_long = BlobError::SectionLength { section, expected: halves, found: (u32::MAX / 2) as u64 };
            // Files of version 2 end with the gap before an empty gain map, and have no later sections.
            if halves > 0 || section.is_old() {
                at = at.next_multiple_of(ALIGN);
            }
            let bytes = usize::try_from(halves).ok().and_then(|n| n.checked_mul(2)).ok_or(too_long)?;
            *slot = (at, bytes);
            // Padding and CRC fit behind it, so no later sum can overflow.
            at = at.checked_add(bytes).filter(|end| *end < u32::MAX as usize - 2 * ALIGN).ok_or(too_long)?;
        }
        Ok(Self { sections, file_len: at + CRC_LEN })
    }
}

impl SectionLens {
    /// The lengths in the order of [`Section::ALL`].
    pub(super) fn in_order(&self) -> [u64; SECTIONS] {
        [
            self.filters,
            self.index,
            self.rcan,
            self.offset_dn,
            self.inverse_gain,
            self.integers,
            self.channels,
            self.predictor,
            self.watch,
            self.statistics,
        ]
    }
}
