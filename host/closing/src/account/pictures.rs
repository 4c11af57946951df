//! The residual maps of the account, and the estimates of unknown specimens.

use super::result::{Account, Closing, SpecimenMaps};
use crate::evidence::pictured_frames;
use crate::fit::{Fitted, Model, State};
use ndarray::{Array2, Array3, Axis};

/// Most frames with pictures.
const PICTURED: usize = 4;

/// The account with the residuals of up to four scenes, held-out ones first.
pub(crate) fn pictured(model: &Model<'_>, before: &Fitted, now: &Fitted, closing: Closing) -> Account {
    let seen = model.seen;
    let mut frames: Vec<usize> = pictured_frames(seen).collect();
    frames.sort_by_key(|k| !seen.frames[*k].held_out);
    frames.truncate(PICTURED);
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
        specimens: estimated(model, &before.state, &now.state),
        frames: frames.iter().map(|k| seen.frames[*k].info.frame).collect(),
        closing,
    }
}

/// The first specimens that two states have both estimated.
fn estimated(model: &Model<'_>, before: &State, now: &State) -> Option<SpecimenMaps> {
    let of = |state: &State, k: usize| state.specimens.as_ref().and_then(|s| s.object(k).cloned());
    let all = 0..model.seen.frames.len();
    let both: Vec<usize> = all.filter(|k| of(before, *k).is_some() && of(now, *k).is_some()).take(PICTURED).collect();
    let stack = |state: &State| {
        let objects: Vec<Array2<f32>> = both.iter().filter_map(|k| of(state, *k)).collect();
        ndarray::stack(Axis(0), &objects.iter().map(|o| o.view()).collect::<Vec<_>>()).ok()
    };
    let frames = both.iter().map(|k| model.seen.frames[*k].info.frame).collect();
    Some(SpecimenMaps { frames, before: stack(before)?, after: stack(now)? })
}
