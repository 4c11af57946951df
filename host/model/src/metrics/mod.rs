//! Figures of merit: how well a reconstruction shows its object, and how well a model predicts a frame.
//!
//! Everything here is a function of images and of a noise model; nothing here knows how an image was made.
//! [`compare`] judges one reconstruction against its truth, [`prediction_figures`] a stack of predicted frames against
//! measured ones.
//!
//! ```
//! use ndarray::Array2;
//! use ommatidia_model::metrics::compare;
//!
//! let truth = Array2::from_shape_fn((16, 16), |(row, col)| (row + 2 * col) as f32);
//! // A reconstruction has a unit of its own: one free scale a frame removes it.
//! let perfect = compare((&truth * 0.5).view(), truth.view())?;
//! assert!((perfect.scale - 2.0).abs() < 1e-12);
//! assert!(perfect.nrmse == 0.0 && perfect.psnr_db == 200.0 && (perfect.ssim - 1.0).abs() < 1e-9);
//! // Background that was not removed is an error: there is no free offset.
//! let hazy = compare((&truth + 10.0).view(), truth.view())?;
//! assert!(hazy.nrmse > 0.1 && (hazy.pcc - 1.0).abs() < 1e-6);
//! # Ok::<(), ommatidia_model::metrics::MetricError>(())
//! ```

mod background;
mod case;
mod figures;
mod frames;
mod prediction;
mod residual;
mod ssim;

pub use background::{FrameBackground, add_background};
pub use case::Case;
pub use figures::{Figures, MetricError, Moments, compare, psnr, psnr_db, scaled};
pub use frames::{FrameComparison, SensorNoise};
pub use prediction::{PredictionFigures, prediction_figures};
pub use residual::{ChiSquared, ResidualRing, chi_squared, in_sigmas};
pub use ssim::{SsimError, ssim};
