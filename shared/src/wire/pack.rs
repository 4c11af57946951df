//! Pixels without loss in fewer bits: differences to the pixel before, Rice-coded (R. F. Rice, "Some practical
//! universal noiseless coding techniques", JPL 79-22, 1979).
//!
//! A packet stands alone: the pixel before its first one counts as 0. Blocks of 64 differences d follow, each with four
//! bits for the number k of low bits. The signed d (modulo 2^16) is folded to 2 d or -2 d - 1; of that, the bits above
//! the low k are a number of ones and a zero, then come the k low bits. 24 ones stand for 16 bits as they are. Bits
//! fill bytes from the high end. Work and memory are bounded by the number of pixels, whatever the bytes are.

/// Pixels with a common number of low bits.
const BLOCK: usize = 64;
/// So many ones announce a difference of 16 bits as it is.
const ESCAPE: u32 = 24;
const K_BITS: u32 = 4;

fn fold(difference: u16) -> u16 {
    let signed = difference as i16;
    ((signed << 1) ^ (signed >> 15)) as u16
}

fn unfold(folded: u16) -> u16 {
    (folded >> 1) ^ (folded & 1).wrapping_neg()
}

/// Bits of a folded difference.
fn cost(folded: u16, k: u32) -> u32 {
    let ones = u32::from(folded >> k);
    if ones < ESCAPE { ones + 1 + k } else { ESCAPE + 16 }
}

/// The bits of `out`, from the front.
struct Writer<'a> {
    out: &'a mut [u8],
    bits: usize,
}

impl Writer<'_> {
    /// Whether `count` more bits fit.
    fn fits(&self, count: u32) -> bool {
        self.bits + count as usize <= 8 * self.out.len()
    }

    /// Writes the low `count` bits.
    fn put(&mut self, bits: u32, count: u32) {
        for bit in (0..count).rev() {
            if let Some(byte) = self.out.get_mut(self.bits / 8) {
                let mask = 0x80 >> (self.bits % 8);
                if bits >> bit & 1 == 1 {
                    *byte |= mask
                } else {
                    *byte &= !mask
                }
                self.bits += 1;
            }
        }
    }
}

/// Packs as many of the first pixels as fit into `out`. Returns their number, and the bytes used.
pub fn pack(pixels: &[u16], out: &mut [u8]) -> (usize, usize) {
    let mut writer = Writer { out, bits: 0 };
    let (mut before, mut packed) = (0u16, 0);
    for block in pixels.chunks(BLOCK) {
        let total = |k: u32| {
            let costs = block.iter().scan(before, |before, pixel| {
                Some(cost(fold(pixel.wrapping_sub(core::mem::replace(before, *pixel))), k))
            });
            costs.sum::<u32>()
        };
        let k = (0..16).min_by_key(|k| total(*k)).unwrap_or(0);
        if !writer.fits(K_BITS) {
            break;
        }
        writer.put(k, K_BITS);
        for pixel in block {
            let folded = fold(pixel.wrapping_sub(before));
            if !writer.fits(cost(folded, k)) {
                return (packed, writer.bits.div_ceil(8));
            }
            let ones = u32::from(folded >> k);
            if ones < ESCAPE {
                // The ones and a zero.
                writer.put((1 << (ones + 1)) - 2, ones + 1);
                writer.put(u32::from(folded), k);
            } else {
                writer.put((1 << ESCAPE) - 1, ESCAPE);
                writer.put(folded.into(), 16);
            }
            before = *pixel;
            packed += 1;
        }
    }
    (packed, writer.bits.div_ceil(8))
}

/// Unpacks the pixels of a packet.
#[derive(Clone, Debug)]
pub struct Unpacker<'a> {
    bytes: core::slice::Iter<'a, u8>,
    /// Bits that were read ahead, at the high end.
    ahead: u64,
    /// Their number.
    count: u32,
    k: u32,
    /// Pixels until the next block.
    left: usize,
    before: u16,
}

