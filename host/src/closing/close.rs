//! The whole of it: faults of the record, the catalogue, tables, terms without a name, pruning, figures on held-out data.

use super::design::{Design, nuisances};
use super::file::Account;
use super::model::{Column, Model, State, Term};
use super::observe::{Observations, Shown};
use super::omnibus::{self, Dependence};
use super::record::{self, FaultKind};
use super::refit::{Fitted, own_columns, refit};
use super::result::{Closing, Effect, Figures, Rejected, Value};
use super::score::{Scores, Test};
use super::search::{Candidate, Found, Replicas, Search, catalogue, replicas, unknowns};
use super::stats::f_tail;
use crate::effects::{COVARIATES, EffectError, Kind, OPERATORS, Stage, WEIGHTS, find, registry};
use crate::forward::ForwardError;
use crate::instrument::Instrument;
use crate::session::{Manifest, Role};
use ndarray::{Array1, Array2, Array3};
use thiserror::Error;

/// Probability below which an omnibus test counts, all covariates together.
const OMNIBUS: f64 = 0.01;

/// A term stays if chi-squared rises by more than this without it, over the scatter between clusters.
const NEEDED: f64 = 16.0;

/// Why the loop could not be closed.
#[derive(Debug, Error)]
pub enum CloseError {
    /// The model.
    #[error(transparent)]
    Forward(#[from] ForwardError),
    /// The effects of the instrument.
    #[error(transparent)]
    Effect(#[from] EffectError),
    /// Instrument and session are not of one kind.
    #[error(
        "the instrument was calibrated for {expected}, the session has {found}; calibrate on a session of this instrument"
    )]
    Layout {
        /// Layout of the instrument.
        expected: String,
        /// Layout of the session.
        found: String,
    },
    /// Nothing to look at.
    #[error("the session holds no frame that a model can be held against: expected scenes, beads, flats or darks")]
    Empty,
}

/// An instrument that was closed, with the account of it.
pub struct Closed {
    /// The instrument with what was found.
    pub instrument: Instrument,
    /// The account.
    pub account: Account,
}

/// Checks that a session is of an instrument's kind.
///
/// # Errors
/// Sensor, array or object grid differ.
pub fn same_layout(instrument: &Manifest, session: &Manifest) -> Result<(), CloseError> {
    let words = |m: &Manifest| {
        format!(
            "{} x {} lenses, a sensor of {} x {} and objects of {} x {} pixels",
            m.array.rows, m.array.cols, m.sensor.rows, m.sensor.cols, m.object.rows, m.object.cols
        )
    };
    let (expected, found) = (words(instrument), words(session));
    if expected == found { Ok(()) } else { Err(CloseError::Layout { expected, found }) }
}

/// Screens the records of the scenes and puts the observations right.
///
/// # Errors
/// An object is no light.
pub fn screen(instrument: &Instrument, seen: &mut Observations) -> Result<Vec<record::Fault>, CloseError> {
    let look = |seen: &Observations| {
        let model = Model::new(instrument, seen)?;
        let state = model.state(instrument).unwrap_or(State { terms: Vec::new(), scale: Vec::new(), black_dn: 0.0 });
        let frames = record::look(&model, &state)?;
        Ok((state, frames))
    };
    if seen.frames.iter().filter(|f| matches!(f.shown, Shown::Object(_))).count() < 2 {
        return Ok(Vec::new());
    }
    Ok(record::screen(seen, look)?)
}

/// Closes the loop. `tell` is called with what is being done.
///
/// # Errors
/// The instrument's parts disagree, or the session has nothing to look at.
pub fn close(
    instrument: &Instrument,
    seen: &mut Observations,
    session: &str,
    seed: u64,
    tell: impl FnMut(&str),
) -> Result<Closed, CloseError> {
    close_without(instrument, seen, session, seed, &[], tell)
}

