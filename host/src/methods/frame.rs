//! What every method but the network does to a raw frame first: check it, take the dark signal away, and bring all pixels to one
//! response.

use super::MethodError;
use crate::instrument::Instrument;
use ndarray::{Array2, ArrayView2};

/// Black level and fixed patterns of one sensor.
#[derive(Clone, Debug)]
pub struct FrameCorrection {
    black_level_dn: f32,
    offset_dn: Option<Array2<f32>>,
    inverse_response: Option<Array2<f32>>,
    shape: (usize, usize),
}

impl FrameCorrection {
    /// The correction that calibration, and the loop, found.
    pub fn new(instrument: &Instrument) -> Self {
        let sensor = &instrument.manifest.sensor;
        // An instrument whose effects make no sense is refused where it is read or its model planned.
        let tables = instrument.sensor_tables().unwrap_or_default();
        Self {
            black_level_dn: instrument.noise.black_level_dn as f32,
            offset_dn: tables.offset_dn,
            inverse_response: tables.inverse_response,
            shape: (sensor.rows, sensor.cols),
        }
    }

    /// Light above black, DN on pixels of mean response, of a raw frame, DN, both [sensor rows, sensor cols]. Noise may make it negative.
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
        let mut light = frame_dn.mapv(|v| v - self.black_level_dn);
        if let Some(offset) = &self.offset_dn {
            light -= offset;
        }
        if let Some(inverse) = &self.inverse_response {
            light *= inverse;
        }
        Ok(light)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::testing::square_array as instrument;

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
    fn unlike_pixels_become_alike_and_a_dead_one_is_left() {
        let mut instrument = instrument(1, [20, 30], [10, 10]);
        let mut response = Array2::from_shape_fn((20, 30), |(r, _)| if r % 2 == 0 { 0.8 } else { 1.25 });
        response[[3, 3]] = 0.0;
        let mut frame = response.mapv(|r| 64.0 + 100.0 * r);
        frame[[3, 3]] = 64.0;
        instrument.response = Some(response);
        let light = FrameCorrection::new(&instrument).light_dn(frame.view()).unwrap();
        assert!(light.indexed_iter().all(|(at, v)| (v - if at == (3, 3) { 0.0 } else { 100.0 }).abs() < 1e-4));
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
