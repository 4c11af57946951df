//! Offset and response of each pixel.

use super::MapShapeError;
use ndarray::{Array2, ArrayViewMut2};

/// What calibration knows of single pixels; each map is [sensor rows, sensor cols], and None where nothing is known.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SensorMaps {
    /// Dark signal of each pixel relative to the black level, DN.
    pub offset_dn: Option<Array2<f32>>,
    /// One over the response of each pixel to light, relative to the mean response.
    pub inverse_response: Option<Array2<f32>>,
    /// Pixels whose values mean nothing: telegraph noise, hot, dead. [`SensorMaps::correct`] does not change them; the
    /// bead scan replaces them by the mean of their neighbours.
    pub unusable: Option<Array2<bool>>,
}

impl SensorMaps {
    /// Checks that every map has the `shape` of the sensor, [rows, cols].
    ///
    /// # Errors
    /// [`MapShapeError`] with the name of the first map that has another shape.
    pub fn check(&self, shape: [usize; 2]) -> Result<(), MapShapeError> {
        let shapes = [
            ("offset_dn", self.offset_dn.as_ref().map(Array2::dim)),
            ("inverse_response", self.inverse_response.as_ref().map(Array2::dim)),
            ("unusable", self.unusable.as_ref().map(Array2::dim)),
        ];
        for (map, (rows, cols)) in shapes.into_iter().filter_map(|(map, dim)| Some((map, dim?))) {
            if [rows, cols] != shape {
                return Err(MapShapeError { map, expected: shape, found: [rows, cols] });
            }
        }
        Ok(())
    }

    /// Corrects light above black in place, DN, [sensor rows, sensor cols]: `(light - offset) * inverse_response`.
    ///
    /// # Panics
    /// A map has another shape than the frame; [`SensorMaps::check`] reports that first.
    pub fn correct(&self, mut light_dn: ArrayViewMut2<'_, f32>) {
        if let Some(offset) = &self.offset_dn {
            light_dn -= offset;
        }
        if let Some(inverse) = &self.inverse_response {
            light_dn *= inverse;
        }
    }
}
