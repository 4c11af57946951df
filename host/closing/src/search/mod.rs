//! Searches for the effects that a model lacks.
//!
//! [`trials`] lists what is tried, `scoring` gives each its evidence, [`select`] adds one effect after another (forward
//! selection) after full fits of the `finalists` in `confirm`, `exchange` replaces found effects by better ones,
//! `pairs` adds two effects that hide each other, `shadow` names what is no error of a stronger one, `earn` takes out
//! effects that a term without a name makes unnecessary, `prune` removes what is no longer needed (backward
//! elimination), `shares` finds what each of several explains, [`recalibrate`] measures what a new calibration would
//! gain, `moment` finds the moment of a jump, `lost` lists what cannot be tested beside truths of uncertain place.

pub mod candidate;
mod confirm;
pub(crate) mod earn;
mod exchange;
mod finalists;
mod kept;
pub(crate) mod lost;
mod moment;
mod pairs;
pub(crate) mod prune;
pub mod recalibrate;
mod scoring;
pub mod select;
mod shadow;
pub(crate) mod shares;
pub mod trials;

pub use candidate::{Alternative, Candidate, Estimate, Found, Shadowed};
pub(crate) use earn::{Earned, Imitation, earned, replaced};
pub(crate) use kept::Kept;
pub(crate) use lost::lost;
pub(crate) use prune::{Pruned, prune};
pub(crate) use recalibrate::calibration_of;
pub use recalibrate::{held_out_figures, trial_calibration};
pub(crate) use scoring::score;
pub(crate) use select::SHADOW;
pub use select::Search;
pub(crate) use shares::shared;
pub use trials::{NEEDS_CALIBRATION, Tried};
pub(crate) use trials::{evidence, is_laplacian};
