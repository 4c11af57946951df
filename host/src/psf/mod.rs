//! The spatially varying PSF as a low-rank model (Eqs. 2 and 3 of the paper).

pub mod decompose;
pub mod field;
pub mod fit;
pub mod nodes;
pub mod operator;
pub mod shift;

pub use operator::{LensImage, LowRankOperator, OperatorConfig, OperatorError};
