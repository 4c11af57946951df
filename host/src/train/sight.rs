//! What the network sees of a raw frame.

use super::checkpoint::{Body, SensorMaps};
use super::source::normalise;
use crate::methods::MethodError;
use ndarray::ArrayView2;

/// The corrections that come before the network: `x = (frame - black - offset) * inverse_gain`, divided by its maximum.
#[derive(Clone, Debug)]
pub struct Sight {
    black_level_dn: f32,
    maps: SensorMaps,
    frame: (usize, usize),
}

impl Sight {
    /// The corrections of a checkpoint.
    pub fn new(body: &Body, maps: &SensorMaps) -> Self {
        let [rows, cols] = body.network.frame;
        Self { black_level_dn: body.noise.black_level_dn as f32, maps: maps.clone(), frame: (rows, cols) }
    }

    /// Checks a frame.
    ///
    /// # Errors
    /// It has the wrong shape or holds values that are no numbers.
    pub fn check(&self, frame_dn: ArrayView2<'_, f32>) -> Result<(), MethodError> {
        if frame_dn.dim() != self.frame {
            return Err(MethodError::FrameShape { expected: self.frame, found: frame_dn.dim() });
        }
        match frame_dn.indexed_iter().find(|(_, v)| !v.is_finite()) {
            Some(((row, col), &found)) => Err(MethodError::NotFinite { row, col, found }),
            None => Ok(()),
        }
    }

    /// A frame that [`Sight::check`] has accepted, as the network sees it, in C order.
    pub fn normalised(&self, frame_dn: ArrayView2<'_, f32>) -> Vec<f32> {
        let mut light: Vec<f32> = frame_dn.iter().map(|v| v - self.black_level_dn).collect();
        self.maps.correct(&mut light);
        normalise(&light)
    }
}