/// [`close`] with a smaller catalogue: the effects `exclude`d are not tried. What the loop says where the true effect is not
/// among its candidates tells how far it can be trusted.
///
/// # Errors
/// As [`close`].
pub fn close_without(
    instrument: &Instrument,
    seen: &mut Observations,
    session: &str,
    seed: u64,
    exclude: &[String],
    mut tell: impl FnMut(&str),
) -> Result<Closed, CloseError> {
    if seen.frames.is_empty() {
        return Err(CloseError::Empty);
    }
    tell("records");
    let faults = screen(instrument, seen)?;
    let seen = &*seen;
    let model = Model::new(instrument, seen)?;
    let start = model.state(instrument)?;
    let own = start.terms.len();
    tell("first fit");
    let first = refit(&model, start)?;
    let replicas = replicas(&model, instrument, &first.state)?;
    let before = first.clone();
    let dependences_before = omnibus::test(&model, &first.predicted, &replicas.of(&model, &first)?, seed);
    tell("catalogue");
    let mut search = Search::new(&model, &replicas, first);
    search.exclude = exclude.to_vec();
    search.run(catalogue, true, &mut tell)?;
    let mut dependences = omnibus::test(&model, &search.now.predicted, &replicas.of(&model, &search.now)?, seed);
    let rest = std::mem::take(&mut search.rest);
    if structured(&dependences) {
        tell("terms without a name");
        search.run(unknowns, false, &mut tell)?;
        dependences = omnibus::test(&model, &search.now.predicted, &replicas.of(&model, &search.now)?, seed);
    }
    tell("pruning");
    let (now, found, tests) = prune(&model, &replicas, search.now, search.found, own)?;
    let unknown = found.iter().any(|f| f.id.starts_with("unknown"));
    let catalogue_incomplete = unknown || structured(&dependences);
    let effects = account(&model, &before, &now, &found, &tests, own, &faults);
    let mut notes = Vec::new();
    if instrument.replicates.is_empty() && seen.of(Role::Scene).next().is_some() {
        notes.push(
            "the instrument has no replicates of its calibration: its own uncertainty is not known, and small effects may be errors \
             of the calibration; calibrate again"
                .into(),
        );
    }
    let closing = Closing {
        session: session.into(),
        before: figures(&model, &before),
        after: figures(&model, &now),
        held_out_frames: held_out_frames(seen),
        held_out_blocks: held_out_blocks(seen),
        effects,
        rejected: rejected(&model, &rest, &now.state, &found),
        catalogue_incomplete,
        faults,
        dependences_before,
        dependences_after: dependences,
        retrained: None,
        notes,
    };
    let account = pictured(&model, &before, &now, closing);
    Ok(Closed { instrument: closed(instrument, &model, &now.state), account })
}

/// Looks at the residual of a session and adds nothing.
///
/// # Errors
/// As [`close`].
pub fn residual(
    instrument: &Instrument,
    seen: &mut Observations,
    session: &str,
    seed: u64,
) -> Result<Account, CloseError> {
    if seen.frames.is_empty() {
        return Err(CloseError::Empty);
    }
    let faults = screen(instrument, seen)?;
    let seen = &*seen;
    let model = Model::new(instrument, seen)?;
    let fit = refit(&model, model.state(instrument)?)?;
    let replicas = replicas(&model, instrument, &fit.state)?;
    let dependences = omnibus::test(&model, &fit.predicted, &replicas.of(&model, &fit)?, seed);
    let figures = figures(&model, &fit);
    let closing = Closing {
        session: session.into(),
        before: figures,
        after: figures,
        held_out_frames: held_out_frames(seen),
        held_out_blocks: held_out_blocks(seen),
        catalogue_incomplete: structured(&dependences),
        effects: faults.iter().map(fault).collect(),
        faults,
        dependences_before: dependences.clone(),
        dependences_after: dependences,
        ..Closing::default()
    };
    Ok(pictured(&model, &fit, &fit, closing))
}

