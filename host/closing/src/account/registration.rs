//! What the account says of the places of the truths.

use super::result::{TruthRegistration, Value};
use crate::evidence::Scores;
use crate::fit::{Column, Design, Errors, Fitted, Model, Replicas, Scope, fitted_columns};
use ommatidia_model::forward::ForwardError;
use ommatidia_physics::effects::Stage;

/// Squared correlation of signatures from which two causes can hardly be distinguished.
const ALIKE: f64 = 0.95;
/// A registration that is off by more than this many of its stated standard deviations contradicts the statement.
const STATED: f64 = 3.0;

/// The registrations that were fitted, with their errors. Where terms stay that are no causes, `without` is the fit
/// without them: by what they move a registration it is uncertain.
///
/// # Errors
/// An object holds negative or non-finite light.
pub(crate) fn registrations(
    model: &Model<'_>,
    now: &Fitted,
    without: Option<&Fitted>,
    replicas: &Replicas,
) -> Result<Vec<TruthRegistration>, ForwardError> {
    let groups = &model.seen.registrations;
    if groups.iter().all(|g| g.sigma_px == 0.0) {
        return Ok(Vec::new());
    }
    let columns: Vec<Column> = fitted_columns(model, &now.state);
    let design =
        Design::compute(model, now.expansion(&[]), columns.clone(), &replicas.of(model, now)?, Scope::Training)?;
    let mut out = Vec::new();
    for (g, group) in groups.iter().enumerate().filter(|(_, g)| g.sigma_px > 0.0) {
        let of_group = |i: &usize| matches!(columns[*i], Column::Registration(of, _) if of == g);
        let (mine, others) = (0..columns.len()).partition(of_group);
        let Some(test) = Scores::new(&design, others).test(&mine) else { continue };
        let moved =
            |part: usize| without.map_or(0.0, |fit| now.state.registration[g][part] - fit.state.registration[g][part]);
        let value = |part: usize, name: &str, unit: &str, factor: f64| Value {
            name: name.into(),
            value: factor * now.state.registration[g][part],
            sigma: factor * test.covariance[[part, part]].sqrt().hypot(moved(part)),
            sigma_noise: factor * test.noise[[part, part]].sqrt(),
            unit: unit.into(),
        };
        let grid = model.grid;
        out.push(TruthRegistration {
            stack: group.stack,
            frame: group.frame,
            stated_px: group.sigma_px,
            params: vec![
                value(0, "row_px", "object px", 1.0),
                value(1, "col_px", "object px", 1.0),
                value(2, "turn_mrad", "mrad", grid.turn_mrad(1.0)),
                value(3, "scale", "1", grid.scale(1.0)),
            ],
            corner_px: now.state.registration[g],
        });
    }
    Ok(out)
}

/// Notes on the registrations that were fitted.
pub(crate) fn registration_notes(all: &[TruthRegistration]) -> Vec<String> {
    let Some(first) = all.first() else { return Vec::new() };
    let mut notes = Vec::new();
    if all.iter().any(|r| r.frame.is_some()) {
        let size = |r: &TruthRegistration| r.corner_px.iter().map(|v| v * v).sum::<f64>() / r.corner_px.len() as f64;
        let rms = (all.iter().map(size).sum::<f64>() / all.len() as f64).sqrt();
        notes.push(format!(
            "registration of the truths, frame by frame: {rms:.3} object pixels rms in {} frames, where the session \
             states {}; fitted beside the effects. No scene was held out, since each frame alone shows where its truth \
             lies: the held-out blocks judge",
            all.len(),
            first.stated_px
        ));
    } else {
        notes.extend(all.iter().map(|r| {
            let words = |v: &Value| {
                let digits = if v.unit == "1" { 5 } else { 3 };
                format!("{} {:+.digits$} +- {:.digits$}", v.name, v.value, v.sigma)
            };
            format!(
                "registration of the truths of stack {}: {} (the session states {} object pixels); fitted beside the \
                 effects",
                r.stack,
                r.params.iter().map(words).collect::<Vec<_>>().join(", "),
                r.stated_px
            )
        }));
    }
    let beyond = |r: &&TruthRegistration| r.corner_px.iter().any(|v| v.abs() > STATED * r.stated_px);
    let stacks: std::collections::BTreeSet<usize> = all.iter().filter(beyond).map(|r| r.stack).collect();
    notes.extend(stacks.into_iter().map(|stack| {
        format!(
            "the truths of stack {stack} lie further off than three times what the session states: either the \
             statement is too narrow, or the array, the sensor or the stage has moved; a bead scan in a session \
             without truths distinguishes them"
        )
    }));
    notes
}

/// Notes on effects that move the images as misplaced truths would, where the session takes its truths for exact. The
/// first `own` terms of the state belong to the instrument.
///
/// # Errors
/// An object holds negative or non-finite light.
pub(crate) fn unstated_notes(model: &Model<'_>, now: &Fitted, own: usize) -> Result<Vec<String>, ForwardError> {
    let terms = &now.state.terms;
    let moves = |t: &usize| terms[*t].effect.descriptor().stage == Stage::Geometry;
    let moving: Vec<usize> = (own..terms.len()).filter(moves).collect();
    let exact: Vec<usize> =
        (0..model.seen.registrations.len()).filter(|g| model.seen.registrations[*g].sigma_px == 0.0).collect();
    if moving.is_empty() || exact.is_empty() {
        return Ok(Vec::new());
    }
    let mut columns: Vec<Column> = fitted_columns(model, &now.state);
    let fitted = columns.len();
    columns.extend(exact.iter().flat_map(|g| (0..4).map(|part| Column::Registration(*g, part))));
    let places: Vec<usize> = (fitted..columns.len()).collect();
    let design = Design::compute(model, now.expansion(&[]), columns.clone(), &Errors::default(), Scope::Training)?;
    let alike = |t: &usize| {
        let term = &terms[*t];
        let expanded = term.expanded(model.lenses());
        let strength = |param: usize| expanded[param].1.is_strength();
        let of_term = |i: &usize| matches!(columns[*i], Column::Own { term, param } if term == *t && strength(param));
        let (mine, others): (Vec<usize>, Vec<usize>) = (0..fitted).partition(of_term);
        let theta: Vec<f64> = term
            .strengths(model.lenses())
            .into_iter()
            .map(|i| expanded[i].1.inner(term.params[i]) - expanded[i].1.inner(expanded[i].1.off))
            .collect();
        Scores::new(&design, others).overlap(&mine, &theta, &places)
    };
    let note = |t: &usize| {
        let overlap = alike(t);
        (overlap > ALIKE).then(|| {
            format!(
                "{}: a misplaced truth moves the images of all lenses in the same way (overlap {overlap:.2}), and this \
                 session takes its truths for exact; if another camera took them, state how well they are placed \
                 (`truth_registration_px` of their stack)",
                terms[*t].id()
            )
        })
    };
    Ok(moving.iter().filter_map(note).collect())
}
