//! The residual maps of the account, and the estimates of unknown specimens.

use super::result::{Account, Closing, SpecimenMaps};
use crate::evidence::pictured_frames;
use crate::fit::{Fitted, Model, State};
use ndarray::{Array2, Array3};

/// The account with the residuals of up to four scenes, held-out ones first.
pub(crate) fn pictured(model: &Model<'_>, before: &Fitted, now: &Fitted, closing: Closing) -> Account {
    let seen = model.seen;
    let mut frames: Vec<usize> = pictured_frames(seen).collect();
    frames.sort_by_key(|k| !seen.frames[*k].held_out);
    frames.truncate(4);
    let pull = |f: &Fitted, k: usize| &f.predicted[k].residual_dn * &f.predicted[k].inverse_sigma;
    let stack = |image: &dyn Fn(usize) -> Array2<f32>| {
        let mut out = Array3::zeros((frames.len(), seen.sensor[0], seen.sensor[1]));
        for (k, mut target) in frames.iter().zip(out.outer_iter_mut()) {
            target.assign(&image(*k));
        }
        out
    };
    Account {
        measured_dn: stack(&|k| seen.frames[k].measured.clone()),
        before: stack(&|k| pull(before, k)),
        after: stack(&|k| pull(now, k)),
        specimens: estimated(&frames, &before.state, &now.state),
        frames: frames.iter().map(|k| seen.frames[*k].info.frame).collect(),
        closing,
    }
}

/// The specimens of `frames` in two states; None where either has none.
fn estimated(frames: &[usize], before: &State, now: &State) -> Option<SpecimenMaps> {
    let stack = |state: &State| {
        let specimens = state.specimens.as_ref()?;
        let objects: Vec<Option<&Array2<f32>>> = frames.iter().map(|k| specimens.object(*k)).collect();
        let (rows, cols) = objects.iter().flatten().next()?.dim();
        let mut out = Array3::from_elem((frames.len(), rows, cols), f32::NAN);
        for (object, mut target) in objects.into_iter().zip(out.outer_iter_mut()) {
            if let Some(object) = object {
                target.assign(object);
            }
        }
        Some(out)
    };
    Some(SpecimenMaps { before: stack(before)?, after: stack(now)? })
}
