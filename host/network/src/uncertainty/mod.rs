//! Intervals for each pixel of a reconstruction, whose coverage is calibrated and can be checked.
//!
//! An interval `[lower, upper]` of 90 % holds the truth in 90 of 100 pixels. It is learned on virtual frames of the
//! calibrated instrument: noise, photon level, specimen, the error of the calibration (its replicates) and the errors
//! of what `close` found are drawn for each. What is learned is kept in a file, [`Widths`], and used on frames without
//! a truth. [`Coverage`] measures on other scenes how often it is right. Equations and sources are in
//! `docs/uncertainty.md`.
//!
//! | module | contents |
//! |---|---|
//! | `virtual_scenes` | frames with known objects, with the uncertainty of the instrument |
//! | `observer` | what a frame and its reconstruction show without the truth |
//! | `scale` | expected size of a pixel's error |
//! | `scores` | errors in units of that size, as histograms, and limits from them |
//! | `neighbours` | scenes that look alike; quantiles with the finite-sample correction |
//! | `calibrate` | scenes -> widths |
//! | `widths` | what was learned; frame and reconstruction -> interval and warnings |
//! | `file` | the file of widths |
//! | `coverage` | how often the truth is inside, by specimen, photon level and field radius |

mod calibrate;
mod coverage;
mod error;
mod file;
mod neighbours;
mod observer;
mod scale;
mod scores;
mod smooth;
mod virtual_scenes;
mod widths;

pub use calibrate::CalibrateWidths;
pub use coverage::{Coverage, CoverageTotals, Stratum};
pub use error::UncertaintyError;
pub use file::{KIND, VERSION};
pub use virtual_scenes::{EffectError, VirtualConfig, VirtualFrame, VirtualScenes};
pub use widths::{Intervals, Made, Ready, Suspicion, Widths};

#[cfg(test)]
mod tests;
