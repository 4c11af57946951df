//! The act of calibration: session -> instrument.
//!
//! [`calibrate`] measures noise, chief rays and bead windows, fits the low-rank model (`model`) and the refits that
//! show its uncertainty (`replicates`), predicts bead frames with refits that have not seen them (`frames`), and fixes
//! the unit of light (`light_unit`). It notes where the PSFs between the positions of the scan are known less well than
//! the noise allows (`coarse`). A session without a bead scan calibrates the sensor alone (`sensor_only`).
//!
//! ```
//! use ommatidia_model::calibrate::{CalibrateConfig, calibrate};
//! use ommatidia_session::Session;
//! use ommatidia_model::testing::Testbed;
//!
//! // A synthetic bench of 2 x 2 lenses writes a session: darks, flats and a scan of 5 x 5 bead positions.
//! let folder = tempfile::tempdir()?;
//! let bench = Testbed { scan: 5, scenes: 0, ..Testbed::new() };
//! bench.write(folder.path());
//!
//! let config = CalibrateConfig { replicates: 0, ..CalibrateConfig::default() };
//! let instrument = calibrate(&Session::open(folder.path())?, &config, || ())?.instrument;
//! assert!((instrument.noise.gain_dn_per_e / bench.gain_dn_per_e - 1.0).abs() < 0.02);
//! assert!((instrument.geometry.anchors_px[0][0] - bench.anchors_px[0][0]).abs() < 0.1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod coarse;
mod error;
mod figures;
mod frames;
mod light_unit;
mod model;
mod replicates;
mod sensor_only;
mod session;

pub use error::CalibrateError;
pub use figures::{PixelReadNoise, frames_read, provenance, response_rms};
pub use session::{CalibrateConfig, Calibration, calibrate};
