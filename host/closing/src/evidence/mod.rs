//! Tests the residual of a fit.
//!
//! [`omnibus`] asks whether the residual depends on anything at all, [`score`] how much each effect of the catalogue
//! would improve the fit, `constancy` whether an effect has one strength everywhere, [`tables`] whether single pixels
//! deviate in even light, `maps` what is fixed to the sensor in scenes, `placement` where truths lie beside specimens,
//! [`mod@figures`] how well held-out data are predicted, [`mod@curves`] whether effects drift within a recording.

mod bins;
mod constancy;
pub mod covariate;
pub mod curves;
pub mod figures;
pub(crate) mod maps;
pub mod omnibus;
mod placement;
pub mod score;
pub mod stats;
pub mod tables;

pub(crate) use constancy::Constancy;
#[cfg(test)]
pub(crate) use constancy::Spread;
pub use covariate::{Covariate, Dependence};
pub use curves::Curve;
pub(crate) use curves::curves;
pub use figures::{Figures, JudgedOn, figures};
pub(crate) use figures::{
    compared, excess, excess_by_calibration, is_worse, judged, pictured_frames, rises, standing_alone, surely_worse,
    worse,
};
pub(crate) use omnibus::noise_left;
pub use omnibus::structured;
pub(crate) use omnibus::structured_mean;
pub(crate) use placement::{Placement, placement};
pub use score::{Scores, Test};
pub use stats::{f_tail, holm};
pub use tables::TableFit;
