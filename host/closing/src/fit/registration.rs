//! What a session states of the places of its truths, as one more cell of the design.
//!
//! The prior of [`super::truth`] is an observation "0 +- sigma" of each value. In a cell it counts in the fit, in every
//! score test and in every error, without a rule of its own.

use super::cell::Cell;
use super::model::Model;
use super::state::{Column, State};
use super::truth::PARTS;
use crate::data::Registration;
use ndarray::Array2;

/// The columns of the registrations that are free: those of truths whose place is uncertain.
pub(super) fn columns(groups: &[Registration]) -> impl Iterator<Item = Column> {
    let free = groups.iter().enumerate().filter(|(_, g)| g.sigma_px > 0.0);
    free.flat_map(|(g, _)| (0..PARTS).map(move |part| Column::Registration(g, part)))
}

/// The cell of what the session states: each value is 0 within its standard deviation. None: nothing is stated. Its
/// indices of frame and block are two past the last.
pub(super) fn statement(model: &Model<'_>, state: &State, columns: &[Column], replicates: usize) -> Option<Cell> {
    let groups = &model.seen.registrations;
    if groups.iter().all(|g| g.sigma_px == 0.0) {
        return None;
    }
    let rows = columns.len() + replicates + 1;
    let mut x = Array2::<f32>::zeros((rows, groups.len() * PARTS));
    for (g, (group, values)) in groups.iter().zip(&state.registration).enumerate().filter(|(_, g)| g.0.sigma_px > 0.0) {
        for (part, value) in values.iter().enumerate() {
            let at = g * PARTS + part;
            x[[rows - 1, at]] = (-value / group.sigma_px) as f32;
            if let Some(column) = columns.iter().position(|c| *c == Column::Registration(g, part)) {
                x[[column, at]] = (1.0 / group.sigma_px) as f32;
            }
        }
    }
    let [frame, block] = place(model);
    Some(Cell { frame, block, held_out: false, pixels: 0.0, gram: x.dot(&x.t()), log_variance: 0.0 })
}

/// Whether a cell is that of [`statement`].
pub(crate) fn is_statement(model: &Model<'_>, cell: &Cell) -> bool {
    [cell.frame, cell.block] == place(model)
}

fn place(model: &Model<'_>) -> [usize; 2] {
    [model.seen.frames.len() + 1, model.seen.blocks.len() + 1]
}
