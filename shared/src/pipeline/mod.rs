//! Raw frame -> reconstruction: sensor correction, Fourier filter bank, enhancement network.
//!
//! ```text
//! x   = (code - black - offset) * inverse_gain        DN, negative values kept
//! x   = x / max(x)                                    all zeros where max(x) <= 0
//! f_c = filter_c(x), cropped to the object            see crate::filter
//! f   = f / max over all c of f                       all zeros where that is <= 0 or an f is not finite
//! out = rcan(f)                                       see crate::nn::rcan; halves, 0 to 1
//! ```
//! Both divisions are divisions, rounded once to binary32; f is stored as halves before and after. The maxima can also be held from an earlier
//! frame ([`Field`]).
//!
//! The configuration ([`Pipeline`]) is immutable and borrows the network file; the mutable state is the caller's memory
//! ([`Memory`]): fast scratch and a bulk arena, of the sizes of [`Pipeline::plan`] or larger. More fast scratch means taller bands and
//! wider strips, hence speed; never other bits. What the memory holds before does not matter.

mod error;
mod field;
mod holder;
mod reconstruct;
mod validate;

pub use error::PipelineError;
pub use field::{Field, GROWTH, Stats};
pub use holder::Holder;
pub use reconstruct::{Memory, Pipeline};

#[cfg(test)]
mod tests;
