//! The virtual instrument: measures a session by physical optics.
//!
//! The lenses are those of one of three [families](FamilyName), which compute foci by diffraction at pupils, by traced
//! rays, or from given PSFs. The PSF of every lens at every point of the object is computed, and its light is summed on
//! the sensor. Poisson noise, read noise and the converter follow. The virtual instrument does not use the low-rank
//! model that `calibrate` fits; [`truth`] holds the ground truth of a session, for tests.
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use ommatidia_bench::{ArrayConfig, BenchConfig, ObjectConfig, ScanConfig};
//! use ommatidia_physics::effects::EffectSetting;
//! use ommatidia_session::{Role, Session};
//! // One lens before a small sensor; everything else is as in the demo instrument.
//! let mut config = BenchConfig::default();
//! (config.sensor.rows, config.sensor.cols) = (40, 40);
//! config.array = ArrayConfig { rows: 1, cols: 1, pitch_px: 0.0, placement_rms_px: 0.0, lenses_px: None };
//! config.object = ObjectConfig { rows: 12, cols: 12, pixel_um: 2.8 };
//! config.scan = ScanConfig { rows: 2, cols: 2, ..ScanConfig::default() };
//! config.stacks.dark_frames = 2;
//! config.stacks.scene_frames = 1;
//! // Inject an effect: all chief rays are shifted by 1 pixel along the columns.
//! let instrument = config.build(&[EffectSetting::new("array_shift", &[("col_px", 1.0)])])?;
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("session");
//! let summary = instrument.measure(&path, 1, |_new_frames| ())?;
//! assert_eq!((summary.frames["bead"], summary.frames["dark"]), (4, 2));
//! let session = Session::open(&path)?;
//! let dark = session.need(Role::Dark)?[0].frames()?.read(0)?;
//! assert!((dark.mean().unwrap_or(0.0) - 64.0).abs() < 1.0); // the black level, DN
//! # Ok(())
//! # }
//! ```

mod cache;
mod check;
mod config;
mod drawn;
mod error;
mod family;
mod foci;
mod instrument;
mod live;
mod measure;
mod open;
mod optics;
mod scenes;
mod sensor;
mod stacks;
pub mod truth;

pub use config::{
    AberrationConfig, ArrayConfig, BenchConfig, ObjectConfig, OpticsConfig, ScanConfig, SensorConfig, StackConfig,
};
pub use drawn::MeasuredPsfs;
pub use error::BenchError;
pub use family::config::{FamilyName, KernelsConfig, RelayConfig, StackOf};
pub use instrument::{Summary, VirtualInstrument};
pub use measure::virtual_session;
pub use open::open_session;

#[cfg(test)]
mod tests;
