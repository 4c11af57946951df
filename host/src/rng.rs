//! Random numbers that depend only on a seed and on the name and index of what is drawn.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use sha2::{Digest, Sha256};

/// The random generator of draw number `index` of `what` under `seed`.
///
/// Each frame, scene or batch has its own generator. Results therefore depend neither on the order of the work nor on
/// the number of threads, and an interrupted run can resume at any point.
///
/// ```
/// use ommatidia_host::rng;
/// use rand::Rng;
/// assert_eq!(rng::stream(7, "dark", 3).next_u64(), rng::stream(7, "dark", 3).next_u64());
/// assert_ne!(rng::stream(7, "dark", 3).next_u64(), rng::stream(7, "flat", 3).next_u64());
/// ```
pub fn stream(seed: u64, what: &str, index: u64) -> ChaCha8Rng {
    let mut hash = Sha256::new();
    hash.update(seed.to_le_bytes());
    hash.update(index.to_le_bytes());
    hash.update(what.as_bytes());
    ChaCha8Rng::from_seed(hash.finalize().into())
}
