//! What is fuzzed: each module takes arbitrary bytes and panics where its claim does not hold.
//!
//! The programs in `fuzz_targets` give them libFuzzer's inputs. `tests/narrow.rs` gives them the same seeds, and
//! mutations of these, in a build of 32 bits, which libFuzzer does not have on every machine.

pub mod blob;
pub mod device;
pub mod recording;
pub mod session;
pub mod wire;
