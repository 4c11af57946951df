//! What every method but the network does to a raw frame first: check it and take the dark signal away.

use super::MethodError;
use crate::instrument::Instrument;
use ndarray::{Array2, ArrayView2};

/// Black level and fixed pattern of one sensor.
#[derive(Clone, Debug)]
pub struct FrameCorrection {
    black_level_dn: f32,
    offset_dn: Option<Array2<f32>>,
    shape: (usize, usize),
}

impl FrameCorrection {
    /// The correction that calibration found.
    pub fn new(instrument: &Instrument) -> Self {
        let sensor = &instrument.manifest.sensor;
        Self {
            black_level_dn: instrument.noise.black_level_dn as f32,
            offset_dn: instrument.offset_dn.clone(),
            shape: (sensor.rows, sensor.cols),
        }
    }

    /// Light above black, DN, of a raw frame, DN, both [sensor rows, sensor cols]. Noise may make it negative.
    ///
    /// # Errors
    /// The frame has another shape or holds values that are no numbers.
    pub fn light_dn(&self, frame_dn: ArrayView2<'_, f32>) -> Result<Array2<f32>, MethodError> {
        if frame_dn.dim() != self.shape {
            return Err(MethodError::FrameShape { expected: self.shape, found: frame_dn.dim() });
        }
        if let Some(((row, col), &found)) = frame_dn.indexed_iter().find(|(_, v)| !v.is_finite()) {
            return Err(MethodError::NotFinite { row, col, found });
        }
        let light = frame_dn.mapv(|v| v - self.black_level_dn);
        Ok(match &self.offset_dn {
            Some(offset) => light - offset,
            None => light,
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::testing::instrument;
    use super::*;

    #[test]
    fn black_level_and_fixed_pattern_go() {
        let mut instrument = instrument(1, [20, 30], [10, 10]);
        let pattern = Array2::from_shape_fn((20, 30), |(r, c)| (r as f32 - c as f32) * 0.125);
        instrument.offset_dn = Some(pattern.clone());
        let frame = pattern + 64.0 + 5.0;
        let light = FrameCorrection::new(&instrument).light_dn(frame.view()).unwrap();
        assert!(light.iter().all(|&v| v == 5.0));
    }

    #[test]
    fn bad_frames_are_refused() {
        let correction = FrameCorrection::new(&instrument(1, [20, 30], [10, 10]));
        let wrong = correction.light_dn(Array2::zeros((30, 20)).view()).unwrap_err();
        assert!(matches!(wrong, MethodError::FrameShape { expected: (20, 30), found: (30, 20) }));
        let mut frame = Array2::zeros((20, 30));
        frame[[1, 2]] = f32::NAN;
        assert!(matches!(correction.light_dn(frame.view()), Err(MethodError::NotFinite { row: 1, col: 2, .. })));
    }
}
