//! The frames of a session that the loop uses, and the faults that its records may have.

mod blocks;
mod darks;
mod fault;
mod observe;
mod part;
mod recording;
mod registration;
mod scaled;
mod unit;

pub(crate) use blocks::Blocks;
pub(crate) use darks::{bright_darks, leave_lit_darks_out};
pub(crate) use fault::unit_note;
pub use fault::{Fault, FaultKind};
pub(crate) use observe::bead_is_held_out;
pub use observe::{Budget, Frame, Observations, Shown};
pub(crate) use part::part_of;
pub(crate) use recording::{best_of_parts, content};
pub use registration::Registration;
pub use scaled::ScaledFrames;
pub(crate) use scaled::scaled_frames;
pub use unit::{OtherUnit, ShownBy};
pub(crate) use unit::{ScenesShow, unit_of_flats, unit_of_scenes};
