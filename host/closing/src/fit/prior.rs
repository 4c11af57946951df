//! What is known of nuisances beside the frames, as one more cell of the design: what a session states of the places of
//! its truths, what a calibration states of light outside its windows, and what its PSFs say of the defocus of each
//! lens.
//!
//! Such a prior is an observation "0 +- sigma" of a value. In a cell it counts in the fit, in every score test and in
//! every error, without a rule of its own.

use super::cell::Cell;
use super::model::{Model, PUPIL_DEFOCUS};
use super::state::{Column, State};
use super::truth::PARTS;
use ndarray::Array2;

/// The cell of the priors of all that is `fitted`, with rows for `columns`. None: there are none. Its indices of frame
/// and block are two past the last.
pub(super) fn cell(
    model: &Model<'_>,
    state: &State,
    (columns, fitted): (&[Column], &[Column]),
    replicates: usize,
) -> Option<Cell> {
    let groups = model.seen.registrations.iter().zip(&state.registration).enumerate();
    let truths = groups.filter(|(_, (group, _))| group.sigma_px > 0.0).flat_map(|(g, (group, values))| {
        (0..PARTS).map(move |part| (Column::Registration(g, part), values[part], group.sigma_px))
    });
    let wings = state.wings.iter().enumerate().map(|(i, value)| (Column::Wing(i), *value, 1.0));
    let all: Vec<(Column, f64, f64)> = truths.chain(wings).chain(pupils(model, state, fitted)).collect();
    if all.is_empty() {
        return None;
    }
    let rows = columns.len() + replicates + 1;
    let mut x = Array2::<f32>::zeros((rows, all.len()));
    for (at, (column, value, sigma)) in all.iter().enumerate() {
        x[[rows - 1, at]] = (-value / sigma) as f32;
        if let Some(row) = columns.iter().position(|c| c == column) {
            x[[row, at]] = (1.0 / sigma) as f32;
        }
    }
    let [frame, block] = place(model);
    Some(Cell { frame, block, held_out: false, pixels: 0.0, gram: x.dot(&x.t()), log_variance: 0.0 })
}

/// The defocus of each lens beyond that of its pupil, where it is fitted.
fn pupils(model: &Model<'_>, state: &State, fitted: &[Column]) -> Vec<(Column, f64, f64)> {
    let at = state.terms.iter().position(|t| t.id() == PUPIL_DEFOCUS);
    let own = |term: usize| (0..model.lenses()).map(move |param| Column::Own { term, param });
    let Some(term) = at.filter(|t| own(*t).any(|c| fitted.contains(&c))) else { return Vec::new() };
    let doubts = own(term).zip(model.forward.doubts_waves()).zip(&state.terms[term].params);
    // A dead lens has none.
    doubts.filter(|((_, sigma), _)| *sigma > 0.0).map(|((column, sigma), value)| (column, *value, sigma)).collect()
}

/// Whether a cell is that of the priors.
pub(crate) fn is_prior(model: &Model<'_>, cell: &Cell) -> bool {
    [cell.frame, cell.block] == place(model)
}

fn place(model: &Model<'_>) -> [usize; 2] {
    [model.seen.frames.len() + 1, model.seen.blocks.len() + 1]
}
