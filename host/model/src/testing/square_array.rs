//! A small synthetic instrument with a square array of lenses whose PSFs are single pixels.

use crate::instrument::Instrument;
use ndarray::{Array4, Array5};
use ommatidia_session::ArrayGeometry;

/// An instrument of `side` x `side` lenses, 20 px apart about the centre of the sensor. Each PSF is one pixel, constant
/// over the field. `sensor` and `object` are [rows, cols].
pub fn square_array(side: usize, sensor: [usize; 2], object: [usize; 2]) -> Instrument {
    let lenses = side * side;
    let middle = |n: usize| (n as f64 - 1.0) / 2.0;
    let anchor = |l: usize| {
        let step = |i: usize| 20.0 * (i as f64 - middle(side));
        [middle(sensor[0]) + step(l / side), middle(sensor[1]) + step(l % side)]
    };
    let mut basis = Array4::zeros((lenses, 1, 3, 3));
    basis.slice_mut(ndarray::s![.., .., 1, 1]).fill(1.0);
    let mut instrument = super::instrument(object, sensor, 3, 1);
    instrument.manifest.array = ArrayGeometry::grid(side, side, 20.0);
    instrument.geometry.anchors_px = (0..lenses).map(anchor).collect();
    instrument.geometry.dead = vec![false; lenses];
    instrument.psf.basis = basis;
    instrument.psf.coefficients = Array5::ones((lenses, 1, 1, 2, 2));
    instrument.psf.node_rows_px = vec![0.0, object[0] as f64 - 1.0];
    instrument.psf.node_cols_px = vec![0.0, object[1] as f64 - 1.0];
    instrument
}
