//! What a residual may depend on, and how it was found to.

use serde::{Deserialize, Serialize};

/// What a residual may depend on.
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
    /// Row from the anchor of that lens: place on the object.
    FieldRow,
    /// Column from the anchor of that lens.
    FieldColumn,
    /// Expected light of the pixel.
    Intensity,
    /// Mean expected light around it.
    LocalMean,
    /// Expected light against its surroundings: how sharp the picture is there.
    Sharpness,
    /// Light of the pixel in the frame before.
    PreviousFrame,
    /// Light of the whole frame.
    TotalLight,
    /// Depth of what the frame shows.
    Depth,
    /// The frame.
    Frame,
    /// Neighbours in space: correlation of the residual at small distances.
    Neighbours,
    /// The same pixel one frame on.
    NextFrame,
    /// The noise of repeats: its variance; its correlation along the row, along the column and diagonally; what rows and what columns
    /// share.
    Repeats,
    /// The same pixel in other frames of even light and of none: what the response and what the offset keep from frame to frame.
    FixedPattern,
}

impl Covariate {
    /// All of them.
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

    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Row => "row",
            Self::Column => "column",
            Self::RowParity => "row parity",
            Self::ColumnParity => "column parity",
            Self::Checkerboard => "checkerboard",
            Self::Radius => "radius from the middle of the sensor",
            Self::Lens => "lens",
            Self::FieldRow => "row from the lens's anchor",
            Self::FieldColumn => "column from the lens's anchor",
            Self::Intensity => "expected light",
            Self::LocalMean => "expected light around the pixel",
            Self::Sharpness => "expected light against its surroundings",
            Self::PreviousFrame => "light of the frame before",
            Self::TotalLight => "light of the whole frame",
            Self::Depth => "depth",
            Self::Frame => "frame",
            Self::Neighbours => "residual of neighbouring pixels",
            Self::NextFrame => "residual of the next frame",
            Self::Repeats => "noise of repeats: variance, neighbours, rows, columns",
            Self::FixedPattern => "the same pixel in other flats and darks",
        }
    }

    /// Whether it is tested by products of two residuals.
    pub(crate) fn is_product(self) -> bool {
        matches!(self, Self::Neighbours | Self::NextFrame)
    }
}

/// The residual against one covariate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Dependence {
    /// The covariate.
    pub covariate: Covariate,
    /// Place of each bin: pixels, electrons, index, whichever the covariate counts in.
    pub at: Vec<f64>,
    /// Mean residual of each bin in standard deviations of a pixel (correlation, for neighbours and frames; standard errors, for repeats).
    pub mean: Vec<f64>,
    /// Standard deviation of that mean if the model is right: the null band.
    pub band: Vec<f64>,
    /// How much it matters: the part of a pixel's variance of noise that it makes, its error taken off. None: it is not of single pixels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub size: Option<f64>,
    /// Sum of squares over the bins against its error.
    pub chi2: f64,
    /// Its mean over draws of the model.
    pub expected: f64,
    /// Probability of a larger one if the model is right.
    pub p: f64,
    /// The same as standard deviations.
    pub z: f64,
}
