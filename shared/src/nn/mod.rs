//! The operators of the enhancement network, one a file. Tensors are CHW, stored as halves, computed in binary32.
//!
//! The network after Xue et al. (SV-FourierNet, section 3B): a light residual channel-attention network (RCAN, Zhang et al.,
//! ECCV 2018). [`rcan`] composes the operators, states the network exactly, and gives the order of the weights.

pub mod activation;
pub mod channel_attention;
pub mod conv;
mod error;
mod features;
mod packed;
pub mod pixel_shuffle;
pub mod rcab;
pub mod rcan;
pub mod upscale;

pub use error::NnError;
pub use features::Features;
