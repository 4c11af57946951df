//! The trial terms of the search: effects of the catalogue at their starting values, and terms without a name.

use crate::data::Shown;
use crate::fit::{Fitted, Model, State, Term};
use ommatidia_physics::effects::{
    Effect, Evidence, EvidenceFrame, KNOTS, Kind, OPERATORS, Stage, WEIGHTS, find, periods, registry,
};
use ommatidia_session::Role;

/// Id of the effect that stands for PSFs that must be calibrated again.
pub const NEEDS_CALIBRATION: &str = "rank_truncation";

/// A family of trial terms.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tried {
    /// The effects of the catalogue.
    Catalogue,
    /// Operators and curves without a name.
    Curves,
    /// Maps of the sensor without a name.
    Maps,
}

impl Tried {
    /// The terms at their starting values. Effects with a table are estimated instead
    /// ([`crate::evidence::tables`]).
    pub(crate) fn terms(self, model: &Model<'_>, state: &State, evidence: &Evidence<'_>) -> Vec<Term> {
        match self {
            Self::Catalogue => catalogue(model, state, evidence),
            Self::Curves => unknowns(model, state, evidence),
            Self::Maps => Vec::new(),
        }
    }
}

/// Every effect of the catalogue that is not in the state and can show in these frames, at each of its starting values.
fn catalogue(model: &Model<'_>, state: &State, evidence: &Evidence<'_>) -> Vec<Term> {
    let lenses = model.lenses();
    let mut terms = Vec::new();
    for effect in registry().iter().copied() {
        let d = effect.descriptor();
        let taken = state.terms.iter().any(|t| t.id() == d.id);
        let skip = d.stage == Stage::Record || effect.table().is_some() || d.id.starts_with("unknown");
        let no_truths = effect.is_of_truths() && !truths_alone(model, state);
        if taken || skip || no_truths || model.is_blind() && !effect.is_of_the_grid() {
            continue;
        }
        let mut starts = effect.guess(evidence);
        if starts.is_empty() {
            starts = grid(effect, lenses);
        }
        terms.extend(starts.into_iter().map(|params| Term { effect, params, table: None, table_error: 0.0 }));
    }
    terms.extend(blurred_truths(model, state));
    terms.extend(gradient(model, state));
    terms
}

/// Effects that displace the images of all lenses as truths do that lie beside the object.
const DISPLACE: [&str; 5] = ["array_shift", "stage_scale", "magnification", "array_rotation", "sensor_rotation"];

/// The Laplacian of the light, where images are displaced or the session states that its truths may be: such truths
/// were often interpolated, or taken by a camera of less resolution. Scenes are sharper than such truths predict, which
/// is no sign of the optics. It stands beside the effects of the catalogue, so that one that sharpens images is named
/// only if it explains more.
fn blurred_truths(model: &Model<'_>, state: &State) -> Option<Term> {
    if !displaced(model, state) || !model.sees_known_light() || state.terms.iter().any(is_laplacian) {
        return None;
    }
    let params = vec![0.0, LAPLACIAN, 0.0];
    Some(Term { effect: find("unknown_operator")?, params, table: None, table_error: 0.0 })
}

/// A factor on the light that changes slowly over the sensor, from no cause that the catalogue has. Gains of the lenses
/// follow it in steps, with more values. It stands beside the effects of the catalogue, so that one that follows it is
/// named only if it explains more.
fn gradient(model: &Model<'_>, state: &State) -> Option<Term> {
    let effect = find(GRADIENT)?;
    if model.is_blind() || state.terms.iter().any(|t| t.id() == GRADIENT) {
        return None;
    }
    let params = effect.descriptor().params.iter().map(|p| p.off).collect();
    Some(Term { effect, params, table: None, table_error: 0.0 })
}

/// Id of that factor.
pub(super) const GRADIENT: &str = "unknown_gradient";

/// Whether images are displaced as misplaced truths displace them, or the session states that its truths may be.
fn displaced(model: &Model<'_>, state: &State) -> bool {
    let stated = model.seen.registrations.iter().any(|g| g.sigma_px > 0.0);
    stated || state.terms.iter().any(|t| DISPLACE.contains(&t.id()))
}

/// Whether all scenes show known specimens, and nothing displaces their images as misplaced truths do, which have a
/// Laplacian of their own.
fn truths_alone(model: &Model<'_>, state: &State) -> bool {
    let mut scenes = model.seen.of(Role::Scene).peekable();
    !displaced(model, state)
        && scenes.peek().is_some()
        && scenes.all(|k| matches!(model.seen.frames[k].shown, Shown::Object(_)))
}

/// Index of the Laplacian among [`OPERATORS`].
const LAPLACIAN: f64 = 3.0;

/// Whether a term is the Laplacian of the light with the same weight everywhere. Its amplitude is negative where scenes
/// are sharper than their truths predict.
pub(crate) fn is_laplacian(term: &Term) -> bool {
    term.id() == "unknown_operator" && term.params[1..] == [LAPLACIAN, 0.0]
}

