//! COBS (Cheshire and Baker, "Consistent Overhead Byte Stuffing", IEEE/ACM Trans. Networking 7, 1999): bytes without
//! zeros, so that a zero can end a packet.
//!
//! This implementation checks every index, so no byte of a packet can lead to a panic.

use postcard::ser_flavors::Flavor;
use postcard::{Error, Result};

/// The byte between packets. Encoded bytes hold none.
pub(super) const DELIMITER: u8 = 0;
/// The code of a full group: 254 bytes follow, and no zero after them.
const FULL: u8 = 0xff;

/// Writes bytes as COBS.
pub(super) struct Encoder<'a> {
    out: &'a mut [u8],
    /// Index of the next byte.
    at: usize,
    /// Index of the code of the open group.
    code_at: usize,
    /// Code of the open group: 1 more than the bytes in it so far.
    code: u8,
}

impl<'a> Encoder<'a> {
    pub(super) fn new(out: &'a mut [u8]) -> Self {
        Self { out, at: 1, code_at: 0, code: 1 }
    }

    fn put(&mut self, at: usize, byte: u8) -> Result<()> {
        *self.out.get_mut(at).ok_or(Error::SerializeBufferFull)? = byte;
        Ok(())
    }

    fn end_group(&mut self) -> Result<()> {
        self.put(self.code_at, self.code)?;
        (self.code_at, self.at, self.code) = (self.at, self.at + 1, 1);
        Ok(())
    }
}

impl Flavor for Encoder<'_> {
    /// Bytes written, the delimiter at the end included.
    type Output = usize;

    fn try_push(&mut self, byte: u8) -> Result<()> {
        if byte == DELIMITER {
            return self.end_group();
        }
        self.put(self.at, byte)?;
        self.at += 1;
        self.code += 1;
        if self.code == FULL { self.end_group() } else { Ok(()) }
    }

    fn finalize(mut self) -> Result<usize> {
        self.put(self.code_at, self.code)?;
        self.put(self.at, DELIMITER)?;
        Ok(self.at + 1)
    }
}

/// Decodes `bytes` in place and returns the number of decoded bytes at their beginning; `None` where the encoding is
/// broken.
pub(super) fn decode_in_place(bytes: &mut [u8]) -> Option<usize> {
    let (mut from, mut to) = (0, 0);
    while from < bytes.len() {
        let code = *bytes.get(from)?;
        let group = from + 1..from + usize::from(code);
        if code == DELIMITER || group.end > bytes.len() {
            return None;
        }
        for at in group.clone() {
            let byte = *bytes.get(at)?;
            *bytes.get_mut(to)? = byte;
            to += 1;
        }
        from = group.end;
        // The zero behind the last group is the end of the packet.
        if code != FULL && from < bytes.len() {
            *bytes.get_mut(to)? = DELIMITER;
            to += 1;
        }
    }
    Some(to)
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    proptest! {
        #[test]
        fn the_bytes_are_those_of_another_implementation(
            bytes in prop::collection::vec(prop_oneof![Just(0u8), any::<u8>(), 1u8..3], 0..800)
        ) {
            let mut out = std::vec![0; 1000];
            let mut encoder = Encoder::new(&mut out);
            bytes.iter().for_each(|byte| encoder.try_push(*byte).unwrap());
            let len = encoder.finalize().unwrap();
            out.truncate(len - 1);
            prop_assert!(!out.contains(&0));
            let mut theirs = Vec::new();
            prop_assert!(cobs::decode_vec(&out).map(|v| theirs = v).is_ok());
            prop_assert_eq!(&theirs, &bytes);
            let len = decode_in_place(&mut out).unwrap();
            prop_assert_eq!(&out[..len], &bytes);
            let mut theirs = cobs::encode_vec(&bytes);
            let len = decode_in_place(&mut theirs).unwrap();
            prop_assert_eq!(&theirs[..len], &bytes);
        }

        #[test]
        fn any_bytes_decode_or_not(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
            let mut bytes = bytes;
            let len = bytes.len();
            prop_assert!(decode_in_place(&mut bytes).is_none_or(|decoded| decoded <= len));
        }
    }
}
