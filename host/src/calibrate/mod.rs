//! The act of calibration: session -> instrument.
//!
//! [`calibrate`] measures noise, chief rays and bead windows, fits the low-rank model ([`model`]) and the refits that show its
//! uncertainty ([`replicates`]), and fixes the unit of light ([`light_unit`]). A session without a bead scan calibrates the
//! sensor alone ([`sensor_only`]).

mod error;
mod light_unit;
mod model;
mod replicates;
mod sensor_only;
mod session;

pub use error::CalibrateError;
pub use session::{CalibrateConfig, Calibration, calibrate};
