//! The image of one lens, placed on the sensor.

use ndarray::{Array2, s};

/// The image of one lens: its window on the sensor plane, parts off the sensor included.
#[derive(Clone, Debug)]
pub struct LensImage {
    /// Sensor pixel of the first element; may be negative.
    pub origin: [isize; 2],
    /// Light, DN.
    pub light: Array2<f32>,
}

impl LensImage {
    /// Adds the part that lies on the sensor to `frame`.
    pub fn add_to(&self, frame: &mut Array2<f32>) {
        let (rows, cols) = frame.dim();
        let (h, w) = self.light.dim();
        let (Some((fr, lr)), Some((fc, lc))) = (overlap(self.origin[0], h, rows), overlap(self.origin[1], w, cols))
        else {
            return;
        };
        let mut target = frame.slice_mut(s![fr, fc]);
        target += &self.light.slice(s![lr, lc]);
    }
}

/// A range of rows or columns.
pub(super) type Span = std::ops::Range<usize>;

/// The part of `n` pixels from `origin` that lies in 0..limit: as a range of 0..limit, and as a range of the n pixels.
pub(super) fn overlap(origin: isize, n: usize, limit: usize) -> Option<(Span, Span)> {
    let low = origin.max(0);
    let high = (origin + n as isize).min(limit as isize);
    (low < high).then(|| (low as usize..high as usize, (low - origin) as usize..(high - origin) as usize))
}
