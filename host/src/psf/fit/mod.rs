//! Windows at scattered positions -> the low-rank model, with its error on positions that were left out.
//!
//! [`super::decompose`] knows no positions and [`super::field`] knows no PSFs; here they meet: the coefficients of each
//! lens's decomposition become smooth functions over the field.

mod lens_fit;
mod lenses;
mod misfit;
mod planes;

pub use lens_fit::{LensFit, fit_lens};
pub use lenses::{FitConfig, LensModels, Terms};
pub use misfit::{Misfit, approximation, predicted, sum_over_lenses};
pub use planes::{Plane, checkerboard, select};

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests;
