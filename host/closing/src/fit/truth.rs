//! Registration of the truths. A truth that another camera took may lie beside the object: shifted, turned, scaled.
//!
//! A point of the truth at x = (row, col) from the centre of its grid is the point x + d(x) of the object, with
//! ```text
//! d(x) = t + a (col, -row) + s x
//! ```
//! (to first order in the turn a; a similarity transform, Umeyama, IEEE TPAMI 13, 376, 1991). Each camera of the
//! instrument sees the point at the focus of x + d(x), so that all foci move by d, in every lens alike. The four values
//! are nuisances of the session with a Gaussian prior: the session states the standard deviation of t along each axis,
//! and the turn and the scale displace the corner of the field by as much. With R the distance of the corner from the
//! centre, the free values are t, a R and s R, all in object pixels and all with the same prior.

use ommatidia_model::instrument::Instrument;
use ommatidia_physics::effects::{Descriptor, Effect, FrameContext, Param, Ray, RayShift, Stage};

/// Number of values of a registration.
pub const PARTS: usize = 4;
/// Shift along rows and columns, and the displacement of the field's corner by the turn and by the scale, object
/// pixels.
pub type Registered = [f64; PARTS];
/// Step of derivatives, object pixels: far below the width of a PSF, and far above rounding errors.
pub(super) const STEP_PX: f64 = 0.01;

/// The grid of the truths.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Distance of a corner from the centre, object pixels.
    corner_px: f64,
    /// Sensor pixels that an image moves by if the object moves by one object pixel.
    sensor_px: f64,
}

impl Grid {
    /// The grid of an instrument.
    pub(super) fn of(instrument: &Instrument) -> Self {
        let m = &instrument.manifest;
        let [rows, cols] = [m.object.rows, m.object.cols].map(|n| (n as f64 - 1.0) / 2.0);
        Self {
            corner_px: rows.hypot(cols).max(1.0),
            sensor_px: m.object.pixel_um * instrument.geometry.magnification / m.sensor.pixel_pitch_um,
        }
    }

    /// The parameters of [`TRUTH`]: shift in sensor pixels, turn in rad, scale.
    pub(super) fn params(&self, [row, col, turn, scale]: Registered) -> Vec<f64> {
        vec![row * self.sensor_px, col * self.sensor_px, turn / self.corner_px, scale / self.corner_px]
    }

    /// Turn in mrad, or relative scale, of a displacement of the corner in object pixels.
    pub(crate) fn turn_mrad(&self, corner_px: f64) -> f64 {
        1e3 * corner_px / self.corner_px
    }

    /// Relative scale of a displacement of the corner in object pixels.
    pub(crate) fn scale(&self, corner_px: f64) -> f64 {
        corner_px / self.corner_px
    }
}

/// A misplaced truth as the chain of effects sees it. It belongs to a session and is in no catalogue: no instrument has
/// it.
pub(super) static TRUTH: Truth = Truth;

/// See [`TRUTH`].
pub(super) struct Truth;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "truth_registration",
    stage: Stage::Geometry,
    summary: "t + a (col, -row) + s x: the truth lies beside the object",
    params: &[
        Param::strength("row_px", "px", 0.005, -1e4, 1e4),
        Param::strength("col_px", "px", 0.005, -1e4, 1e4),
        Param::strength("turn", "rad", 1e-4, -1e2, 1e2),
        Param::strength("scale", "1", 1e-4, -1e2, 1e2),
    ],
    lookalikes: &[],
};

impl Effect for Truth {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn shift_ray(&self, p: &[f64], ray: &Ray, _cx: &FrameContext<'_>) -> RayShift {
        let [row, col] = ray.field_px;
        RayShift::by_px([p[0] + p[2] * col + p[3] * row, p[1] - p[2] * row + p[3] * col])
    }
}