impl<'a> Unpacker<'a> {
    /// Of the bytes that [`pack`] has written.
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { bytes: bytes.iter(), ahead: 0, count: 0, k: 0, left: 0, before: 0 }
    }

    fn fill(&mut self) {
        while self.count <= 56 {
            let Some(byte) = self.bytes.next() else { return };
            self.ahead |= u64::from(*byte) << (56 - self.count);
            self.count += 8;
        }
    }

    /// The next bits, at most 16.
    fn take(&mut self, count: u32) -> Option<u16> {
        self.count = self.count.checked_sub(count)?;
        let bits = self.ahead >> 48 >> (16 - count);
        self.ahead <<= count;
        Some(bits as u16)
    }
}

impl Iterator for Unpacker<'_> {
    type Item = u16;

    /// The next pixel; `None` where the bytes end.
    fn next(&mut self) -> Option<u16> {
        // A block's four bits, 24 ones and 16 bits are 44: one filling is enough.
        self.fill();
        if self.left == 0 {
            (self.left, self.k) = (BLOCK, self.take(K_BITS)?.into());
        }
        self.left -= 1;
        let ones = self.ahead.leading_ones().min(ESCAPE);
        let folded = if ones < ESCAPE {
            self.count = self.count.checked_sub(ones + 1)?;
            self.ahead <<= ones + 1;
            let low = self.take(self.k)?;
            // Bytes that no packer writes may have more ones than a pixel has bits: what is above them is lost.
            ((ones << self.k) as u16) | low
        } else {
            self.count = self.count.checked_sub(ESCAPE)?;
            self.ahead <<= ESCAPE;
            self.take(16)?
        };
        self.before = self.before.wrapping_add(unfold(folded));
        Some(self.before)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use proptest::prelude::*;
    use std::vec;
    use std::vec::Vec;

    /// Packs a frame into packets of `len` bytes and unpacks it. Returns the bytes that were used.
    fn there_and_back(pixels: &[u16], len: usize) -> usize {
        let (mut at, mut used) = (0, 0);
        while at < pixels.len() {
            let mut out = vec![0xaa; len];
            let (packed, bytes) = pack(&pixels[at..], &mut out);
            assert!(packed > 0 && bytes <= len);
            let back: Vec<u16> = Unpacker::new(&out[..bytes]).take(packed).collect();
            assert_eq!(back, pixels[at..at + packed]);
            (at, used) = (at + packed, used + bytes);
        }
        used
    }

    proptest! {
        #[test]
        fn pixels_come_back_as_they_were(
            pixels in prop::collection::vec(prop_oneof![any::<u16>(), 90u16..110, Just(0u16), Just(u16::MAX)], 0..600),
            len in 8usize..300
        ) {
            there_and_back(&pixels, len);
        }

        #[test]
        fn any_bytes_end_and_give_at_most_a_pixel_a_bit(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
            prop_assert!(Unpacker::new(&bytes).count() <= 8 * bytes.len());
        }
    }

    #[test]
    fn differences_fold_and_unfold() {
        assert_eq!([0u16, 0xffff, 1, 0xfffe, 0x7fff, 0x8000].map(fold), [0, 1, 2, 3, 0xfffe, 0xffff]);
        assert!((0..=u16::MAX).all(|difference| unfold(fold(difference)) == difference));
    }

    #[test]
    fn even_light_takes_about_a_bit_a_pixel_and_noise_its_entropy() {
        assert!(there_and_back(&[1000; 6400], 2048) < 6400 / 8 + 6400 / 64 + 8);
        // A uniform difference of 5 bits takes about 7: the entropy of the difference of two such is 5.7.
        let noise: Vec<u16> = (0u32..6400).map(|i| 1000 + (i.wrapping_mul(2_654_435_761) >> 27) as u16).collect();
        let bits = 8 * there_and_back(&noise, 2048);
        assert!((5 * 6400..7 * 6400).contains(&bits), "{bits}");
    }
}
