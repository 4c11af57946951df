//! Effects whose strength differs from pixel to pixel, row to row or column to column without a law: a table of values.
//!
//! Injected, the table is drawn from a few parameters (an rms, a number of spots, a seed); fitted, it is estimated
//! from the residuals and carried in the setting. Applied, both are the same.

use crate::rng;
use ndarray::Array2;
use rand_distr::{Distribution, StandardNormal};

/// How a table `u` acts. It is [sensor rows, sensor cols], [rows, 1] or [1, cols].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TableUse {
    /// Stage `Light`: `mu (1 + u)`.
    Response,
    /// Stage `Light`: `mu + u t`, u in electrons per ms, t the exposure.
    DarkRate,
    /// Stage `Electronics`: `y + u`, u in DN.
    Offset,
}

/// What shares one value of a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TableGroup {
    /// Each pixel has its own.
    Pixel,
    /// Few pixels have one; the rest are zero.
    SparsePixels,
    /// Pixels near one another are alike: spots of some pixels.
    Spots,
    /// Each pixel has its own, and pixels near one another may be alike.
    Pattern,
}

/// A table: how it acts and what shares a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Table {
    /// How it acts.
    pub acts: TableUse,
    /// What shares a value.
    pub group: TableGroup,
}

/// A table of normal numbers with that standard deviation, one a pixel; the same seed draws the same table.
pub(super) fn normal(sensor: [usize; 2], rms: f64, seed: f64, what: &str) -> Array2<f32> {
    let mut rng = rng::stream(seed as u64, what, 0);
    Array2::from_shape_simple_fn(sensor, || {
        let z: f64 = StandardNormal.sample(&mut rng);
        (rms * z) as f32
    })
}
