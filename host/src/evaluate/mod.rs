//! Figures of merit: reconstructions against truths, predictions against frames, by field radius, with time and memory.

mod compare;
mod field;
mod metrics;
mod prediction;
pub mod receptive;
pub mod record;
pub mod resolution;
mod resources;
mod scenes;
mod spectrum;
mod ssim;

pub use compare::{Case, Source, judge};
pub use field::{Ring, Rings};
pub use metrics::{Figures, MetricError, Moments, compare, psnr_db, scaled};
pub use prediction::{
    PredictionFigures, ResidualRing, Sensor, Triple, chi_squared, in_sigmas, predict_figures, with_scale,
};
pub use record::{Evaluation, MethodFigures, Predicted, Summary};
pub use resources::measured;
pub use scenes::Scenes;
pub use spectrum::{RingSpectrum, Spectra};
pub use ssim::{SsimError, ssim};