fn held_out_frames(seen: &Observations) -> Vec<usize> {
    judged(seen).filter(|k| seen.frames[*k].held_out).map(|k| seen.frames[k].info.frame).collect()
}

fn held_out_blocks(seen: &Observations) -> [usize; 2] {
    [seen.held_out_blocks.iter().filter(|h| **h).count(), seen.held_out_blocks.len()]
}

/// Whether any omnibus test passes.
pub fn structured(dependences: &[Dependence]) -> bool {
    dependences.iter().any(|d| d.p * (dependences.len() as f64) < OMNIBUS)
}

/// The instrument with the effects of a state.
fn closed(instrument: &Instrument, model: &Model<'_>, state: &State) -> Instrument {
    let effects = state.terms.iter().map(|t| t.setting(model.lenses())).collect();
    Instrument { effects, ..instrument.clone() }
}

/// What is left after pruning: the fit, what was found, and the test of each term.
type Pruned = (Fitted, Vec<Found>, Vec<Option<Test>>);

/// Takes back what is no longer needed beside the rest; gives the test of each term that stays.
fn prune(
    model: &Model<'_>,
    replicas: &Replicas,
    mut now: Fitted,
    mut found: Vec<Found>,
    own: usize,
) -> Result<Pruned, ForwardError> {
    let mut needed: Vec<&str> = Vec::new();
    loop {
        let columns: Vec<Column> = nuisances(model).into_iter().chain(own_columns(model, &now.state)).collect();
        let of_frames = replicas.of(model, &now)?;
        let design = Design::compute(model, &now.state, &[], columns.clone(), &now.predicted, &now.scenes, &of_frames)?;
        let test = |t: usize| -> Option<Test> {
            let of_term = |c: &Column| matches!(c, Column::Own { term, .. } if *term == t);
            let mine: Vec<usize> = (0..columns.len()).filter(|i| of_term(&columns[*i])).collect();
            let others = (0..columns.len()).filter(|i| !of_term(&columns[*i])).collect();
            Scores::new(&design, others).test(&mine)
        };
        let tests: Vec<Option<Test>> = (0..now.state.terms.len()).map(test).collect();
        // Wald: how far the strengths are from where the effect is absent.
        let weakest = (own..tests.len())
            .filter(|t| !needed.contains(&now.state.terms[*t].id()))
            .filter_map(|t| Some((t, wald(model, &now.state.terms[t], tests[t].as_ref()?))))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        match weakest {
            Some((t, p)) if p > super::search::ALPHA => {
                let mut state = now.state.clone();
                let term = state.terms.remove(t);
                let without = refit(model, state)?;
                // Values that trade against one another are each uncertain while the term as a whole is not.
                let weight = tests[t].as_ref().map_or(1.0, |test| test.phi);
                if (without.chi2 - now.chi2) / weight > NEEDED {
                    needed.push(term.id());
                } else {
                    found.remove(t - own);
                    now = without;
                }
            }
            _ => return Ok((now, found, tests)),
        }
    }
}

/// Probability of strengths this far from absence.
fn wald(model: &Model<'_>, term: &Term, test: &Test) -> f64 {
    let strengths = term.strengths(model.lenses());
    let expanded = term.expanded(model.lenses());
    let d = Array1::from_iter(strengths.iter().map(|i| term.params[*i] - expanded[*i].1.off));
    let covariance = test.covariance.select(ndarray::Axis(0), &strengths).select(ndarray::Axis(1), &strengths);
    let t = d.dot(&super::score::pseudo_inverse(&covariance).dot(&d));
    f_tail(t / d.len() as f64, d.len() as f64, test.nu)
}

/// The frames that figures are told of.
fn judged(seen: &Observations) -> impl Iterator<Item = usize> + '_ {
    (0..seen.frames.len()).filter(|k| matches!(seen.frames[*k].role, Role::Scene | Role::Bead))
}

