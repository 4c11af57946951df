//! `session.toml`: what was measured, with which sizes, in which files.

use serde::{Deserialize, Serialize};

/// The manifest of a session, format 1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Version of the session format: 1.
    pub format: u32,
    /// Name that the user gave the session.
    pub name: String,
    /// The image sensor.
    pub sensor: SensorSpec,
    /// The microlens array.
    pub array: ArrayGeometry,
    /// What the optics were designed to.
    pub optics: Optics,
    /// The grid of objects, truths and reconstructions.
    pub object: ObjectGrid,
    /// The stacks of frames, in the order of the file.
    #[serde(default, rename = "stack", skip_serializing_if = "Vec::is_empty")]
    pub stacks: Vec<StackEntry>,
}

/// The image sensor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorSpec {
    /// Rows of a frame, pixels.
    pub rows: usize,
    /// Columns of a frame, pixels.
    pub cols: usize,
    /// Pixel pitch on the sensor, um.
    pub pixel_pitch_um: f64,
    /// Bits of the converter; the saturation level is `2^bit_depth - 1` DN.
    pub bit_depth: u32,
}

impl SensorSpec {
    /// The highest code, DN.
    pub fn saturation_dn(&self) -> f64 {
        (2f64).powi(self.bit_depth as i32) - 1.0
    }
}

/// The microlens array.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ArrayGeometry {
    /// Rows of lenses.
    pub rows: usize,
    /// Columns of lenses.
    pub cols: usize,
    /// Nominal distance of neighbouring chief rays on the sensor, sensor pixels.
    pub pitch_px: f64,
}

impl ArrayGeometry {
    /// Number of lenses.
    pub fn lenses(&self) -> usize {
        self.rows * self.cols
    }
}

/// What the optics were designed to.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Optics {
    /// Nominal magnification, image per object.
    pub magnification: f64,
    /// Side of the window that holds one focus, sensor pixels; odd.
    pub psf_window_px: usize,
}

/// The grid that objects, truths and reconstructions live on.
///
/// Object pixel (r, c) lies at stage position `y_um = (r - (rows-1)/2) * pixel_um`, `x_um = (c - (cols-1)/2) * pixel_um`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectGrid {
    /// Rows, object pixels.
    pub rows: usize,
    /// Columns, object pixels.
    pub cols: usize,
    /// Side of an object pixel, um: pixel pitch / magnification, so that it maps to one sensor pixel.
    pub pixel_um: f64,
}

impl ObjectGrid {
    /// Fractional object pixel (row, col) of a stage position (y, x) in um.
    pub fn pixel_of_um(&self, y_um: f64, x_um: f64) -> [f64; 2] {
        [y_um / self.pixel_um + (self.rows as f64 - 1.0) / 2.0, x_um / self.pixel_um + (self.cols as f64 - 1.0) / 2.0]
    }
}

/// What the frames of a stack show.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// No light.
    Dark,
    /// Even light.
    Flat,
    /// A point source scanned over the field, one frame a position.
    Bead,
    /// Specimens.
    Scene,
}

/// One stack of frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StackEntry {
    /// What its frames show.
    pub role: Role,
    /// The frames: .npy or .tif/.tiff, [frames, rows, cols], DN; relative to the session's folder.
    pub file: String,
    /// Exposure of each frame, ms, where the table gives no other.
    pub exposure_ms: f64,
    /// CSV table with one row a frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub table: Option<String>,
    /// Known object of each frame, float32 [frames, object rows, object cols], in a unit common to the stack.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub truth: Option<String>,
    /// Noise-free expectation of each frame, float32 [frames, rows, cols], DN: only a virtual instrument knows it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expected: Option<String>,
}
