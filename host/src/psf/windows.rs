//! Bead windows: the samples that the low-rank model is fitted to.

use ndarray::{Array1, Array2};

/// Whether the brightness of the bead frames is physical.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BeadScale {
    /// All frames show the same bead at the same exposure: brightness that varies over the field is vignetting, part of
    /// the model.
    #[default]
    Physical,
    /// The frames are already normalised one by one: all are brought to the same total light.
    PerFrame,
}

/// The windows of one lens.
#[derive(Clone, Debug)]
pub struct LensWindows {
    /// Light at the reference exposure, DN, [bead, window * window].
    pub light_dn: Array2<f32>,
    /// Measured pixels, [bead, window * window]; None: all were measured.
    pub known: Option<Array2<bool>>,
    /// Variance of each pixel by the noise model, averaged over the beads, DN^2 at the reference exposure, [window *
    /// window]. Uniform where the gain is nominal: weights from a guessed gain are worse than none.
    pub variance_dn2: Array1<f64>,
}

impl LensWindows {
    /// For each bead, whether its focus lies on the sensor: at least one pixel in the middle half of the window was
    /// measured.
    pub fn seen(&self) -> Vec<bool> {
        let Some(known) = &self.known else { return vec![true; self.light_dn.nrows()] };
        let side = (known.ncols() as f64).sqrt().round() as usize;
        let middle = |p: &usize| [p / side, p % side].iter().all(|v| v.abs_diff(side / 2) <= side / 4);
        let middle: Vec<usize> = (0..known.ncols()).filter(middle).collect();
        known.outer_iter().map(|row| middle.iter().any(|p| row[*p])).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_focus_that_fell_off_the_sensor_is_not_seen_and_one_that_hangs_over_the_edge_is() {
        let side = 9;
        // The rows below the given one lie on the sensor.
        let known = Array2::from_shape_fn((3, side * side), |(n, p)| p / side < [9, 4, 2][n]);
        let light_dn = Array2::zeros(known.dim());
        let windows = LensWindows { light_dn, known: Some(known), variance_dn2: Array1::zeros(side * side) };
        assert_eq!(windows.seen(), [true, true, false]);
        assert_eq!(LensWindows { known: None, ..windows }.seen(), [true; 3]);
    }
}