/// The starting values that a descriptor lists: every combination of its shapes and of strengths far from where the
/// effect is absent.
fn grid(effect: &'static dyn Effect, lenses: usize) -> Vec<Vec<f64>> {
    let mut starts = vec![Vec::new()];
    for (_, p) in effect.descriptor().expanded(lenses) {
        let values = match p.kind {
            Kind::Shape(tried) if !tried.is_empty() => tried.to_vec(),
            _ => [&[p.off], p.far].concat(),
        };
        starts = starts.iter().flat_map(|s| values.iter().map(move |v| [s.as_slice(), &[*v]].concat())).collect();
    }
    starts
}

/// Residuals of the training frames, for effects that estimate their starting values from them.
pub(crate) fn evidence<'c>(model: &'c Model<'_>, fitted: &'c Fitted) -> Evidence<'c> {
    let frame = |k: usize| {
        let here = &fitted.predicted[k];
        EvidenceFrame {
            cx: model.context(k, None),
            residual_dn: here.residual_dn.clone(),
            light_e: here.light_e.clone(),
            weight: here.inverse_sigma.mapv(|w| w * w),
        }
    };
    let training = (0..model.seen.frames.len()).filter(|k| !model.seen.frames[*k].held_out);
    Evidence { frames: training.map(frame).collect() }
}

/// The terms without a name: operators by weights, and curves over covariates.
fn unknowns(model: &Model<'_>, state: &State, evidence: &Evidence<'_>) -> Vec<Term> {
    let mut terms = Vec::new();
    if !model.sees_known_light() {
        return terms;
    }
    if let Some(effect) = find("unknown_operator") {
        for (operator, weight) in (0..OPERATORS.len()).flat_map(|o| (0..WEIGHTS.len()).map(move |w| (o, w))) {
            // Operator 0 with weight 0 is the light itself, a nuisance parameter already.
            if (operator, weight) != (0, 0) {
                terms.push(Term {
                    effect,
                    params: vec![0.0, operator as f64, weight as f64],
                    table: None,
                    table_error: 0.0,
                });
            }
        }
    }
    if let Some(effect) = find("unknown_profile") {
        let [rows, cols] = model.seen.sensor.map(|n| n as f64 - 1.0);
        let lit = evidence.frames.iter().flat_map(|f| f.light_e.iter().copied()).fold(0.0f32, f32::max);
        let times = evidence.frames.iter().map(|f| f.cx.time_s);
        let (first, last) = times.fold((f64::MAX, f64::MIN), |r, t| (r.0.min(t), r.1.max(t)));
        let mut ranges = vec![
            (0, 0.0, rows),
            (1, 0.0, cols),
            (2, 0.0, rows.hypot(cols) / 2.0),
            (3, 0.0, rows + cols),
            (4, 0.0, f64::from(lit)),
        ];
        if last > first {
            ranges.push((5, first, last));
        }
        if let Some(period) = row_period(evidence) {
            ranges.push((6, 0.0, period));
        }
        // The light of flats differs from pixel to pixel by tables alone, and those were estimated on the flats.
        if state.terms.iter().any(|t| t.table_error > 0.0) {
            ranges.retain(|(covariate, ..)| *covariate != 4);
        }
        for ((covariate, low, high), additive) in ranges.into_iter().flat_map(|r| [(r, 0.0), (r, 1.0)]) {
            // Light added in proportion to the light is a factor again.
            if high > low && !(covariate == 4 && additive == 1.0) {
                let mut params = vec![0.0; KNOTS];
                params.extend([f64::from(covariate), additive, low, high]);
                terms.push(Term { effect, params, table: None, table_error: 0.0 });
            }
        }
    }
    for id in ["unknown_warp", "unknown_blur", "unknown_scatter"] {
        terms.extend(find(id).map(|effect| {
            let params = effect.descriptor().expanded(model.lenses()).iter().map(|(_, p)| p.off).collect();
            Term { effect, params, table: None, table_error: 0.0 }
        }));
    }
    terms.extend(gradient(model, state));
    let lenses = model.lenses();
    let chosen = |t: &Term| -> Vec<f64> {
        let all = t.expanded(lenses).into_iter().zip(&t.params);
        all.filter(|((_, p), _)| p.kind == Kind::Choice).map(|(_, v)| *v).collect()
    };
    terms.retain(|t| !state.terms.iter().any(|s| s.id() == t.id() && chosen(s) == chosen(t)));
    terms
}

/// The strongest period over rows in the residuals of all frames, pixels.
fn row_period(evidence: &Evidence<'_>) -> Option<f64> {
    let rows = evidence.frames.first()?.residual_dn.nrows();
    let (mut top, mut bottom) = (vec![0.0; rows], vec![0.0; rows]);
    for f in evidence.frames.iter().filter(|f| f.cx.role != Role::Dark) {
        for (r, ((residual, light), weight)) in
            f.residual_dn.outer_iter().zip(f.light_e.outer_iter()).zip(f.weight.outer_iter()).enumerate()
        {
            for ((y, e), w) in residual.iter().zip(&light).zip(&weight) {
                top[r] += f64::from(y * e * w);
                bottom[r] += f64::from(e * e * w);
            }
        }
    }
    periods(&top, &bottom).first().copied()
}
