//! Packets on a line of bytes: postcard, CRC-32, COBS, a zero on either side.

use super::cobs::{DELIMITER, Encoder, decode_in_place};
use crate::blob::CRC;
use core::fmt;
use crc::Digest;
use heapless::Vec;
use postcard::ser_flavors::Flavor;
use serde::{Deserialize, Serialize};

const CRC_LEN: usize = 4;

/// Why a packet was dropped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameError {
    /// The buffer is too small for the packet.
    TooLong,
    /// The COBS encoding is broken, or there is no room for a checksum.
    Encoding,
    /// The checksum does not match.
    Crc {
        /// Checksum that the packet carries.
        expected: u32,
        /// Checksum of its bytes.
        found: u32,
    },
    /// The checksum matches, but the bytes are no message of this version.
    Message,
}

impl fmt::Display for FrameError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::TooLong => f.write_str("a packet is longer than its buffer"),
            Self::Encoding => f.write_str("a packet is not COBS-encoded"),
            Self::Crc { expected, found } => {
                write!(f, "a packet is damaged: expected CRC {expected:08x}, found {found:08x}")
            }
            Self::Message => f.write_str("a packet holds no message of this version"),
        }
    }
}

impl core::error::Error for FrameError {}

/// CRC-32 (ISO-HDLC) of `bytes`: the checksum of packets, of network files and in [`RunReport`](super::RunReport).
pub fn checksum(bytes: &[u8]) -> u32 {
    CRC.checksum(bytes)
}

/// Writes a packet with its delimiters to the start of `out` and returns its bytes. [`MAX_PACKET`](super::MAX_PACKET)
/// bytes are enough for every message.
///
/// # Errors
/// [`FrameError::TooLong`] where `out` is too short.
pub fn encode<'a>(message: &impl Serialize, out: &'a mut [u8]) -> Result<&'a [u8], FrameError> {
    // The leading delimiter ends noise that came before the packet.
    let (first, rest) = out.split_first_mut().ok_or(FrameError::TooLong)?;
    *first = DELIMITER;
    let len = encode_body(message, rest).map_err(|_| FrameError::TooLong)?;
    out.get(..=len).ok_or(FrameError::TooLong)
}

fn encode_body(message: &impl Serialize, out: &mut [u8]) -> postcard::Result<usize> {
    let mut serializer = postcard::Serializer { output: Checked { encoder: Encoder::new(out), digest: CRC.digest() } };
    message.serialize(&mut serializer)?;
    serializer.output.finalize()
}

/// Bytes with their checksum behind them, as COBS.
struct Checked<'a> {
    encoder: Encoder<'a>,
    digest: Digest<'a, u32>,
}

impl Flavor for Checked<'_> {
    type Output = usize;

    /// Messages push their bytes from hundreds of places: inlined there, this would take a tenth of the firmware.
    #[inline(never)]
    fn try_push(&mut self, byte: u8) -> postcard::Result<()> {
        self.digest.update(&[byte]);
        self.encoder.try_push(byte)
    }

    fn finalize(mut self) -> postcard::Result<usize> {
        for byte in self.digest.finalize().to_le_bytes() {
            self.encoder.try_push(byte)?;
        }
        self.encoder.finalize()
    }
}

/// Decodes the message of a packet, which is given without its delimiters. The message borrows from `packet`, which is
/// decoded in place.
///
/// # Errors
/// [`FrameError::Encoding`] where the bytes are not COBS-encoded, [`FrameError::Crc`] where they are damaged,
/// [`FrameError::Message`] where they are no message of type `T`.
pub fn decode<'a, T: Deserialize<'a>>(packet: &'a mut [u8]) -> Result<T, FrameError> {
    let len = decode_in_place(packet).ok_or(FrameError::Encoding)?;
    let (body, crc) =
        packet.get(..len).and_then(|bytes| bytes.split_last_chunk::<CRC_LEN>()).ok_or(FrameError::Encoding)?;
    let (expected, found) = (u32::from_le_bytes(*crc), CRC.checksum(body));
    if expected != found {
        return Err(FrameError::Crc { expected, found });
    }
    match postcard::take_from_bytes(body) {
        Ok((message, [])) => Ok(message),
        _ => Err(FrameError::Message),
    }
}

/// Finds packets of up to `N` encoded bytes on a line.
#[derive(Debug)]
pub struct Deframer<const N: usize> {
    bytes: Vec<u8, N>,
    state: State,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// Bytes of a packet are collected.
    Open,
    /// The packet is too long: the rest of it is dropped.
    Overrun,
    /// A packet was returned. Its bytes are cleared when the next one begins.
    Complete,
}

