//! The enhancement network (RCAN) for inference: in single precision, without burn's graph, on all cores.
//!
//! The same network as that of [`super::Network`]; outputs agree to some 1e-5 (a test). What makes it fast, and small:
//!
//! - Convolutions are Winograd's ([`super::ops::winograd`]), with a quarter of the multiplications.
//! - Both convolutions of a block run over a patch that stays in the second-level cache; what goes through memory is a
//!   few planes [rows, cols, channels]. The field's means, which the attention needs, divide a block into what comes
//!   before them (here) and after (when the next layer reads).
//! - Nothing lies between the last two convolutions but a shuffle of pixels, so they are one 5x5 convolution
//!   ([`tail`]).
//!
//! Sums run in one order whatever the number of threads, and so do results.

mod layers;
mod network;
mod passes;
mod tail;

pub use network::Enhancement;

#[cfg(test)]
mod tests;