/// Figures on what no fit has seen: held-out scenes, or the held-out blocks where no scene is.
pub(super) fn figures(model: &Model<'_>, fitted: &Fitted) -> Figures {
    let seen = model.seen;
    let mut frames: Vec<usize> = judged(seen).filter(|k| seen.frames[*k].held_out).collect();
    let whole = !frames.is_empty();
    if !whole {
        frames = judged(seen).collect();
    }
    let black = model.forward.noise().black_level_dn;
    let (mut chi2, mut n, mut error, mut light) = (0.0, 0.0, 0.0, 0.0);
    let mut s = [0.0f64; 6];
    for k in frames {
        let (here, measured) = (&fitted.predicted[k], &seen.frames[k].measured);
        for (span, held_out) in seen.blocks.iter().zip(&seen.held_out_blocks) {
            if !whole && !held_out {
                continue;
            }
            for p in &seen.pixels[span.clone()] {
                let at = (*p as usize / seen.sensor[1], *p as usize % seen.sensor[1]);
                let (r, w) = (f64::from(here.residual_dn[at]), f64::from(here.inverse_sigma[at]));
                if w <= 0.0 {
                    continue;
                }
                chi2 += r * r * w * w;
                n += 1.0;
                let y = f64::from(measured[at]) - black;
                let mu = y - r;
                error += r * r;
                light += y * y;
                for (sum, v) in s.iter_mut().zip([1.0, y, mu, y * y, mu * mu, y * mu]) {
                    *sum += v;
                }
            }
        }
    }
    let m = s[0].max(1.0);
    let (vy, vm, c) = (s[3] - s[1] * s[1] / m, s[4] - s[2] * s[2] / m, s[5] - s[1] * s[2] / m);
    let pcc = if vy > 0.0 && vm > 0.0 { c / (vy * vm).sqrt() } else { 0.0 };
    Figures { chi2_ndf: chi2 / f64::max(n, 1.0), nrmse: (error / f64::max(light, 1e-30)).sqrt(), pcc }
}

/// The account of what was found.
fn account(
    model: &Model<'_>,
    before: &Fitted,
    now: &Fitted,
    found: &[Found],
    tests: &[Option<Test>],
    own: usize,
    faults: &[record::Fault],
) -> Vec<Effect> {
    let mut effects: Vec<Effect> = faults.iter().map(fault).collect();
    // What the noise alone leaves: one a pixel, less where the noise model is generous.
    let pixels = now.held_out.1 as f64;
    let excess = before.held_out.0 - pixels.min(now.held_out.0);
    let mut unknown = 0;
    for (i, f) in found.iter().enumerate() {
        let term = &now.state.terms[own + i];
        let d = term.effect.descriptor();
        let known = !f.id.starts_with("unknown");
        let id = if known {
            f.id.to_string()
        } else {
            unknown += 1;
            format!("unknown-{unknown}")
        };
        let test = tests.get(own + i).and_then(Option::as_ref);
        let params: Vec<Value> = term
            .expanded(model.lenses())
            .into_iter()
            .enumerate()
            .map(|(j, (name, p))| {
                let variance = |c: Option<f64>| c.map_or(0.0, |v| v.max(0.0).sqrt());
                let sigma = match &f.table_sigma {
                    Some(sigma) if j == 0 => *sigma,
                    _ => variance(test.and_then(|t| t.covariance.get((j, j)).copied())),
                };
                let sigma_noise = variance(test.and_then(|t| t.noise.get((j, j)).copied()));
                Value { name, value: term.params[j], sigma, sigma_noise, unit: p.unit.into() }
            })
            .collect();
        let separate_by = f.ambiguity.first().map(|(other, _)| separate(f.id, other));
        effects.push(Effect {
            description: describe(term, &params),
            id,
            known,
            stage: d.stage.part().into(),
            z: f.z,
            excess_explained: (excess > 3.0 * (2.0 * pixels).sqrt())
                .then(|| (f.held_out_gain / excess).clamp(0.0, 1.0)),
            held_out_gain: f.held_out_gain,
            ambiguity: f.ambiguity.iter().map(|(id, _)| (*id).to_string()).collect(),
            overlap: f.ambiguity.iter().map(|(_, rho)| *rho).fold(0.0, f64::max),
            separate_by,
            params,
        });
    }
    effects
}

