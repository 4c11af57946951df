//! From a checkpoint to the network file of a device: filters as taps or blocks, weights as halves or integers,
//! memory plan, budget.
//!
//! ```
//! use ndarray::Array2;
//! use ommatidia_network::network_file::NetworkFile;
//! use ommatidia_physics::noise::NoiseModel;
//! use ommatidia_network::quantize::{QuantizeConfig, quantize};
//! use ommatidia_network::train::{Checkpoint, Preset, weights};
//! use std::path::Path;
//!
//! let network = Preset::Nano.network([20, 20], [8, 8]);
//! let weights = weights::random(&network, 1);
//! let checkpoint = Checkpoint::untrained(network, NoiseModel::nominal(), Preset::Nano.training(1e4, 1), weights);
//!
//! let made = quantize(&checkpoint, "", &QuantizeConfig { name: "tiny".into(), ..QuantizeConfig::default() })?;
//! // Six dense filters: spectra of 32 rows and 17 columns, two halves each.
//! assert_eq!((made.report.taps, made.report.dense_filter_bytes), (6, 6 * 32 * 17 * 2 * 2));
//! let file = NetworkFile::from_bytes(Path::new("tiny"), &made.bytes)?;
//! assert_eq!(file.header()?.name.as_str(), "tiny");
//! let frame_dn = Array2::from_shape_fn((20, 20), |(row, col)| (64 + row * col) as f32);
//! assert_eq!(file.run(&file.codes(frame_dn.view())?)?.len(), 8 * 8);
//! # Ok::<(), anyhow::Error>(())
//! ```

mod allowed;
mod bank;
mod choose;
mod config;
mod error;
mod integers;
mod make;
mod mask;
mod pack;
mod passes;
mod plane;
mod ranges;
mod report;
#[cfg(test)]
mod tests;

pub use choose::BLOCK;
pub use config::{Numbers, QuantizeConfig};
pub use error::QuantizeError;
pub use make::{Quantized, quantize};
pub use mask::{ChosenMask, MaskSource, filter_mask, training_mask};
pub use ranges::training_steps;
pub use report::{Quality, QuantizeReport, Step};
