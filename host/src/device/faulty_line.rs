//! A line with injected faults: lost, repeated and flipped bytes, repeated packets, interruptions.

use super::error::DeviceError;
use super::transport::Transport;
use crate::rng;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::time::Duration;

/// Probabilities of the faults of a line; all zero by default.
#[derive(Clone, Copy, Debug, Default)]
pub struct LineFaults {
    /// Probability that a byte is lost.
    pub lose: f64,
    /// Probability that a byte is repeated.
    pub repeat: f64,
    /// Probability that one bit of a byte is flipped.
    pub flip: f64,
    /// Probability that a whole packet is sent twice, as by a bridge that retransmits.
    pub resend: f64,
    /// Probability, per byte, that an interruption begins.
    pub outage: f64,
    /// Bytes that are lost in an interruption.
    pub outage_bytes: u32,
    /// Seed of all random draws.
    pub seed: u64,
}

/// A line with faults in both directions.
#[derive(Debug)]
pub struct FaultyLine<T> {
    line: T,
    kinds: LineFaults,
    rng: ChaCha8Rng,
    /// Bytes until the interruption ends.
    away: u32,
    /// Damaged bytes and repeated packets so far.
    pub damaged: u64,
    /// As `damaged`, but each interruption counts once.
    pub faults: u64,
}

impl<T> FaultyLine<T> {
    /// Adds faults to a line.
    pub fn new(line: T, kinds: LineFaults) -> Self {
        Self { line, kinds, rng: rng::stream(kinds.seed, "faulty line", 0), away: 0, damaged: 0, faults: 0 }
    }

    fn damage(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut out = Vec::with_capacity(bytes.len());
        let LineFaults { lose, repeat, flip, outage, outage_bytes, .. } = self.kinds;
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

impl<T: Transport> Transport for FaultyLine<T> {
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