impl<const N: usize> Deframer<N> {
    /// A deframer that has seen no byte.
    pub const fn new() -> Self {
        Self { bytes: Vec::new(), state: State::Open }
    }

    /// Takes a byte from the line. Returns the packet that it ends, without delimiters, for [`decode`].
    ///
    /// # Errors
    /// [`FrameError::TooLong`] at the end of a packet that is longer than `N`.
    pub fn push(&mut self, byte: u8) -> Result<Option<&mut [u8]>, FrameError> {
        if self.state == State::Complete {
            self.bytes.clear();
            self.state = State::Open;
        }
        if byte != DELIMITER {
            if self.bytes.push(byte).is_err() {
                self.state = State::Overrun;
            }
            return Ok(None);
        }
        let state = core::mem::replace(&mut self.state, State::Complete);
        match state {
            State::Overrun => Err(FrameError::TooLong),
            _ if self.bytes.is_empty() => Ok(None),
            _ => Ok(Some(&mut self.bytes)),
        }
    }
}

impl<const N: usize> Default for Deframer<N> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    extern crate std;

    use super::*;
    use proptest::prelude::*;

    type Message<'a> = (u16, &'a [u8]);

    fn packet(message: &Message<'_>) -> std::vec::Vec<u8> {
        let mut out = [0; 700];
        encode(message, &mut out).unwrap().to_vec()
    }

    /// Feeds a line and gives the messages and the errors on it.
    fn read(line: &[u8]) -> (std::vec::Vec<(u16, std::vec::Vec<u8>)>, usize) {
        let mut deframer = Deframer::<600>::new();
        let (mut messages, mut errors) = (std::vec![], 0);
        for byte in line {
            match deframer.push(*byte).map(|p| p.map(decode::<Message<'_>>)) {
                Ok(Some(Ok((seq, data)))) => messages.push((seq, data.to_vec())),
                Ok(None) => {}
                _ => errors += 1,
            }
        }
        (messages, errors)
    }

    proptest! {
        #[test]
        fn what_is_sent_arrives(seq: u16, data in prop::collection::vec(any::<u8>(), 0..512)) {
            let bytes = packet(&(seq, &data));
            prop_assert_eq!(bytes.iter().filter(|b| **b == DELIMITER).count(), 2);
            prop_assert_eq!(read(&bytes), (std::vec![(seq, data)], 0));
        }

        #[test]
        fn any_bytes_are_dropped_and_the_next_packet_arrives(noise in prop::collection::vec(any::<u8>(), 0..1500)) {
            let mut line = noise;
            line.extend(packet(&(7, &[1, 2, 3])));
            let (messages, _) = read(&line);
            prop_assert_eq!(messages.last(), Some(&(7, std::vec![1, 2, 3])));
        }

        #[test]
        fn a_burst_of_up_to_four_bytes_is_noticed(
            data in prop::collection::vec(any::<u8>(), 1..200), at: prop::sample::Index, burst: [u8; 4]
        ) {
            prop_assume!(burst[0] != 0);
            let clean = packet(&(7, &data));
            let mut line = clean.clone();
            let at = 1 + at.index(line.len() - 2);
            for (byte, flip) in line[at..].iter_mut().zip(burst) {
                *byte ^= flip;
            }
            let (messages, _) = read(&line);
            prop_assert!(messages.iter().all(|m| *m == (7, data.clone())), "{messages:?}");
        }
    }

    #[test]
    fn each_fault_has_its_name() {
        let mut small = [0; 8];
        assert_eq!(encode(&(7u16, &[1u8; 20]), &mut small), Err(FrameError::TooLong));
        let mut deframer = Deframer::<4>::new();
        assert!([1, 2, 3, 4, 5].iter().all(|b| deframer.push(*b) == Ok(None)));
        assert_eq!(deframer.push(DELIMITER), Err(FrameError::TooLong));
        assert_eq!(decode::<u8>(&mut [9, 1]), Err(FrameError::Encoding));
        assert_eq!(decode::<u8>(&mut [3, 1, 1]), Err(FrameError::Encoding));
        let mut damaged = packet(&(7, &[1, 2, 3]));
        let end = damaged.len() - 1;
        damaged[end - 1] ^= 1;
        assert!(matches!(decode::<Message<'_>>(&mut damaged[1..end]), Err(FrameError::Crc { .. })));
        let mut other = packet(&(7, &[1, 2, 3]));
        let end = other.len() - 1;
        assert_eq!(decode::<u8>(&mut other[1..end]), Err(FrameError::Message));
    }
}
