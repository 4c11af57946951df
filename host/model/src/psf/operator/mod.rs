//! Eq. 3 of the paper as one linear operator, with its exact transpose.
//!
//! ```text
//! g = sum_l place_l( sum_k (M_lk . O) * B_lk )
//! ```
//! `place_l` puts object pixel (r, c) at sensor pixel `corner_l + (r, c)`, with `corner_l = round(anchor_l - centre)`.
//! One object pixel is one sensor pixel; the sub-pixel remainder and distortion are part of the basis PSFs. Light that
//! falls off the sensor is cut. The convolutions run block by block over the object (overlap-add), so that the memory
//! is bounded by the block and not by the object. The spectra of the basis PSFs are kept where they take little memory.
//! Where they would take more, the coefficients of all lenses inside a block become combinations of few functions that
//! the lenses share, with a bounded error ([`OperatorConfig::most_error`]): a block of the object is then transformed
//! once for each function, and not once for each term of each lens. All arithmetic is f32;
//! the result does not depend on the number of threads.

mod blocks;
mod config;
mod error;
mod image;
mod lenses;
mod local;
mod mix;
mod plan;
mod products;
mod terms;
mod tiling;

pub use config::{CalibratedOptics, OperatorConfig};
pub use error::OperatorError;
pub use image::LensImage;
pub use plan::LowRankOperator;

#[cfg(test)]
mod tests;
