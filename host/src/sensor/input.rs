//! Raw frames in, checked and corrected light out.

use super::{FrameError, MapShapeError, SensorMaps};
use ndarray::{Array2, ArrayView2};

/// The raw frames that one sensor delivers: their shape, black level and maps.
#[derive(Clone, Debug)]
pub struct FrameInput {
    black_level_dn: f32,
    maps: SensorMaps,
    shape: [usize; 2],
}

impl FrameInput {
    /// Frames of `shape` [rows, cols] with a black level, DN, that are corrected with `maps`.
    ///
    /// # Errors
    /// A map has another shape than the frames.
    pub fn new(black_level_dn: f64, maps: SensorMaps, shape: [usize; 2]) -> Result<Self, MapShapeError> {
        maps.check(shape)?;
        Ok(Self { black_level_dn: black_level_dn as f32, maps, shape })
    }

    /// Rows and columns of the frames.
    pub fn shape(&self) -> [usize; 2] {
        self.shape
    }

    /// Checks a raw frame.
    ///
    /// # Errors
    /// The frame has another shape, or a value is not finite.
    pub fn check(&self, frame_dn: ArrayView2<'_, f32>) -> Result<(), FrameError> {
        check_shape(frame_dn, self.shape)?;
        match frame_dn.indexed_iter().find(|(_, v)| !v.is_finite()) {
            Some(((row, col), &found)) => Err(FrameError::NotFinite { row, col, found }),
            None => Ok(()),
        }
    }

    /// Light above black, DN on pixels of mean response, of a raw frame, DN; both [rows, cols]. Noise can make it
    /// negative.
    ///
    /// # Errors
    /// As [`FrameInput::check`].
    pub fn light_dn(&self, frame_dn: ArrayView2<'_, f32>) -> Result<Array2<f32>, FrameError> {
        self.check(frame_dn)?;
        let mut light = frame_dn.mapv(|v| v - self.black_level_dn);
        self.maps.correct(light.view_mut());
        Ok(light)
    }
}

/// Checks that a frame has the expected rows and columns.
pub(super) fn check_shape(frame_dn: ArrayView2<'_, f32>, expected: [usize; 2]) -> Result<(), FrameError> {
    let found = [frame_dn.nrows(), frame_dn.ncols()];
    if found == expected { Ok(()) } else { Err(FrameError::Shape { expected, found }) }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn bad_frames_are_refused() {
        let input = FrameInput::new(64.0, SensorMaps::default(), [20, 30]).unwrap();
        let wrong = input.light_dn(Array2::zeros((30, 20)).view()).unwrap_err();
        assert_eq!(wrong, FrameError::Shape { expected: [20, 30], found: [30, 20] });
        let mut frame = Array2::zeros((20, 30));
        frame[[1, 2]] = f32::NAN;
        assert!(matches!(input.light_dn(frame.view()), Err(FrameError::NotFinite { row: 1, col: 2, .. })));
    }

    #[test]
    fn maps_of_another_sensor_are_refused_by_name() {
        let maps = SensorMaps { inverse_response: Some(Array2::ones((20, 31))), ..SensorMaps::default() };
        let error = FrameInput::new(64.0, maps, [20, 30]).unwrap_err();
        assert_eq!((error.map, error.found), ("inverse_response", [20, 31]));
    }
}
