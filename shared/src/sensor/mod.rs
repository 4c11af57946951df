//! The fixed pattern of the sensor: its correction, and the same pattern applied to a signal.
//!
//! ```text
//! signal = ((code - black) - offset) * inverse_gain
//! code   = clamp(round(signal / inverse_gain + offset + black))
//! ```
//! in DN, pixel by pixel. `offset` is relative to the black level. `inverse_gain` is 1 for a nominal pixel and **0 for
//! a defective one**, whose corrected signal is then 0. The corrected signal may be negative: read noise is not
//! clipped.
//!
//! ```
//! use ommatidia_shared::num::f16;
//! use ommatidia_shared::sensor::FixedPattern;
//!
//! let (offset, gain) = ([0.0, 2.0, 0.0].map(f16::from_f32), [1.0, 0.5, 0.0].map(f16::from_f32));
//! let pattern = FixedPattern {
//!     black_level_dn: 64.0,
//!     saturation_dn: 1023,
//!     cols: 3,
//!     offset_dn: Some(&offset),
//!     inverse_gain: Some(&gain),
//! };
//! let mut signal_dn = [0.0; 3];
//! pattern.correct(0, 0, &[60, 166, 1023], &mut signal_dn);
//! assert_eq!(signal_dn, [-4.0, 50.0, 0.0], "below black, corrected, defective");
//!
//! let mut codes = [0; 3];
//! pattern.apply(0, 0, &signal_dn, &mut codes);
//! assert_eq!(codes, [60, 166, 64]);
//! ```

mod pattern;

pub use pattern::FixedPattern;
