//! The account of a closed loop: effects with errors, detection limits, ambiguities, figures before and after.
//!
//! [`result`] defines it, `describe` writes the effects, `names` decides which are causes, `pictures` adds residual
//! maps, `registration` says where the truths lie, `rest` where what is left lies, `adopt` records a new
//! calibration, [`retrain`] what a fine-tuned network gains, [`mod@file`] stores it all.

pub(crate) mod adopt;
pub(crate) mod describe;
pub mod file;
mod names;
pub(crate) mod pictures;
mod pupils;
mod registration;
mod rest;
pub mod result;
pub mod retrain;
mod verdict;

pub use adopt::{Recalibrated, adopt};
pub(crate) use describe::{Accepted, Findings, by_depth, effects, fault, rejected, values};
pub use file::{KIND, VERSION};
pub(crate) use names::{Judged, Names, ROW_NOISE, end_notes};
pub(crate) use pictures::pictured;
pub(crate) use pupils::pupil_note;
pub(crate) use registration::{registration_notes, registrations, unstated_notes};
pub(crate) use rest::rest_notes;
pub use result::{
    Account, Closed, Closing, Effect, Nearest, Rejected, SpecimenMaps, TruthRegistration, Value, Verdict,
};
pub use retrain::{Control, Filed, Retrain, RetrainRequest, Retrained};
pub(crate) use verdict::{
    Excess, Left, calibration_note, harmful, imitated, quiet, shadowed, small_note, within_calibration,
};
