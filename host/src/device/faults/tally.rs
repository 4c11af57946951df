//! Counts of what became of one kind of fault.

use serde::Serialize;

/// The outcome of one kind of fault.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Row {
    /// The fault.
    pub fault: String,
    /// How it was injected.
    pub how: String,
    /// How often it was injected.
    pub tried: u64,
    /// How often the device or the host noticed it.
    pub seen: u64,
    /// Lost networks: no network runs, or another one than the one whose commit was acknowledged.
    pub blobs_lost: u64,
    /// Frames that could not be reconstructed afterwards.
    pub frames_lost: u64,
    /// Reconstructions that differ from the host's in any bit.
    pub wrong: u64,
}

/// Counts of one kind of fault.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Tally {
    pub tried: u64,
    pub seen: u64,
    pub blobs_lost: u64,
    pub frames_lost: u64,
    pub wrong: u64,
}

impl Tally {
    pub fn try_one(&mut self, seen: bool) {
        self.tried += 1;
        self.seen += u64::from(seen);
    }

    pub fn add(&mut self, other: Self) {
        self.blobs_lost += other.blobs_lost;
        self.frames_lost += other.frames_lost;
        self.wrong += other.wrong;
    }

    pub fn row(self, fault: &str, how: &str) -> Row {
        let Self { tried, seen, blobs_lost, frames_lost, wrong } = self;
        Row { fault: fault.into(), how: how.into(), tried, seen, blobs_lost, frames_lost, wrong }
    }
}
