//! The float network: configuration, layers, losses, schedule, loop, checkpoint.

mod adam;
mod checkpoint;
mod config;
mod error;
mod family;
mod lenses;
mod loss;
pub mod network;
pub mod ops;
mod place;
pub mod pth;
pub mod regression;
mod seen;
mod settings;
mod sight;
mod simulated;
mod source;
mod support;
mod trainer;
pub mod weights;

pub use adam::MeanNorms;
pub use checkpoint::{Body, Checkpoint, CurvePoint, KIND, Sample, SensorMaps, VERSION};
pub use config::NetworkConfig;
pub use error::TrainError;
pub use family::{Family, FamilyName};
pub use lenses::{Lenses, pseudo_inverse};
pub use place::Place;
pub use seen::Seen;
pub use settings::{FINE_TUNE_RATE, Preset, Start, TrainConfig};
pub use sight::Sight;
pub use simulated::Simulated;
pub use source::{Example, Loader, Pair, PairSource, normalise};
pub use support::{Support, block_lags, lags};
pub use trainer::{Next, Progress, Task, Trainer};
