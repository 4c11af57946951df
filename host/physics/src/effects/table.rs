//! Tables, for effects that vary irregularly from pixel to pixel, row to row or column to column.
//!
//! An injected table is drawn from a few parameters (an rms, a number of spots, a seed). A fitted table is estimated
//! from the residuals and stored in the setting. Both are applied in the same way.

use super::smooth::blur_within;
use ndarray::Array2;
use ommatidia_session::rng;
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
    /// Stage `Light`: `mu (1 + u)` in frames of specimens and beads, not in flats: something between array and sensor
    /// that even light did not meet, or that came after the flats.
    SceneResponse,
    /// Stage `Light`: `mu + u t` in frames of specimens and beads, u in electrons per ms, t the exposure.
    SceneRate,
    /// Stage `Light`: `mu + u mean(mu)` in frames of specimens and beads, with the mean light of the frame.
    SceneStray,
    /// Stage `Electronics`: `y + u` in frames of specimens and beads, u in DN.
    SceneOffset,
    /// Stage `Lens`: `mu_l (1 + u)` of the lens that the second parameter numbers, in frames of specimens and beads.
    SceneView,
}

impl TableUse {
    /// Whether the table acts in frames of specimens and beads alone. It is estimated from these frames.
    pub fn of_scenes(self) -> bool {
        matches!(self, Self::SceneResponse | Self::SceneRate | Self::SceneStray | Self::SceneOffset | Self::SceneView)
    }
}

/// Which pixels share a value of a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TableGroup {
    /// None: each pixel has its own value.
    Pixel,
    /// None, and only a few pixels have a value; the others are zero.
    SparsePixels,
    /// Neighbouring pixels: spots of several pixels.
    Spots,
    /// None, but values of neighbouring pixels may be similar.
    Pattern,
    /// Pixels of a row, of a column, or of a neighbourhood of any size.
    Scales,
}

/// Properties of a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Table {
    /// How the table acts on the frame.
    pub acts: TableUse,
    /// Which pixels share a value.
    pub group: TableGroup,
}

/// A table of independent normal numbers of standard deviation `rms`, one for each pixel. The same seed draws the same
/// table.
pub(super) fn normal(sensor: [usize; 2], rms: f64, seed: f64, what: &str) -> Array2<f32> {
    let mut rng = rng::stream(seed as u64, what, 0);
    Array2::from_shape_simple_fn(sensor, || {
        let z: f64 = StandardNormal.sample(&mut rng);
        (rms * z) as f32
    })
}

/// A table of smooth numbers: normal ones, blurred by `grain_px`, of standard deviation `rms`.
pub(super) fn soft(sensor: [usize; 2], rms: f64, seed: f64, what: &str, grain_px: f64) -> Array2<f32> {
    let soft = blur_within(&normal(sensor, 1.0, seed, what), grain_px);
    let found = soft.iter().map(|v| f64::from(v * v)).sum::<f64>() / soft.len().max(1) as f64;
    let factor = if found > 0.0 { rms / found.sqrt() } else { 0.0 };
    soft.mapv(|v| v * factor as f32)
}
