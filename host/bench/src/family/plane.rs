//! Where rays lie: the plane of the sensor and the scale of the images, which relays and given PSFs share.

use ommatidia_physics::effects::Ray;

/// The plane of the sensor behind a lens array.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SensorPlane {
    /// Middle of the sensor (row, col), pixels.
    pub centre_px: [f64; 2],
    /// Pitch of the pixels, um.
    pub pixel_pitch_um: f64,
    /// Size of an image over that of its object.
    pub magnification: f64,
}

/// The chief ray of a point through one lens, on the sensor.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Chief {
    /// Focus (row, col) of the on-axis source through the lens, pixels.
    pub anchor_px: [f64; 2],
    /// Where the axis of the lens meets the sensor (row, col), pixels.
    pub axis_px: [f64; 2],
    /// Where the point's light is centred, relative to the axis, pixels.
    pub off_axis_px: [f64; 2],
}

impl SensorPlane {
    /// Object position (y, x) on the axis of a lens, um: the anchor lies opposite to the axis, `1 + m` times as far
    /// from the centre (un-inverted coordinates).
    pub fn axis_um(&self, anchor_px: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|k| -(anchor_px[k] - self.centre_px[k]) * self.pixel_pitch_um / (1.0 + self.magnification))
    }

    /// Pixels of the image per micrometre of the object.
    pub fn px_per_um(&self) -> f64 {
        self.magnification / self.pixel_pitch_um
    }

    /// Where the axis of a lens meets the sensor, pixels.
    pub fn axis_px(&self, anchor_px: [f64; 2], axis_um: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|k| anchor_px[k] + self.px_per_um() * axis_um[k])
    }

    /// The ray of the point at (y, x) um through lens `lens`, as effects see it.
    pub fn ray(&self, lens: usize, at_um: [f64; 2], chief: Chief) -> Ray {
        let Chief { anchor_px, off_axis_px, .. } = chief;
        let focus = chief.focus_px([0.0; 2]);
        Ray {
            lens,
            object_um: at_um,
            field_px: [0, 1].map(|k| focus[k] - anchor_px[k]),
            axis_px: off_axis_px,
            anchor_px: [0, 1].map(|k| anchor_px[k] - self.centre_px[k]),
            pixel_pitch_um: self.pixel_pitch_um,
            px_per_um: self.px_per_um(),
        }
    }
}

impl Chief {
    /// Where it meets the sensor, displaced by `moved_px`, pixels.
    pub fn focus_px(&self, moved_px: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|k| self.axis_px[k] + self.off_axis_px[k] + moved_px[k])
    }
}
