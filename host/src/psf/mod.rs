//! The spatially varying PSF as a low-rank model (Eqs. 2 and 3 of the paper).
//!
//! From bead windows to the model, then to the operator: [`windows`] are what is fitted, [`decompose`] gives basis PSFs,
//! [`field`] makes their coefficients smooth over the field, [`fit`] does both for all lenses, [`low_rank`] holds the result,
//! and [`operator`] applies it to objects.

pub mod chief_rays;
pub mod decompose;
pub mod field;
pub mod fit;
pub mod low_rank;
pub mod nodes;
pub mod operator;
pub mod shift;
pub mod windows;

pub use chief_rays::ChiefRays;
pub use low_rank::LowRankPsf;
pub use operator::{CalibratedOptics, LensImage, LowRankOperator, OperatorConfig, OperatorError};
pub use windows::{BeadScale, LensWindows};
