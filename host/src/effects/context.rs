//! What a hook is told of the frame and of the ray that it acts on.

use crate::session::Role;
use ndarray::Array2;

/// What is known of the frame that is being formed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameContext<'a> {
    /// What it shows: specimens, a bead, even light, none.
    pub role: Role,
    /// Index in its stack.
    pub frame: usize,
    /// When the exposure began, s.
    pub time_s: f64,
    /// Exposure, ms.
    pub exposure_ms: f64,
    /// Relative light level.
    pub illumination: f64,
    /// Temperature of the sensor, degrees C; 20 where it was not measured.
    pub temperature_c: f64,
    /// Lens whose image is being formed (stages `Geometry` and `Lens` only), counted row by row.
    pub lens: usize,
    /// Rows and columns of lenses.
    pub array: [usize; 2],
    /// Foci of the on-axis source, sensor pixels, one a lens.
    pub anchors_px: &'a [[f64; 2]],
    /// Full scale of the converter above the black level, electrons.
    pub full_scale_e: f64,
    /// Mean signal without light, DN.
    pub black_level_dn: f64,
    /// Conversion gain, DN per electron.
    pub gain_dn_per_e: f64,
    /// The frame before this one: None for the first of a stack.
    pub previous: Option<Previous<'a>>,
}

/// The frame that was read before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Previous<'a> {
    /// Its light, expected electrons.
    pub light_e: &'a Array2<f32>,
    /// From the start of its exposure to the start of this one, s.
    pub interval_s: f64,
}

impl Default for FrameContext<'_> {
    fn default() -> Self {
        Self {
            role: Role::Scene,
            frame: 0,
            time_s: 0.0,
            exposure_ms: 0.0,
            illumination: 1.0,
            temperature_c: 20.0,
            lens: 0,
            array: [1, 1],
            anchors_px: &[],
            full_scale_e: 0.0,
            black_level_dn: 0.0,
            gain_dn_per_e: 1.0,
            previous: None,
        }
    }
}

/// The chief ray of one source through one lens. Pairs are (row, col).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ray {
    /// Lens, counted row by row.
    pub lens: usize,
    /// Source, um from the centre of the object.
    pub object_um: [f64; 2],
    /// Focus relative to the lens's anchor (the focus of the on-axis source), sensor px.
    pub field_px: [f64; 2],
    /// Focus relative to where the lens's own axis meets the sensor, sensor px.
    pub axis_px: [f64; 2],
    /// The lens's anchor relative to the centre of the array, sensor px.
    pub anchor_px: [f64; 2],
    /// Pixel pitch of the sensor, um.
    pub pixel_pitch_um: f64,
}

/// How an effect moves a source and its focus.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RayShift {
    /// Of the focus, sensor px, (row, col).
    pub px: [f64; 2],
    /// Of the source along the optical axis, um: positive towards larger z of the bead scan.
    pub z_um: f64,
}

impl std::ops::AddAssign for RayShift {
    fn add_assign(&mut self, other: Self) {
        self.px[0] += other.px[0];
        self.px[1] += other.px[1];
        self.z_um += other.z_um;
    }
}

/// What the session says of one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Record {
    /// Frame of the stack whose truth this one shows.
    pub truth: usize,
    /// Frames of the stack.
    pub frames: usize,
    /// The truth is upside down.
    pub flip_rows: bool,
    /// The truth is turned left to right.
    pub flip_cols: bool,
    /// True exposure over the exposure that is written down.
    pub exposure_factor: f64,
}

impl Record {
    /// A record that tells the truth.
    pub fn honest(frame: usize, frames: usize) -> Self {
        Self { truth: frame, frames, flip_rows: false, flip_cols: false, exposure_factor: 1.0 }
    }

    /// The object that is shown, of those that are written down.
    pub fn object(&self, truths: &[Array2<f32>]) -> Option<Array2<f32>> {
        let mut object = truths.get(self.truth)?.clone();
        if self.flip_rows {
            object.invert_axis(ndarray::Axis(0));
        }
        if self.flip_cols {
            object.invert_axis(ndarray::Axis(1));
        }
        Some(object.as_standard_layout().into_owned())
    }
}
