//! A line that loses, repeats and flips bytes, repeats packets and goes away, for tests and for judging a real one.

use super::{DeviceError, Transport};
use crate::rng;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::time::Duration;

/// How often what happens to a byte.
#[derive(Clone, Copy, Debug, Default)]
pub struct Faults {
    /// Probability that a byte is lost.
    pub lose: f64,
    /// Probability that it comes twice.
    pub repeat: f64,
    /// Probability that one of its bits is flipped.
    pub flip: f64,
    /// Probability that what is sent at once is sent twice, as by a bridge that retransmits on its own.
    pub resend: f64,
    /// Probability that the line goes away at a byte.
    pub outage: f64,
    /// Bytes that are lost until it is back.
    pub outage_bytes: u32,
    /// Seed of all that happens.
    pub seed: u64,
}

/// A line with faults in both directions.
#[derive(Debug)]
pub struct Faulty<T> {
    line: T,
    kinds: Faults,
    rng: ChaCha8Rng,
    /// Bytes until the line is back.
    away: u32,
    /// Bytes that were damaged so far, and packets sent twice.
    pub damaged: u64,
    /// The same, with each time that the line was away counted once.
    pub faults: u64,
}

impl<T> Faulty<T> {
    /// Puts faults on a line.
    pub fn new(line: T, kinds: Faults) -> Self {
        Self { line, kinds, rng: rng::stream(kinds.seed, "faulty line", 0), away: 0, damaged: 0, faults: 0 }
    }

    fn damage(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut out = Vec::with_capacity(bytes.len());
        let Faults { lose, repeat, flip, outage, outage_bytes, .. } = self.kinds;
        for &byte in bytes {
            if self.away > 0 {
                self.away -= 1;
                self.damaged += 1;
                continue;
            }
            if outage > 0.0 && self.rng.random_bool(outage) {
                self.away = outage_bytes;
                self.faults += 1;
            }
            let draw: f64 = self.rng.random();
            self.damaged += u64::from(draw < lose + repeat + flip);
            self.faults += u64::from(draw < lose + repeat + flip);
            if draw < lose {
                continue;
            }
            out.push(byte);
            if draw < lose + repeat {
                out.push(byte);
            } else if draw < lose + repeat + flip
                && let Some(last) = out.last_mut()
            {
                *last ^= 1 << self.rng.random_range(0..8);
            }
        }
        out
    }
}

impl<T: Transport> Transport for Faulty<T> {
    fn send(&mut self, bytes: &[u8]) -> Result<(), DeviceError> {
        let twice = self.kinds.resend > 0.0 && self.rng.random_bool(self.kinds.resend);
        if twice {
            self.damaged += 1;
            self.faults += 1;
            let bytes = self.damage(bytes);
            self.line.send(&bytes)?;
        }
        let bytes = self.damage(bytes);
        self.line.send(&bytes)
    }

    fn silent(&self) -> bool {
        self.line.silent()
    }

    fn receive(&mut self, buffer: &mut [u8], patience: Duration) -> Result<usize, DeviceError> {
        // Repeated bytes need room: ask for half of what there is.
        let half = buffer.len() / 2;
        let count = self.line.receive(&mut buffer[..half], patience)?;
        let bytes = self.damage(&buffer[..count]);
        buffer[..bytes.len()].copy_from_slice(&bytes);
        Ok(bytes.len())
    }

    fn answer_len(&self) -> usize {
        self.line.answer_len()
    }
}
