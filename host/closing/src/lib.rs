//! Closing the loop: measure the residual between model and measurement, find the effect that the model lacks, add it.
//!
//! The folders follow the data, and none imports a later one:
//!
//! | folder | what it does |
//! |---|---|
//! | [`data`] | reads the frames of a session and fixes the hold-outs before any fit |
//! | [`fit`] | predicts the frames from a state (effects and nuisance parameters) and fits that state |
//! | [`evidence`] | tests the residual of a fit: omnibus tests, score tests, pixel tables, figures on held-out data |
//! | [`search`] | adds effects that the evidence supports and removes those that are not needed |
//! | [`plan`] | finds the measurements that would separate what is ambiguous |
//! | [`account`] | reports what was found, with errors, detection limits and ambiguities |
//!
//! [`close()`] runs all of it on observations in memory, [`close_session`] on files.
//!
//! A small virtual instrument is calibrated; then its lens array is shifted by a quarter of a pixel, and the loop finds
//! the shift from three scenes:
//!
//! ```
//! # fn main() -> anyhow::Result<()> {
//! use ommatidia_bench::{ArrayConfig, BenchConfig, ObjectConfig};
//! use ommatidia_closing::{Budget, CloseOptions, Observations, close};
//! use ommatidia_physics::effects::EffectSetting;
//! use ommatidia_model::calibrate::{CalibrateConfig, calibrate};
//! use ommatidia_session::{Role, Session};
//!
//! let mut bench = BenchConfig::default();
//! (bench.sensor.rows, bench.sensor.cols) = (50, 70);
//! bench.array = ArrayConfig { rows: 1, cols: 2, pitch_px: 20.0, placement_rms_px: 0.3, lenses_px: None };
//! bench.optics.aperture_um = 20.0;
//! bench.optics.psf_window_px = 13;
//! bench.optics.object_distance_um = 300.0;
//! bench.optics.psf_field_px = 31;
//! bench.object = ObjectConfig { rows: 18, cols: 22, pixel_um: 2.8 };
//! (bench.scan.rows, bench.scan.cols) = (5, 5);
//! (bench.stacks.dark_frames, bench.stacks.flat_frames, bench.stacks.scene_frames) = (4, 4, 3);
//!
//! let folder = tempfile::tempdir()?;
//! let before = folder.path().join("before");
//! bench.build(&[])?.measure(&before, 1, |_| ())?;
//! let config = CalibrateConfig { rank: Some(4), replicates: 4, ..CalibrateConfig::default() };
//! let instrument = calibrate(&Session::open(&before)?, &config, || {})?.instrument;
//!
//! let after = folder.path().join("after");
//! let shift = EffectSetting::new("array_shift", &[("row_px", 0.25)]);
//! bench.build(&[shift])?.measure_some(&after, 2, &[Role::Scene], |_| ())?;
//! let mut seen = Observations::read(&Session::open(&after)?, &Budget::default())?;
//! let closed = close(&instrument, &mut seen, &CloseOptions { seed: 1, ..CloseOptions::default() }, |_| ())?;
//!
//! let result = &closed.account.closing;
//! let found = &result.effects[0];
//! assert_eq!(found.id, "array_shift");
//! assert!((found.params[0].value - 0.25).abs() < 0.02, "{:?}", found.params);
//! assert!(result.after.chi2_ndf < result.before.chi2_ndf);
//! # Ok(())
//! # }
//! ```

pub mod account;
mod again;
mod attempt;
mod close;
pub mod data;
pub mod evidence;
mod files;
pub mod fit;
mod layout;
mod options;
pub mod plan;
mod records;
pub mod search;
mod sensor;
pub mod study;

pub use account::{
    Account, Closed, Closing, Control, Effect, Filed, Nearest, Rejected, Retrain, RetrainRequest, Retrained,
    SpecimenMaps, TruthRegistration, Value, Verdict,
};
pub use close::{close, residual};
pub use data::{Budget, Fault, FaultKind, Observations};
pub use evidence::{Covariate, Curve, Dependence, Figures, JudgedOn};
pub use files::{
    CloseOutcome, CloseRequest, FineTuning, Progress, ResidualOutcome, ResidualRequest, account_path, close_session,
    residual_session,
};
pub use layout::check_layout;
pub use options::{CalibratedOn, CloseError, CloseOptions};
pub use plan::{Advice, Goal, Plan};

#[cfg(test)]
mod tests;
