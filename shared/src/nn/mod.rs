//! The operators of the enhancement network. Tensors are (channel, row, col), stored as halves, and computed in
//! binary32. The 3x3 convolutions can also be computed in integers ([`integer`]).
//!
//! The network is that of SV-FourierNet (Yang et al. 2024, section 3B): a light residual channel-attention network
//! (RCAN, Zhang et al., ECCV 2018). [`rcan`] defines it in terms of the operators, and the order of its weights.

pub mod activation;
mod arithmetic;
pub mod channel_attention;
pub mod conv;
mod error;
mod features;
pub mod integer;
mod layout;
mod means;
mod packed;
pub mod pixel_shuffle;
pub mod rcab;
pub mod rcan;
pub mod upscale;

pub use error::NnError;
pub use features::Features;
