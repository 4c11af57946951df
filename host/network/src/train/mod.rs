//! Float networks: architectures, layers, loss, schedule, training loop, checkpoints.
//!
//! ```
//! use ommatidia_network::train::ops::fourier::Fourier;
//! use ommatidia_network::train::{Mode, NetworkInput, Network, Preset, weights};
//! use std::sync::Arc;
//!
//! // Frames of 20 x 20 pixels, objects of 8 x 8 pixels, six filters of 32 x 32.
//! let config = Preset::Nano.network([20, 20], [8, 8]);
//! assert_eq!((config.filter_size, config.channels), (32, 6));
//! // A network whose weights are all 0 reconstructs 1/2 everywhere: its logits are 0.
//! let zeros = weights::random(&config, 1).into_iter().map(|(name, w)| (name, w * 0.0)).collect();
//! let plan = Arc::new(Fourier::new(config.fourier()));
//! let network = Network::new(&config, &plan, &zeros, Mode::Infer)?;
//! let frame = vec![1.0; 20 * 20];
//! let output = network.forward(vec![NetworkInput::of(&config, &plan, &frame)]);
//! assert_eq!(output.logits.dims(), [1, 1, 8, 8]);
//! assert!(ommatidia_network::train::network::values(output.logits).iter().all(|logit| *logit == 0.0));
//! # Ok::<(), ommatidia_network::train::TrainError>(())
//! ```

mod adam;
mod architecture;
mod backend;
mod checkpoint;
mod config;
mod enhancement;
mod error;
mod estimator;
mod feature_steps;
mod feedback;
mod filter_mask;
mod inference;
mod lenses;
mod loader;
mod loss;
pub mod network;
mod network_input;
mod normalise;
pub mod ops;
mod pairs;
mod predictor;
pub mod pth;
pub mod regression;
mod request;
mod rounding;
mod sample;
mod settings;
mod simulated;
mod task;
#[cfg(test)]
pub(crate) mod testing;
mod trainer;
pub mod weights;

pub use adam::MeanNorms;
pub use architecture::{Architecture, ArchitectureName};
pub use backend::{Backend, Mode};
pub use checkpoint::{Body, Checkpoint, CurvePoint, KIND, VERSION};
pub use config::NetworkConfig;
pub use enhancement::Enhancement;
pub use error::TrainError;
pub use estimator::Estimator;
pub use feature_steps::{FeatureSteps, Features};
pub use feedback::Feedback;
pub use filter_mask::{FilterMask, block_lags, tap_lags};
pub use inference::Inference;
pub use lenses::{Lenses, pseudo_inverse};
pub use loader::{Draw, Example, Loader};
pub use loss::{Loss, bce_mse, nrmse};
pub use network::{Network, NetworkOutput};
pub use network_input::NetworkInput;
pub use normalise::{normalise, normalised};
pub use pairs::{Pair, PairSource};
pub use predictor::Predictor;
pub use request::TrainRequest;
pub use rounding::MOST_WEIGHT;
pub use sample::Sample;
pub use settings::{FINE_TUNE_RATE, Preset, Start, TrainConfig};
pub use simulated::Simulated;
pub use task::Task;
pub use trainer::{Next, Progress, Trainer};
