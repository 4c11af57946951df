//! Foci of points of light: position, transmitted light and PSF through one lens.

/// A point of light on the object side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Point {
    /// Stage position (y, x), um from the centre of the object.
    pub at_um: [f64; 2],
    /// Depth, um.
    pub z_um: f64,
}

/// The focus of one point through one lens.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Focus {
    /// Sensor pixel (row, col) under the middle pixel of the PSF; may lie outside the sensor.
    pub centre: [i64; 2],
    /// Share of the light that the lens passes at this angle.
    pub transmission: f64,
}

/// Foci of many points through one lens.
#[derive(Debug)]
pub(crate) struct Foci {
    /// Side of a PSF, pixels.
    pub side: usize,
    /// One focus for each point.
    pub focus: Vec<Focus>,
    /// PSFs of all points one after the other, [point, side, side]: the share of the light in each pixel.
    pub share: Vec<f32>,
}

impl Foci {
    /// Focus and PSF of one point.
    pub(crate) fn get(&self, point: usize) -> Option<(Focus, &[f32])> {
        let len = self.side * self.side;
        Some((*self.focus.get(point)?, self.share.get(point * len..(point + 1) * len)?))
    }
}

/// Stored foci, and the index of a point among them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Kept<'a> {
    pub foci: &'a Foci,
    pub index: usize,
}
