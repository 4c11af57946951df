//! The covariates of the omnibus tests, and the result of a test.

use serde::{Deserialize, Serialize};

/// A quantity that the residual may depend on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Covariate {
    /// Row of the sensor.
    Row,
    /// Column of the sensor.
    Column,
    /// Even or odd row.
    RowParity,
    /// Even or odd column.
    ColumnParity,
    /// The colours of a checkerboard.
    Checkerboard,
    /// Distance from the middle of the sensor.
    Radius,
    /// The lens whose chief ray of the on-axis source is nearest.
    Lens,
    /// Row relative to the anchor of that lens: the place on the object.
    FieldRow,
    /// Column relative to the anchor of that lens.
    FieldColumn,
    /// Expected light of the pixel.
    Intensity,
    /// Mean expected light around the pixel.
    LocalMean,
    /// Expected light relative to its surroundings: local sharpness of the image.
    Sharpness,
    /// Light of the pixel in the preceding frame.
    PreviousFrame,
    /// Light of the whole frame.
    TotalLight,
    /// Depth of the object.
    Depth,
    /// Index of the frame.
    Frame,
    /// Correlation of the residual with that of neighbouring pixels.
    Neighbours,
    /// Correlation of the residual with that of the same pixel in the next frame.
    NextFrame,
    /// The noise of repeated frames: its variance; its correlation along the row, along the column and diagonally; the
    /// variance common to rows and to columns.
    Repeats,
    /// Pattern common to all flats and darks: of the response and of the offset.
    FixedPattern,
}

impl Covariate {
    /// All covariates.
    pub const ALL: [Self; 20] = [
        Self::Row,
        Self::Column,
        Self::RowParity,
        Self::ColumnParity,
        Self::Checkerboard,
        Self::Radius,
        Self::Lens,
        Self::FieldRow,
        Self::FieldColumn,
        Self::Intensity,
        Self::LocalMean,
        Self::Sharpness,
        Self::PreviousFrame,
        Self::TotalLight,
        Self::Depth,
        Self::Frame,
        Self::Neighbours,
        Self::NextFrame,
        Self::Repeats,
        Self::FixedPattern,
    ];

    /// Name for reports.
    pub fn words(self) -> &'static str {
        match self {
            Self::Row => "row",
            Self::Column => "column",
            Self::RowParity => "row parity",
            Self::ColumnParity => "column parity",
            Self::Checkerboard => "checkerboard",
            Self::Radius => "distance from the middle of the sensor",
            Self::Lens => "lens",
            Self::FieldRow => "row relative to the anchor of the lens",
            Self::FieldColumn => "column relative to the anchor of the lens",
            Self::Intensity => "expected light",
            Self::LocalMean => "expected light around the pixel",
            Self::Sharpness => "expected light relative to its surroundings",
            Self::PreviousFrame => "light of the preceding frame",
            Self::TotalLight => "light of the whole frame",
            Self::Depth => "depth",
            Self::Frame => "frame",
            Self::Neighbours => "residual of neighbouring pixels",
            Self::NextFrame => "residual of the next frame",
            Self::Repeats => "noise of repeated frames: variance, neighbours, tails, rows, columns",
            Self::FixedPattern => "value of the same pixel in other flats and darks",
        }
    }

    /// Whether the test uses products of two residuals.
    pub(crate) fn is_product(self) -> bool {
        matches!(self, Self::Neighbours | Self::NextFrame)
    }
}

/// Test of the residual against one covariate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Dependence {
    /// The covariate.
    pub covariate: Covariate,
    /// Mean of the covariate in each bin, in its own unit: pixels, electrons, um, or an index.
    pub at: Vec<f64>,
    /// Mean residual of each bin, in standard deviations of a pixel. For neighbours and the next frame: correlation
    /// coefficients. For repeats and fixed patterns: standard errors.
    pub mean: Vec<f64>,
    /// Standard deviation of that mean under the null hypothesis that the model is right.
    pub band: Vec<f64>,
    /// Size of the dependence: mean square over the bins relative to the variance of a pixel's noise, with its
    /// expectation under the null hypothesis subtracted. None for tests of products, repeats and fixed patterns.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub size: Option<f64>,
    /// Sum over the bins of the squared sum of residuals over its variance.
    pub chi2: f64,
    /// Expected value of `chi2` if the model is right.
    pub expected: f64,
    /// Probability of a larger value if the model is right.
    pub p: f64,
    /// The same as standard deviations of a normal variable (two-sided).
    pub z: f64,
}
