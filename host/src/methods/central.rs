//! The view of the central lens alone: what a conventional miniscope with one such lens would show.

use super::frame::frame_input;
use super::{MethodError, Reconstruct};
use crate::instrument::Instrument;
use crate::sensor::FrameInput;
use ndarray::{Array2, ArrayView2};

/// Cuts the view of the central lens out of the frame, at its chief ray. Light of neighbouring lenses that overlaps the
/// view stays in it.
#[derive(Clone, Debug)]
pub struct Central {
    input: FrameInput,
    /// Sensor row of each object row and sensor column of each object column, fractional pixels.
    rows_px: Vec<f64>,
    cols_px: Vec<f64>,
}

impl Central {
    /// Uses the living lens whose chief ray lies nearest to the centre of the sensor.
    ///
    /// # Errors
    /// All lenses are dead, or the parts of the instrument disagree.
    pub fn new(instrument: &Instrument) -> Result<Self, MethodError> {
        let (sensor, object) = (&instrument.manifest.sensor, &instrument.manifest.object);
        let centre = [(sensor.rows as f64 - 1.0) / 2.0, (sensor.cols as f64 - 1.0) / 2.0];
        let distance = |a: &[f64; 2]| (a[0] - centre[0]).hypot(a[1] - centre[1]);
        let geometry = &instrument.geometry;
        let living = geometry.anchors_px.iter().zip(&geometry.dead).filter(|(_, dead)| !**dead).map(|(a, _)| a);
        let anchor = living.min_by(|a, b| distance(a).total_cmp(&distance(b))).ok_or(MethodError::NoLens)?;
        // Eq. 1: focus = anchor + magnification / pitch * stage position.
        let step = geometry.magnification * object.pixel_um / sensor.pixel_pitch_um;
        let line =
            |n: usize, anchor: f64| (0..n).map(|i| anchor + step * (i as f64 - (n as f64 - 1.0) / 2.0)).collect();
        Ok(Self {
            input: frame_input(instrument)?,
            rows_px: line(object.rows, anchor[0]),
            cols_px: line(object.cols, anchor[1]),
        })
    }
}

impl Reconstruct for Central {
    fn name(&self) -> &str {
        "central"
    }

    fn reconstruct(&self, frame_dn: ArrayView2<'_, f32>) -> anyhow::Result<Array2<f32>> {
        let light = self.input.light_dn(frame_dn)?;
        let view = |(r, c)| bilinear(&light, self.rows_px[r], self.cols_px[c]).max(0.0);
        Ok(Array2::from_shape_fn((self.rows_px.len(), self.cols_px.len()), view))
    }
}

/// Bilinear interpolation at a fractional pixel; 0 beyond the image.
fn bilinear(image: &Array2<f32>, row: f64, col: f64) -> f32 {
    let (r0, c0) = (row.floor(), col.floor());
    let (fr, fc) = ((row - r0) as f32, (col - c0) as f32);
    let at = |r: f64, c: f64| {
        let inside = r >= 0.0 && c >= 0.0 && r < image.nrows() as f64 && c < image.ncols() as f64;
        if inside { image[[r as usize, c as usize]] } else { 0.0 }
    };
    (1.0 - fr) * ((1.0 - fc) * at(r0, c0) + fc * at(r0, c0 + 1.0))
        + fr * ((1.0 - fc) * at(r0 + 1.0, c0) + fc * at(r0 + 1.0, c0 + 1.0))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::testing::square_array as instrument;

    #[test]
    fn it_shows_what_lies_at_the_chief_ray() {
        let instrument = instrument(3, [60, 60], [20, 20]);
        let central = Central::new(&instrument).unwrap();
        // Anchor of the central lens (29.5, 29.5): object pixel (r, c) falls on sensor pixel (r + 20, c + 20) exactly.
        let frame = Array2::from_shape_fn((60, 60), |(r, c)| 64.0 + (100 * r + c) as f32);
        let view = central.reconstruct(frame.view()).unwrap();
        assert_eq!(view[[3, 7]], (100 * 23 + 27) as f32);
    }

    #[test]
    fn a_sub_pixel_chief_ray_is_followed() {
        let mut instrument = instrument(1, [60, 60], [20, 20]);
        instrument.geometry.anchors_px[0] = [29.75, 29.5];
        let frame = Array2::from_shape_fn((60, 60), |(r, _)| 64.0 + r as f32);
        let view = Central::new(&instrument).unwrap().reconstruct(frame.view()).unwrap();
        assert!((view[[0, 0]] - 20.25).abs() < 1e-5);
    }

    #[test]
    fn a_dead_centre_gives_way_and_no_lens_is_an_error() {
        let mut instrument = instrument(3, [60, 60], [20, 20]);
        instrument.geometry.dead[4] = true;
        assert!(Central::new(&instrument).is_ok());
        instrument.geometry.dead.fill(true);
        assert!(matches!(Central::new(&instrument), Err(MethodError::NoLens)));
    }
}
