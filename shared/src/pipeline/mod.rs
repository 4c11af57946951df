//! From a raw frame to its reconstruction: sensor correction, Fourier filter bank, enhancement network.
//!
//! ```text
//! x   = (code - black - offset) * inverse_gain        DN, negative values kept
//! x   = x / max(x)                                    all zeros where max(x) <= 0
//! f_c = filter_c(x), cropped to the object            see crate::filter
//! f   = f / max over all c of f                       all zeros where that is <= 0 or an f is not finite
//! out = rcan(f)                                       see crate::nn::rcan; halves, 0 to 1
//! ```
//! Both divisions are rounded once to binary32; f is stored as halves before and after. The maxima can also be held
//! from an earlier frame ([`Field`]).
//!
//! A [`Pipeline`] is immutable and borrows a [`Network`](crate::blob::Network). The mutable state is the caller's
//! memory ([`Memory`]): fast scratch and a bulk arena, at least of the sizes of [`Pipeline::plan`]. More fast scratch
//! allows taller bands and wider strips, which is faster and does not change a bit. The content of the memory before a
//! run does not matter.
//!
//! ```
//! use ommatidia_shared::blob::{Bank, Header, MemoryPlan, Network, Rcan, Sensor, Size, Tap, Weights};
//! use ommatidia_shared::num::f16;
//! use ommatidia_shared::pipeline::{Memory, Pipeline};
//!
//! let taps = [Tap { channel: 0, dy: 0, dx: 0 }].into_iter().collect();
//! let mut header = Header {
//!     name: "example".try_into().unwrap(),
//!     checkpoint: "".try_into().unwrap(),
//!     frame: Size { rows: 8, cols: 8 },
//!     object: Size { rows: 4, cols: 4 },
//!     sensor: Sensor { black_level_dn: 64.0, saturation_dn: 1023, has_offset_map: false, has_gain_map: false },
//!     bank: Bank { tile: 8, step: 8, channels: 1, taps, blocks: None },
//!     rcan: Rcan { width: 1, groups: 1, blocks: 1, reduction: 1 },
//!     memory: MemoryPlan { fast_bytes: 0, bulk_bytes: 0 },
//!     integers: None,
//!     passes: None,
//!     watch: None,
//! };
//! header.memory = Pipeline::plan(&header).unwrap();
//!
//! // A filter that is the identity, and an enhancement network of zeros: the reconstruction is sigmoid(0) everywhere.
//! let mut filters = [f16::ZERO; 80];
//! filters.chunks_mut(2).for_each(|number| number[0] = f16::ONE);
//! let rcan = [f16::ZERO; 131];
//! let weights =
//!     Weights { filters: &filters, index: &[], rcan: &rcan, offset_dn: None, inverse_gain: None, convolutions: None,
//!         predictor: &[], watch: Default::default() };
//! let network = Network::new(header, weights).unwrap();
//! let pipeline = Pipeline::new(&network).unwrap();
//!
//! let mut frame = [64; 64];
//! frame[4 * 8 + 4] = 1064;
//! let (mut fast, mut bulk) = (vec![0.0; pipeline.fast_len()], vec![f16::ZERO; pipeline.bulk_len()]);
//! let mut output = vec![f16::ZERO; pipeline.output_len()];
//! let stats = pipeline.run(&frame, Memory { fast: &mut fast, bulk: &mut bulk }, &mut output).unwrap();
//! assert_eq!((stats.saturated_px, stats.frame_max_dn), (1, 1000.0));
//! assert!((stats.filter_max - 1.0).abs() < 1e-3, "the frame divided by its maximum");
//! assert!(output.iter().all(|&pixel| pixel == f16::from_f32(0.5)));
//! ```

mod error;
mod field;
mod holder;
mod later;
mod passes;
mod reconstruct;
mod validate;

pub use error::PipelineError;
pub use field::{Field, GROWTH, Stats};
pub use holder::{HeldRegion, Holder};
pub use reconstruct::{Memory, Pipeline};

#[cfg(test)]
mod pass_tests;
#[cfg(test)]
mod tests;
