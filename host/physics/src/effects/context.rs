//! The frame and the chief ray on which a hook acts.

use ndarray::Array2;
use ommatidia_session::Role;

/// The frame that is being formed: its exposure, the array, and the sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameContext<'a> {
    /// What the frame shows: specimens, a bead, even light, or no light.
    pub role: Role,
    /// Index of the frame in its stack.
    pub frame: usize,
    /// Start of the exposure, s.
    pub time_s: f64,
    /// Exposure, ms.
    pub exposure_ms: f64,
    /// Relative light level.
    pub illumination: f64,
    /// Temperature of the sensor, degrees C; 20 if it was not measured.
    pub temperature_c: f64,
    /// Lens whose image is being formed, counted row by row; stages `Geometry` and `Lens` only.
    pub lens: usize,
    /// Anchors (the foci of the on-axis source), one (row, col) for each lens, sensor pixels.
    pub anchors_px: &'a [[f64; 2]],
    /// Where the axis of each lens meets the sensor, one (row, col) for each lens, sensor pixels.
    pub axes_px: &'a [[f64; 2]],
    /// Pixel pitch of the sensor, um.
    pub pixel_pitch_um: f64,
    /// Direction in which the stage moved to the position of this bead, along each axis: -1 to 1, less the mean of all
    /// frames of the scan ([`ommatidia_session::FrameInfo::travel`]); 0 for what is no bead.
    pub travel: [f64; 2],
    /// Full scale of the converter above the black level, electrons.
    pub full_scale_e: f64,
    /// Mean signal without light, DN.
    pub black_level_dn: f64,
    /// Conversion gain, DN per electron.
    pub gain_dn_per_e: f64,
    /// The previous frame; `None` for the first frame of a stack.
    pub previous: Option<Previous<'a>>,
}

/// The previous frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Previous<'a> {
    /// Its light, [sensor rows, sensor cols], expected electrons.
    pub light_e: &'a Array2<f32>,
    /// Time from the start of its exposure to the start of this one, s.
    pub interval_s: f64,
}

impl FrameContext<'_> {
    /// Whether the frame shows a specimen or a bead.
    pub(super) fn shows_specimen(&self) -> bool {
        matches!(self.role, Role::Scene | Role::Bead)
    }
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
            anchors_px: &[],
            axes_px: &[],
            pixel_pitch_um: 1.0,
            travel: [0.0; 2],
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
    /// Position of the source relative to the centre of the object, um.
    pub object_um: [f64; 2],
    /// Focus relative to the anchor of the lens (the focus of the on-axis source), sensor pixels.
    pub field_px: [f64; 2],
    /// Focus relative to the point where the axis of the lens meets the sensor, sensor pixels.
    pub axis_px: [f64; 2],
    /// Anchor of the lens relative to the centre of the array, sensor pixels.
    pub anchor_px: [f64; 2],
    /// Pixel pitch of the sensor, um.
    pub pixel_pitch_um: f64,
    /// Displacement of a focus for a displacement of its source, sensor pixels per um.
    pub px_per_um: f64,
}

/// Displacement of a source and its focus by an effect, and growth of the focus.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RayShift {
    /// Displacement of the focus (row, col), sensor pixels.
    pub px: [f64; 2],
    /// Displacement of the source along the optical axis, um; positive towards larger z of the bead scan.
    pub z_um: f64,
    /// Relative growth w of the PSF about its focus: `h(x)` becomes `h(x / (1 + w)) / (1 + w)^2`. A displacement alone
    /// leaves the PSF as it is.
    pub growth: f64,
}

impl RayShift {
    /// A displacement of the focus, (row, col) sensor pixels.
    pub fn by_px(px: [f64; 2]) -> Self {
        Self { px, ..Self::default() }
    }

    /// A displacement of the source along the optical axis, um.
    pub fn by_um(z_um: f64) -> Self {
        Self { z_um, ..Self::default() }
    }
}

impl std::ops::AddAssign for RayShift {
    fn add_assign(&mut self, other: Self) {
        self.px[0] += other.px[0];
        self.px[1] += other.px[1];
        self.z_um += other.z_um;
        self.growth += other.growth;
    }
}

/// The session's record of one frame: which truth belongs to it, and its exposure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Record {
    /// Index of the written truth that this frame shows.
    pub truth: usize,
    /// Number of frames of the stack.
    pub frames: usize,
    /// Whether the written truth is upside down.
    pub flip_rows: bool,
    /// Whether the written truth is mirrored left to right.
    pub flip_cols: bool,
    /// True exposure over the written exposure.
    pub exposure_factor: f64,
}

impl Record {
    /// A correct record of frame `frame` in a stack of `frames` frames.
    pub fn honest(frame: usize, frames: usize) -> Self {
        Self { truth: frame, frames, flip_rows: false, flip_cols: false, exposure_factor: 1.0 }
    }

    /// The object that the frame shows, [object rows, object cols], from the written `truths`; `None` if they are too
    /// few.
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
