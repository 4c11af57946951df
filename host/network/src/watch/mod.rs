//! Maps with which a device watches its optics ([`ommatidia_shared::watch`]), for a calibrated instrument.
//!
//! [`points`](self) says what each block of the frame receives of a point of the object and how the displacements of
//! lenses change it, `fit` finds the maps, and `judge` measures on simulated specimens what they are worth.

mod error;
mod figures;
mod fit;
mod judge;
mod points;

pub use error::WatchError;
pub use figures::{KindFigures, WatchFigures};

use fit::Fitted;
use ommatidia_model::forward::Forward;
use ommatidia_model::instrument::Instrument;
use ommatidia_shared::blob::{Size, Watching};
use ommatidia_shared::watch::{MAX_BLOCK, MAX_LENSES, MAX_PIXELS, Maps, Statistic, blocks};

/// Largest length of the maps, bytes.
const MOST_BYTES: usize = 60 << 10;
/// Smallest side of a block, pixels.
const LEAST_BLOCK: u8 = 4;
/// False alarms of all statistics together, for each frame.
pub const FALSE_ALARMS: f64 = 1e-6;

/// Maps of an instrument.
#[derive(Clone, Debug, PartialEq)]
pub struct WatchMaps {
    /// Size of a frame, pixels.
    pub frame: Size,
    /// Side of a block, pixels.
    pub block: u8,
    /// Black level, DN.
    pub black_dn: u16,
    /// Frames with less light do not count, DN.
    pub least_light_dn: f32,
    /// Logarithm of the odds against a false alarm: ln(2 J / [`FALSE_ALARMS`]).
    pub log_odds: f32,
    /// Weights, as [`Maps::weights`].
    pub weights: Vec<i16>,
    /// The statistics: displacements of all lenses along the rows, then along the columns, then gains.
    pub statistics: Vec<Statistic>,
}

impl WatchMaps {
    /// Finds the maps of an instrument, and judges them on simulated specimens of `seed`.
    ///
    /// # Errors
    /// The instrument has fewer than three living lenses or more than nine, a frame beyond 2^24 pixels, or cannot be
    /// planned.
    pub fn of(instrument: &Instrument, seed: u64) -> Result<Self, WatchError> {
        let forward = Forward::new(instrument)?;
        let lenses = instrument.geometry.anchors_px.len();
        let living = forward.operator().corners().iter().flatten().count();
        if living < 3 || lenses > MAX_LENSES {
            return Err(WatchError::Lenses { found: living, most: MAX_LENSES });
        }
        let [rows, cols] = forward.operator().sensor_shape();
        let frame = match (u16::try_from(rows), u16::try_from(cols)) {
            (Ok(rows), Ok(cols)) if u64::from(rows) * u64::from(cols) <= MAX_PIXELS => Size { rows, cols },
            _ => return Err(WatchError::Frame { rows, cols, most: MAX_PIXELS }),
        };
        let of_block = size_of::<i16>() * Maps::weights_of_block(3 * lenses);
        let bytes = |side: u8| blocks(frame, side).iter().product::<usize>() * of_block;
        let block = (LEAST_BLOCK..=MAX_BLOCK).find(|side| bytes(*side) <= MOST_BYTES).unwrap_or(MAX_BLOCK);
        let fitted = Fitted::of(instrument, &forward, frame, block)?;
        judge::judged(fitted, instrument, &forward, seed)
    }

    /// What the header of a network file says of the maps, for a network with frames of [rows, cols].
    ///
    /// # Errors
    /// The frames of the instrument have another size.
    pub fn header(&self, frame: [usize; 2]) -> Result<Watching, WatchError> {
        let found = [self.frame.rows.into(), self.frame.cols.into()];
        if found != frame {
            return Err(WatchError::OtherFrame { expected: frame, found });
        }
        Ok(Watching {
            lenses: self.maps().lenses() as u8,
            block: self.block,
            black_dn: self.black_dn,
            least_light_dn: self.least_light_dn,
            log_odds: self.log_odds,
        })
    }

    /// The maps as a device applies them.
    pub fn maps(&self) -> Maps<'_> {
        Maps {
            frame: self.frame,
            block: self.block,
            black_dn: self.black_dn,
            least_light_dn: self.least_light_dn,
            log_odds: self.log_odds,
            weights: &self.weights,
            statistics: &self.statistics,
        }
    }
}

#[cfg(test)]
mod tests;
