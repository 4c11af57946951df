//! The PSF at a place: the image of a point source through each lens.

use super::{Forward, ForwardError};
use ndarray::{Array3, Axis, s};
use ommatidia_physics::optics::MicrolensArray;

/// The foci of a point source of unit light.
#[derive(Clone, Debug, PartialEq)]
pub struct Foci {
    /// Where its chief ray meets the sensor behind each lens, [row, col], px.
    pub chief_rays_px: Vec<[f64; 2]>,
    /// Sensor pixel of the first pixel of each window, [row, col]; it may lie off the sensor.
    pub corners_px: Vec<[isize; 2]>,
    /// Expected electrons at the exposure of the calibration in a window around each chief ray, [lens, row, col]; 0 off
    /// the sensor and behind dead lenses.
    pub windows_e: Array3<f32>,
}

impl Forward {
    /// The foci of a point source at stage position `at_um`, [y, x], in windows of `window_px` pixels, with the effects
    /// of the instrument on chief rays and lenses.
    ///
    /// ```
    /// use ommatidia_model::forward::Forward;
    ///
    /// let instrument = ommatidia_model::testing::instrument([9, 11], [30, 33], 5, 3);
    /// let foci = Forward::new(&instrument)?.foci([0.0, 0.0], 5)?;
    /// assert_eq!(foci.windows_e.dim(), (2, 5, 5));
    /// assert_eq!(foci.chief_rays_px, instrument.geometry.anchors_px); // on the axis
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// The place lies outside the object.
    pub fn foci(&self, at_um: [f64; 2], window_px: usize) -> Result<Foci, ForwardError> {
        let shape = self.operator().object_shape();
        let edge_um = shape.map(|n| n as f64 / 2.0 * self.object_pixel_um);
        if !(0..2).all(|a| at_um[a].abs() <= edge_um[a]) {
            return Err(ForwardError::Place { edge_um, found_um: at_um });
        }
        let at_px = [0, 1].map(|a| at_um[a] / self.object_pixel_um + (shape[a] as f64 - 1.0) / 2.0);
        let optics = MicrolensArray {
            object_distance_um: 1.0,
            magnification: self.geometry.magnification,
            pixel_pitch_um: self.pixel_pitch_um,
        };
        let chief_rays_px: Vec<[f64; 2]> =
            self.geometry.anchors_px.iter().map(|anchor| optics.chief_ray_px(*anchor, at_um)).collect();
        let half = (window_px / 2) as isize;
        let corners_px: Vec<[isize; 2]> =
            chief_rays_px.iter().map(|ray| ray.map(|v| v.round() as isize - half)).collect();
        let cx = self.context();
        let scene = self.point(at_px, &self.effects, &cx)?;
        let mut windows_e = Array3::zeros((corners_px.len(), window_px, window_px));
        for (l, corner) in corners_px.iter().enumerate() {
            let whole = self.lens_e(&scene, l, &self.effects, &cx);
            let on = [0, 1].map(|a| {
                let n = whole.len_of(Axis(a)) as isize;
                let first = corner[a].clamp(0, n);
                first..(corner[a] + window_px as isize).clamp(first, n)
            });
            let at = [0, 1].map(|a| on[a].start - corner[a]..on[a].end - corner[a]);
            let [rows, cols] = on;
            let [to_rows, to_cols] = at;
            windows_e.slice_mut(s![l, to_rows, to_cols]).assign(&whole.slice(s![rows, cols]));
        }
        Ok(Foci { chief_rays_px, corners_px, windows_e })
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::testing::instrument;
    use ndarray::Array2;

    #[test]
    fn foci_of_a_pixel_are_its_column_of_the_operator() {
        let i = instrument([9, 11], [30, 33], 5, 3);
        let forward = Forward::new(&i).unwrap();
        let mut object = Array2::zeros((9, 11));
        object[[2, 7]] = 1.0;
        let light = forward.expected_e(object.view(), &forward.context()).unwrap();
        let um = i.manifest.object.pixel_um;
        let foci = forward.foci([-2.0 * um, 2.0 * um], 5).unwrap();
        let mut whole = Array2::<f32>::zeros((30, 33));
        for (l, corner) in foci.corners_px.iter().enumerate() {
            for ((r, c), v) in foci.windows_e.index_axis(Axis(0), l).indexed_iter() {
                // A window may begin beside the sensor; it is dark there.
                let [row, col] = [corner[0] + r as isize, corner[1] + c as isize].map(usize::try_from);
                match (row, col) {
                    (Ok(row), Ok(col)) if row < 30 && col < 33 => whole[[row, col]] += v,
                    _ => assert_eq!(*v, 0.0),
                }
            }
        }
        let off = (&whole - &light).iter().fold(0.0f32, |m, v| m.max(v.abs()));
        assert!(off < 1e-4 * light.fold(0.0f32, |m, v| m.max(v.abs())), "{off}");
    }

    #[test]
    fn places_outside_the_object_are_refused() {
        let i = instrument([9, 11], [30, 33], 5, 3);
        let forward = Forward::new(&i).unwrap();
        assert!(matches!(forward.foci([1e4, 0.0], 5), Err(ForwardError::Place { .. })));
        assert!(matches!(forward.foci([0.0, f64::NAN], 5), Err(ForwardError::Place { .. })));
    }
}
