//! `session.toml`: what was measured, with which sizes, in which files.

use serde::{Deserialize, Serialize};

/// Name of the manifest in a session's folder.
pub const MANIFEST: &str = "session.toml";

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
    /// Nominal optics: magnification and PSF window.
    pub optics: Optics,
    /// Pixel grid of objects, truths and reconstructions.
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
    /// Bits of the analogue-to-digital converter; the saturation level is `2^bit_depth - 1` DN.
    pub bit_depth: u32,
}

impl SensorSpec {
    /// The highest code of the converter, `2^bit_depth - 1`, DN.
    pub fn saturation_dn(&self) -> f64 {
        (2f64).powi(self.bit_depth as i32) - 1.0
    }
}

/// The microlens array, with lenses numbered row by row, or in the order of `lenses_px`.
///
/// ```
/// use ommatidia_session::{ArrayGeometry, SensorSpec};
///
/// let sensor = SensorSpec { rows: 101, cols: 101, pixel_pitch_um: 2.0, bit_depth: 12 };
/// let grid = ArrayGeometry::grid(1, 2, 40.0);
/// assert_eq!(grid.places_px(&sensor), [[50.0, 30.0], [50.0, 70.0]]);
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ArrayGeometry {
    /// Rows of lenses.
    pub rows: usize,
    /// Columns of lenses.
    pub cols: usize,
    /// Nominal distance of neighbouring chief rays on the sensor, sensor pixels.
    pub pitch_px: f64,
    /// Nominal focus (row, col) of each lens for a source on the axis, sensor pixels. None: the lenses form a grid that
    /// is centred on the sensor.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lenses_px: Option<Vec<[f64; 2]>>,
}

impl ArrayGeometry {
    /// A grid of lenses.
    pub fn grid(rows: usize, cols: usize, pitch_px: f64) -> Self {
        Self { rows, cols, pitch_px, lenses_px: None }
    }

    /// Number of lenses.
    pub fn lenses(&self) -> usize {
        self.rows * self.cols
    }

    /// Nominal focus (row, col) of each lens for a source on the axis, sensor pixels.
    pub fn places_px(&self, sensor: &SensorSpec) -> Vec<[f64; 2]> {
        if let Some(places) = &self.lenses_px {
            return places.clone();
        }
        let along = |k: usize, lenses: usize, pixels: usize| {
            (pixels as f64 - 1.0) / 2.0 + (k as f64 - (lenses as f64 - 1.0) / 2.0) * self.pitch_px
        };
        let lens =
            |l: usize| [along(l / self.cols, self.rows, sensor.rows), along(l % self.cols, self.cols, sensor.cols)];
        (0..self.lenses()).map(lens).collect()
    }

    /// The lenses in words: `3 x 3 lenses`, or `7 lenses` that have places of their own.
    pub fn words(&self) -> String {
        match (&self.lenses_px, self.lenses()) {
            (_, 1) => "one lens".into(),
            (None, _) => format!("{} x {} lenses", self.rows, self.cols),
            (Some(_), n) => format!("{n} lenses"),
        }
    }

    /// The name of lens `l` in words: its row and column, counted from 1, or its number where the lenses form no grid.
    pub fn lens_name(&self, l: usize) -> String {
        match self.lenses_px {
            None => format!("{}, {}", l / self.cols.max(1) + 1, l % self.cols.max(1) + 1),
            Some(_) => (l + 1).to_string(),
        }
    }
}

/// Nominal properties of the optics.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Optics {
    /// Nominal magnification: image size over object size.
    pub magnification: f64,
    /// Side of the square window that holds one focus, sensor pixels; odd.
    pub psf_window_px: usize,
    /// Mean wavelength of the light, um. `None`: not stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wavelength_um: Option<f64>,
}

/// The pixel grid of objects, truths and reconstructions.
///
/// Object pixel (r, c) lies at stage position `y_um = (r - (rows-1)/2) * pixel_um`, `x_um = (c - (cols-1)/2) *
/// pixel_um`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectGrid {
    /// Rows, object pixels.
    pub rows: usize,
    /// Columns, object pixels.
    pub cols: usize,
    /// Side of an object pixel, um: pixel pitch over magnification, so that one object pixel maps to one sensor pixel.
    pub pixel_um: f64,
}

impl ObjectGrid {
    /// Fractional object pixel [row, col] at the stage position (`y_um`, `x_um`), um; the origin is the grid's centre.
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
    /// A point source scanned over the field, one frame for each position.
    Bead,
    /// Specimens.
    Scene,
}

/// One stack of frames, as the manifest lists it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StackEntry {
    /// What its frames show.
    pub role: Role,
    /// File of the frames relative to the session's folder, [frames, rows, cols], DN.
    pub file: String,
    /// Name of the array in a .mat file that holds more than one; none for other files.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub variable: Option<String>,
    /// Exposure of each frame for which the table gives no other, ms.
    pub exposure_ms: f64,
    /// CSV table with one row for each frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub table: Option<String>,
    /// File of the known object of each frame: float32, [frames, object rows, object cols], in one unit for the stack.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub truth: Option<String>,
    /// Standard deviation of the place of the truth, object pixels: how well the camera that took it is registered to
    /// the instrument. 0: exact.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub truth_registration_px: f64,
    /// Whether each frame's truth has a registration of its own; else the whole stack shares one.
    #[serde(default, skip_serializing_if = "is_false")]
    pub truth_registration_per_frame: bool,
    /// File of the noise-free expectation of each frame: float32, [frames, rows, cols], DN. Only virtual instruments
    /// provide it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expected: Option<String>,
}

impl StackEntry {
    /// A stack of frames with a common exposure in ms, without a table, truths or expectations.
    pub fn plain(role: Role, file: impl Into<String>, exposure_ms: f64) -> Self {
        Self {
            role,
            file: file.into(),
            variable: None,
            exposure_ms,
            table: None,
            truth: None,
            truth_registration_px: 0.0,
            truth_registration_per_frame: false,
            expected: None,
        }
    }
}

fn is_zero(v: &f64) -> bool {
    *v == 0.0
}

fn is_false(v: &bool) -> bool {
    !v
}
