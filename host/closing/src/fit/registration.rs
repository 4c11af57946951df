//! The columns of the registrations of truths ([`super::truth`]).

use super::state::Column;
use super::truth::PARTS;
use crate::data::Registration;

/// The columns of the registrations that are free: those of truths whose place is uncertain.
pub(super) fn columns(groups: &[Registration]) -> impl Iterator<Item = Column> {
    let free = groups.iter().enumerate().filter(|(_, g)| g.sigma_px > 0.0);
    free.flat_map(|(g, _)| (0..PARTS).map(move |part| Column::Registration(g, part)))
}
