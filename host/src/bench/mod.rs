//! The virtual instrument: measures a session by physical optics.
//!
//! Each lens has a pupil with aberrations of its own that change over the field. The PSF of every lens at every point of the
//! object is computed by diffraction, sampled finer than the pixels, and its light is summed on the sensor; then come the Poisson
//! draw, the reading and the converter. Nothing here knows of the low-rank model that `calibrate` fits: [`truth`]
//! says what was true, and only tests read it.

mod cache;
mod config;
mod error;
mod lens;
mod live;
mod measure;
mod open;
mod optics;
mod scenes;
mod sensor;
pub mod truth;

pub use config::{
    AberrationConfig, ArrayConfig, BenchConfig, ObjectConfig, OpticsConfig, ScanConfig, SensorConfig, StackConfig,
};
pub use error::BenchError;
pub use measure::{Summary, VirtualInstrument};
pub use open::open_session;

#[cfg(test)]
mod tests;
