//! Why a raw frame or a map of a sensor cannot be used.

use thiserror::Error;

/// Why a raw frame cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum FrameError {
    /// The frame has another shape than the sensor.
    #[error(
        "raw frame: expected {} x {} pixels (rows x columns), found {} x {}; use frames of the instrument that the \
         file was made for",
        expected[0], expected[1], found[0], found[1]
    )]
    Shape {
        /// Rows and columns of the sensor.
        expected: [usize; 2],
        /// Rows and columns of the frame.
        found: [usize; 2],
    },
    /// A pixel is infinite or not a number.
    #[error("raw frame, row {row}, column {col}: expected a finite value, found {found}; record the frame again")]
    NotFinite {
        /// Row of the pixel.
        row: usize,
        /// Column of the pixel.
        col: usize,
        /// Its value, DN.
        found: f32,
    },
    /// A pixel is not a code that a sensor can deliver.
    #[error(
        "raw frame, row {row}, column {col}: expected a sensor code from 0 to 65535 DN, found {found}; give frames as \
         the sensor delivers them, with nothing subtracted or scaled"
    )]
    Code {
        /// Row of the pixel.
        row: usize,
        /// Column of the pixel.
        col: usize,
        /// Its value, DN.
        found: f32,
    },
}

/// A map of the sensor has another shape than the sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error(
    "sensor map `{map}`: expected {} x {} pixels (rows x columns), found {} x {}; calibrate the instrument again",
    expected[0], expected[1], found[0], found[1]
)]
pub struct MapShapeError {
    /// Name of the map.
    pub map: &'static str,
    /// Rows and columns of the sensor.
    pub expected: [usize; 2],
    /// Rows and columns of the map.
    pub found: [usize; 2],
}
