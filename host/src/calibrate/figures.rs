//! Figures of a calibration for tables, and the number of frames that it reads.

use crate::bead::PASSES;
use crate::instrument::Instrument;
use crate::noise::ROUNDING_DN2;
use crate::session::{Role, Session};

/// Number of frame reads of a calibration; beads are read several times.
pub fn frames_read(session: &Session) -> u64 {
    let frames = |role| session.stacks_of(role).map(|s| s.len() as u64).sum::<u64>();
    frames(Role::Dark) + frames(Role::Flat) + PASSES * frames(Role::Bead)
}

/// Distribution of the read noise over the pixels, electrons rms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelReadNoise {
    /// Median.
    pub median_e: f64,
    /// 99th percentile.
    pub p99_e: f64,
    /// Maximum.
    pub max_e: f64,
}

impl PixelReadNoise {
    /// The distribution for an instrument; None if all pixels have one common read noise.
    pub fn of(instrument: &Instrument) -> Option<Self> {
        let mut sorted: Vec<f32> = instrument.reading_dn2.as_ref()?.iter().copied().collect();
        sorted.sort_by(f32::total_cmp);
        let at = |q: f64| {
            let variance = f64::from(sorted[((sorted.len() - 1) as f64 * q) as usize]) - ROUNDING_DN2;
            variance.max(0.0).sqrt() / instrument.noise.gain_dn_per_e
        };
        Some(Self { median_e: at(0.5), p99_e: at(0.99), max_e: at(1.0) })
    }
}

/// Standard deviation of the response of the pixels, relative; None without a response map.
pub fn response_rms(instrument: &Instrument) -> Option<f64> {
    let map = instrument.response.as_ref()?;
    let square: f64 = map.iter().map(|r| (f64::from(*r) - 1.0).powi(2)).sum();
    Some((square / map.len().max(1) as f64).sqrt())
}