/// A fault of the record as an effect.
fn fault(fault: &record::Fault) -> Effect {
    let (name, value, unit) = match fault.kind {
        FaultKind::Shows { truth_of } => ("truth_of", truth_of as f64, "index"),
        FaultKind::Flipped { rows, cols } => {
            ("flipped", f64::from(u8::from(rows) + 2 * u8::from(cols)), "1 rows, 2 cols")
        }
        FaultKind::Exposure { factor } => ("exposure_factor", factor, "1"),
    };
    let told = |name: &str, value: f64, unit: &str| Value {
        name: name.into(),
        value,
        sigma: 0.0,
        sigma_noise: 0.0,
        unit: unit.into(),
    };
    Effect {
        id: "metadata_fault".into(),
        known: true,
        stage: Stage::Record.part().into(),
        z: fault.z,
        excess_explained: None,
        held_out_gain: 0.0,
        ambiguity: Vec::new(),
        overlap: 0.0,
        separate_by: None,
        params: vec![told("frame", fault.frame as f64, "index"), told(name, value, unit)],
        description: fault.words(),
    }
}

/// What a user of the rejected list wants of each effect.
fn rejected(model: &Model<'_>, rest: &[Candidate], state: &State, found: &[Found]) -> Vec<Rejected> {
    let lenses = model.lenses();
    let mut out = Vec::new();
    for effect in registry() {
        let d = effect.descriptor();
        let added = found.iter().any(|f| f.id == d.id) || state.terms.iter().any(|t| t.id() == d.id);
        if added || d.id.starts_with("unknown") || d.stage == Stage::Record {
            continue;
        }
        let expanded = d.expanded(lenses);
        let Some((name, p)) = expanded.iter().find(|(_, p)| p.kind == Kind::Strength) else { continue };
        let candidate = rest.iter().find(|c| c.term.id() == d.id);
        let test = candidate.and_then(|c| c.test.as_ref());
        let first = candidate.and_then(Candidate::first);
        // 95 % of a normal variable lie below 1.645 standard deviations.
        let upper_limit = first.map(|(value, sigma)| value.abs() + 1.645 * sigma);
        let told = upper_limit.is_some_and(|u| u.is_finite() && u < (p.max - p.off).abs().max((p.off - p.min).abs()));
        out.push(Rejected {
            id: d.id.into(),
            param: name.clone(),
            upper_limit: upper_limit.filter(|_| told),
            sigma: first.map(|(_, sigma)| sigma).filter(|_| told),
            unit: p.unit.into(),
            z: test.map_or(0.0, |t| t.z),
            needs: (!told).then(|| needs(d.stage, d.id).into()),
        });
    }
    out
}

/// What a session must hold to tell an effect.
fn needs(stage: Stage, id: &str) -> &'static str {
    match (stage, id) {
        (_, "defocus" | "field_curvature") => "a bead scan at several depths",
        (_, "exposure_offset") => "flats at several exposures",
        (_, "dark_current" | "hot_pixels") => "darks at several exposures",
        (_, "prnu" | "dust") => "flats",
        (_, "lag") => "scenes one after the other, dark after bright",
        (_, "lamp_drift" | "photobleaching" | "black_level_drift") => "a table with time_s",
        (Stage::Object | Stage::Geometry | Stage::Lens, _) => "scenes of known objects",
        (Stage::Charge | Stage::Electronics, _) => "repeats of darks and flats at several levels",
        _ => "scenes of known objects, and flats",
    }
}

