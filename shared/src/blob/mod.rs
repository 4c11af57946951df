//! The network file: magic, version, schema key, postcard header, aligned little-endian weight sections, CRC.

mod header;

pub use header::{Bank, Header, MAX_TAPS, MemoryPlan, Rcan, Sensor, Size, Tap, Weights};
