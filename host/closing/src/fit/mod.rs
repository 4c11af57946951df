//! Predicts the frames of a session from a state, and fits the state.
//!
//! [`state`] holds effects and nuisance parameters, [`model`] makes the light of frames of them, which states share
//! (`scenes`, `in_use`), and `predict` the frames with their residuals, [`derivative`] their derivatives, [`design`]
//! sums these over [`cell`]s, `repeats` adds what repeated frames show of the noise (by its `features`, with `kurtosis`
//! the few pixels that scatter more than the others, and `rhythm` a wave in their rows), and `same` says which frames
//! of unknown specimens are repeats; [`mod@refit`] finds the best state. [`truth`] moves truths that are not quite in
//! place, `registration` names the values, and `prior` adds what is known of nuisances beside the frames. [`lamp`] is
//! the light of the flats. Before the first fit [`record`] checks the session's objects, `orientation` whether frames
//! are turned, [`exposures`], `units` and `flicker` their light (`scene_light`), and [`pedestal`] how dark they are
//! where they are dark. [`mod@replicas`] gives the uncertainty of the calibration as [`errors`], with `wings` outside
//! its windows. [`specimen`] estimates specimens that nobody knows, and [`projection`] takes out of frames what they
//! can make.

pub mod cell;
pub mod derivative;
pub mod design;
pub mod errors;
pub mod exposures;
pub(crate) mod features;
pub(crate) mod flicker;
pub(crate) mod gauge;
mod in_use;
mod kurtosis;
pub mod lamp;
pub mod model;
mod orientation;
pub mod pedestal;
mod predict;
pub(crate) mod prior;
pub mod projection;
pub mod record;
pub mod refit;
mod registration;
pub(crate) mod repeats;
pub mod replicas;
mod rhythm;
mod same;
pub(crate) mod scene_light;
mod scenes;
pub mod solve;
pub mod specimen;
pub mod state;
pub mod truth;
pub(crate) mod units;
pub(crate) mod wings;

pub use cell::Cell;
pub use derivative::Expansion;
pub use design::{Design, Misfit, Scope, Sums, nuisances};
pub use errors::Errors;
pub(crate) use errors::map_errors;
pub use model::Model;
pub(crate) use model::PUPIL_DEFOCUS;
pub(crate) use orientation::orientation;
pub use projection::Specimens;
pub use refit::{Fitted, fitted_columns, own_columns, refit, refit_from, refit_from_within, refit_within};
pub use replicas::{Replicas, replicas};
pub(crate) use rhythm::rhythm;
pub use scenes::Scenes;
pub use solve::pseudo_inverse;
pub use specimen::estimate_specimens;
pub(crate) use specimen::{UNKNOWN_NOTE, chosen_notes, estimated_frames};
pub use state::{Column, Predicted, State, Term};
pub use truth::Registered;
