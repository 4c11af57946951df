//! Chief rays of a microlens array between an object plane and a sensor, in un-inverted image coordinates.

/// A microlens array before a sensor: thin lenses in one plane, with a common object distance and image distance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MicrolensArray {
    /// Distance from the object plane to the lenses, um.
    pub object_distance_um: f64,
    /// Magnification (image size over object size): image distance over object distance.
    pub magnification: f64,
    /// Pixel pitch of the sensor, um.
    pub pixel_pitch_um: f64,
}

impl MicrolensArray {
    /// Distance from the lenses to the sensor, um.
    pub fn image_distance_um(&self) -> f64 {
        self.magnification * self.object_distance_um
    }

    /// Focus (row, col) of the source at object position (y, x), um, through the lens with this anchor, sensor pixels:
    /// Eq. 1 of Yang et al. (2024), un-inverted.
    pub fn chief_ray_px(&self, anchor_px: [f64; 2], object_um: [f64; 2]) -> [f64; 2] {
        let scale = self.magnification / self.pixel_pitch_um;
        [anchor_px[0] + scale * object_um[0], anchor_px[1] + scale * object_um[1]]
    }

    /// Object position (y, x) on the axis of a lens, um, where its image is best.
    ///
    /// A lens at X in the plane of the lenses images the source at x to `X + m (X - x)` behind the array. In
    /// un-inverted coordinates the anchor, the focus of the on-axis source, is therefore `-X (1 + m)`.
    pub fn axis_um(&self, anchor_px: [f64; 2], centre_px: [f64; 2]) -> [f64; 2] {
        let scale = -self.pixel_pitch_um / (1.0 + self.magnification);
        [scale * (anchor_px[0] - centre_px[0]), scale * (anchor_px[1] - centre_px[1])]
    }

    /// Tangents (row, col) of the angle between a chief ray and the axis of its lens.
    pub fn tangents(&self, axis_um: [f64; 2], object_um: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|k| (object_um[k] - axis_um[k]) / self.object_distance_um)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ARRAY: MicrolensArray =
        MicrolensArray { object_distance_um: 600.0, magnification: 0.66, pixel_pitch_um: 1.85 };
    const CENTRE_PX: [f64; 2] = [106.5, 99.5];

    #[test]
    fn chief_rays_are_straight_lines_through_the_lens() {
        // By similar triangles: a source at x, a lens at X, the sensor a distance b behind it. The ray meets the sensor
        // at X + (X - x) b / a. Un-inverted coordinates have the opposite sign.
        let (a, b) = (ARRAY.object_distance_um, ARRAY.image_distance_um());
        let lens_um = [80.0, -35.0];
        let anchor = [0, 1].map(|k| CENTRE_PX[k] - lens_um[k] * (1.0 + b / a) / ARRAY.pixel_pitch_um);
        for object in [[0.0, 0.0], [100.0, -40.0], [-13.0, 77.0]] {
            let found = ARRAY.chief_ray_px(anchor, object);
            for k in 0..2 {
                let hit_um = lens_um[k] + (lens_um[k] - object[k]) * b / a;
                let expected = CENTRE_PX[k] - hit_um / ARRAY.pixel_pitch_um;
                assert!((found[k] - expected).abs() < 1e-9);
            }
        }
        // The chief ray of the source on the axis of the lens runs along that axis.
        let axis = ARRAY.axis_um(anchor, CENTRE_PX);
        assert!((axis[0] - lens_um[0]).abs() < 1e-9 && (axis[1] - lens_um[1]).abs() < 1e-9);
        assert_eq!(ARRAY.tangents(axis, axis), [0.0, 0.0]);
        assert_eq!(ARRAY.axis_um(CENTRE_PX, CENTRE_PX), [0.0, 0.0]);
    }
}
