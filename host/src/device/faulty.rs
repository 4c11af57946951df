//! A line that loses, repeats and flips bytes, for tests and for judging a real one.

use super::{DeviceError, Transport};
use crate::rng;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::time::Duration;

/// How often what happens to a byte.
#[derive(Clone, Copy, Debug)]
pub struct Faults {
    /// Probability that a byte is lost.
    pub lose: f64,
    /// Probability that it comes twice.
    pub repeat: f64,
    /// Probability that one of its bits is flipped.
    pub flip: f64,
    /// Seed of all that happens.
    pub seed: u64,
}

/// A line with faults in both directions.
#[derive(Debug)]
pub struct Faulty<T> {
    line: T,
    faults: Faults,
    rng: ChaCha8Rng,
    /// Bytes that were damaged so far.
    pub damaged: u64,
}

impl<T> Faulty<T> {
    /// Puts faults on a line.
    pub fn new(line: T, faults: Faults) -> Self {
        Self { line, faults, rng: rng::stream(faults.seed, "faulty line", 0), damaged: 0 }
    }

    fn damage(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut out = Vec::with_capacity(bytes.len());
        let Faults { lose, repeat, flip, .. } = self.faults;
        for &byte in bytes {
            let draw: f64 = self.rng.random();
            self.damaged += u64::from(draw < lose + repeat + flip);
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
        let bytes = self.damage(bytes);
        self.line.send(&bytes)
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
