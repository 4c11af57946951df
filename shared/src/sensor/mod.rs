//! The sensor's fixed pattern: applied and corrected side by side.
//!
//! `code = clamp(round(signal / inverse_gain + offset + black))`, `signal = ((code - black) - offset) * inverse_gain`, all in DN,
//! pixel by pixel. `offset` is relative to the black level; `inverse_gain` is 1 for a nominal pixel and **0 for a defect one**,
//! which then reads as dark. The corrected signal may be negative: read noise is not clipped.

mod pattern;

pub use pattern::FixedPattern;