/// The measurement that tells two effects apart.
fn separate(id: &str, other: &str) -> String {
    let says = |a: &str, b: &str| {
        let d = find(a)?.descriptor();
        d.lookalikes.iter().find(|l| l.id == b).map(|l| l.separate_by.to_string())
    };
    says(id, other).or_else(|| says(other, id)).unwrap_or_else(|| {
        let stage = |id: &str| find(id).map(|e| e.descriptor().stage);
        let hint = match (stage(id), stage(other)) {
            (Some(Stage::Charge | Stage::Electronics), _) | (_, Some(Stage::Charge | Stage::Electronics)) => {
                "repeats of even light: what comes after the Poisson draw correlates the noise"
            }
            (Some(Stage::Object), _) | (_, Some(Stage::Object)) => {
                "the same specimen moved: what belongs to it moves with it"
            }
            _ => "more scenes, brighter and of other kinds",
        };
        hint.into()
    })
}

/// An effect in words and numbers.
fn describe(term: &Term, params: &[Value]) -> String {
    let d = term.effect.descriptor();
    let index = |i: usize| term.params.get(i).map_or(0, |v| *v as usize);
    match d.id {
        "unknown_operator" => format!(
            "unknown: {} +- {} of {}, {}; acts on light before the Poisson draw; 1 degree of freedom; cause not identified; valid for \
             light as bright as was measured",
            short(params[0].value),
            short(params[0].sigma),
            OPERATORS.get(index(1)).unwrap_or(&"?"),
            WEIGHTS.get(index(2)).unwrap_or(&"?")
        ),
        "unknown_profile" => {
            let knots = &params[..crate::effects::KNOTS];
            let (low, high) = knots.iter().fold((f64::MAX, f64::MIN), |r, v| (r.0.min(v.value), r.1.max(v.value)));
            let sigma = knots.iter().map(|v| v.sigma).sum::<f64>() / knots.len() as f64;
            let at = crate::effects::KNOTS;
            let kind = if index(at + 1) == 0 { "a factor on the light" } else { "light added, e-/ms" };
            let periodic = if index(at) == 6 {
                format!(", period {:.2} px", term.params[at + 3] - term.params[at + 2])
            } else {
                String::new()
            };
            format!(
                "unknown: {kind} over {}{periodic}, from {} to {} (each +- {}); {} degrees of freedom; cause not identified; valid from {} to {} \
                 of it and nowhere else",
                COVARIATES.get(index(at)).unwrap_or(&"?"),
                short(low),
                short(high),
                short(sigma),
                at,
                short(term.params[at + 2]),
                short(term.params[at + 3])
            )
        }
        _ => {
            let told: Vec<String> = params
                .iter()
                .filter(|v| v.sigma > 0.0 && (v.value / v.sigma).abs() > 2.0 || params.len() == 1)
                .take(6)
                .map(|v| format!("{} = {} +- {} {}", v.name, short(v.value), short(v.sigma), v.unit))
                .collect();
            format!("{}: {}", d.summary, told.join(", "))
        }
    }
}

/// Three figures.
fn short(v: f64) -> String {
    let size = v.abs();
    if size == 0.0 {
        "0".into()
    } else if (1e-3..1e5).contains(&size) {
        let digits = (2 - size.log10().floor() as i32).max(0) as usize;
        format!("{v:.digits$}")
    } else {
        format!("{v:.2e}")
    }
}

/// The account with the residuals of up to four scenes, held-out ones first.
fn pictured(model: &Model<'_>, before: &Fitted, now: &Fitted, closing: Closing) -> Account {
    let seen = model.seen;
    let mut frames: Vec<usize> = judged(seen).collect();
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
        frames: frames.iter().map(|k| seen.frames[*k].info.frame).collect(),
        closing,
    }
}
