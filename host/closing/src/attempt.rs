//! One attempt to close the loop, with the records as they stand: first fit, search, pruning, account.

use super::account::{
    Accepted, Closed, Closing, Effect, Excess, Findings, Judged, Left, Names, Verdict, calibration_note, effects,
    harmful, imitated, pictured, pupil_note, registration_notes, registrations, rejected, rest_notes, shadowed,
    small_note, unstated_notes, within_calibration,
};
use super::data::{Fault, Observations, Shown, bright_darks};
use super::evidence::{
    Constancy, Curve, JudgedOn, compared, curves, excess, excess_by_calibration, figures, judged, noise_left, omnibus,
    standing_alone, structured,
};
use super::fit::gauge::Gauge;
use super::fit::{
    Design, Fitted, Model, PUPIL_DEFOCUS, Replicas, Scope, State, Term, UNKNOWN_NOTE, chosen_note, estimated_frames,
    fitted_columns, refit, replicas,
};
use super::options::{CalibratedOn, CloseError, CloseOptions};
use super::plan::{self, plan};
use super::search::{
    Earned, Found, Kept, NEEDS_CALIBRATION, Pruned, Search, Tried, earned, lost, prune, replaced, score,
};
use ommatidia_model::forward::ForwardError;
use ommatidia_model::instrument::Instrument;
use ommatidia_physics::effects::find;
use ommatidia_session::Role;

/// Effects of the noise are causes if they leave at most this share of the structure in the noise of repeated frames.
const NOISE_LEFT: f64 = 0.1;

/// What an attempt takes for given.
#[derive(Clone, Copy)]
pub(crate) struct Given<'a> {
    /// Ids of effects that are not tried.
    pub(crate) exclude: &'a [String],
    /// Faults of the records, which were corrected.
    pub(crate) faults: &'a [Fault],
}

/// The result of an attempt.
pub(crate) struct Attempt {
    pub(crate) closed: Closed,
    /// The state of the closed instrument.
    pub(crate) state: State,
}

impl Attempt {
    /// Whether effects of the catalogue explain the session, and nothing is left to explain.
    pub(crate) fn explains_all(&self) -> bool {
        let closing = &self.closed.account.closing;
        closing.verdict == Verdict::Adequate && closing.effects.iter().all(|e| e.known)
    }
}

/// Searches for the effects that an instrument lacks and adds them. Calls `progress` with the name of each step that
/// begins.
///
/// # Errors
/// The parts of the instrument disagree, or an object holds negative light.
pub(crate) fn attempt(
    instrument: &Instrument,
    seen: &Observations,
    options: &CloseOptions<'_>,
    given: Given<'_>,
    progress: &mut impl FnMut(&str),
) -> Result<Attempt, CloseError> {
    let seed = options.seed;
    // Fitted once and for all by all cores: frames that are predicted side by side would each fit them.
    instrument.fit_pupils();
    let model = Model::new(instrument, seen)?;
    let start = model.state(instrument)?;
    let own = start.terms.len();
    progress("first fit");
    let before = refit(&model, start)?;
    let replicas = replicas(&model, instrument, &before.state)?;
    let errors = replicas.of(&model, &before)?;
    let judged_on = JudgedOn::of(seen);
    let by_calibration = [judged_on, JudgedOn::Even].map(|on| excess_by_calibration(&model, &before, &errors, on));
    let dependences_before = omnibus::test(&model, &before, &errors, seed);
    progress("catalogue");
    let mut search = Search::new(&model, &replicas, before.clone());
    search.exclude = given.exclude.to_vec();
    let lost = lost(&model, &before)?;
    search.exclude.extend(lost.iter().map(|id| id.to_string()));
    search.trial_deviance = options.trial_calibration.map(|trial| held_out_deviance(trial, seen)).transpose()?;
    search.run(Tried::Catalogue, progress)?;
    let mut dependences = match search.found.is_empty() {
        true => dependences_before.clone(),
        false => omnibus::test(&model, &search.now, &replicas.of(&model, &search.now)?, seed),
    };
    let mut rest = std::mem::take(&mut search.rest);
    if structured(&dependences) && !search.needs_calibration() {
        progress("terms without a name");
        search.run(Tried::Maps, progress)?;
        search.run(Tried::Curves, progress)?;
        dependences = omnibus::test(&model, &search.now, &replicas.of(&model, &search.now)?, seed);
    }
    let of_before = [judged_on, JudgedOn::Even].map(|on| excess(&model, &before, on));
    let within = |fit: &Fitted| {
        within_calibration(figures(&model, fit), &instrument.quality, standing_alone(&model, fit, &instrument.psf))
    };
    let excess_of = |fit: &Fitted| {
        Excess::of(of_before[0], excess(&model, fit, judged_on), by_calibration[0]).beyond_calibration(within(fit))
    };
    // Asked where a test sees structure. Of unknown specimens it may be that of their estimates.
    let beyond = if judged_on == JudgedOn::SelfConsistency { Excess::of } else { Excess::seen };
    let left_of = |fit: &Fitted| {
        let judged = beyond(of_before[0], excess(&model, fit, judged_on), by_calibration[0]);
        let even = Excess::seen(of_before[1], excess(&model, fit, JudgedOn::Even), by_calibration[1]);
        let judged = judged.beyond_calibration(within(fit));
        Left { judged: judged.left, even: even.left, much: judged.is_much() }
    };
    let recalibrated = search.needs_calibration();
    let mut imitations = Vec::new();
    let named = |f: &Found| !f.id.starts_with("unknown");
    if !recalibrated && structured(&dependences) && search.found.iter().any(named) {
        let left = left_of(&search.now);
        let earns_alone = |f: &Found| left.earns(f, Constancy::default());
        let constancy = match search.found.iter().filter(|f| named(f)).all(earns_alone) {
            true => vec![Constancy::default(); search.found.len()],
            false => constancies(&model, &replicas, &search.now, own)?,
        };
        let terms = search.now.state.terms[own..].iter();
        let all: Vec<_> = search.found.iter().zip(terms).zip(constancy).collect();
        if all.iter().any(|((f, _), constancy)| named(f) && !left.earns(f, *constancy)) {
            let earned = all.into_iter().filter(|((f, _), constancy)| named(f) && left.earns(f, *constancy));
            let (found, terms): (Vec<_>, Vec<_>) = earned.map(|((f, t), _)| (f.clone(), t.clone())).unzip();
            let mut start = before.clone();
            if !terms.is_empty() {
                start.state.terms.extend(terms);
                start = refit(&model, start.state)?;
            }
            let mut again = Search::new(&model, &replicas, start);
            (again.exclude, again.found) = (given.exclude.to_vec(), found);
            imitations = replaced(&mut search, again, (own, &before), progress)?;
        }
    }
    // What stands for a new calibration is judged by what that gains, and not by its own form.
    let keep: &[&str] = if recalibrated { &[NEEDS_CALIBRATION] } else { &[] };
    progress("which names are earned");
    let Earned { now, found, imitations: more } =
        earned(&model, search.now, search.found, (own, &before), |fit| constancies(&model, &replicas, fit, own))?;
    imitations.extend(more);
    progress("pruning");
    let pruned = prune(&model, &replicas, now, found, (own, keep))?;
    let kept =
        if recalibrated { Kept::all(pruned) } else { Kept::of(&model, &replicas, &before, pruned, (own, seed))? };
    let Kept { named: Pruned { mut now, mut found, tests, constancy, removed }, closed, unseen, taken_back } = kept;
    if found.is_empty() && !recalibrated {
        // Another fit of the nuisance parameters alone is no closed loop.
        now = before.clone();
    }
    let closed = closed.unwrap_or_else(|| now.clone());
    found.iter_mut().for_each(|f| f.or_untested(&rest));
    let (harmed, harmful_terms): (Vec<_>, Vec<_>) = taken_back.into_iter().unzip();
    let mut nearest = shadowed(&search.shadowed, found.first().map(|f| f.id));
    nearest.extend(imitated(&imitations));
    nearest.extend(harmful(&harmed));
    let mut notes = Vec::new();
    if !harmed.is_empty() {
        let ids: Vec<&str> = harmed.iter().map(|f| f.id).collect();
        notes.push(format!(
            "taken back, because held-out data were predicted worse with it than before: {}",
            ids.join(", ")
        ));
    }
    let out = removed.iter().chain(imitations.iter().map(|it| &it.term)).chain(&harmful_terms);
    let out: Vec<&Term> = out.collect();
    if !out.is_empty() {
        dependences = omnibus::test(&model, &now, &replicas.of(&model, &now)?, seed);
        // Their limits are those of effects that are absent.
        rest.retain(|c| !out.iter().any(|t| t.id() == c.term.id()));
        let named = out.iter().filter(|t| !t.id().starts_with("unknown"));
        let absent: Vec<Term> = named.map(|t| t.switched_off(model.lenses())).collect();
        rest.extend(score(&model, &now, &replicas.of(&model, &now)?, &absent)?);
    }
    if !removed.is_empty() {
        let ids: Vec<&str> = removed.iter().map(Term::id).collect();
        notes.push(format!(
            "added and later removed, because the effects that were added after them made them unnecessary: {}",
            ids.join(", ")
        ));
    }
    let [first, last] = compared(&model, &before, &closed);
    let left = structured(&dependences);
    let within = within(&now);
    let excess = excess_of(&now);
    let unlike = if left { left_of(&now) } else { Left::default() };
    let findings = Findings { before: &before, now: &now, own, found: &found, tests: &tests, left: unlike };
    let mut effects = effects(&model, findings, given.faults);
    effects.iter_mut().filter(|e| unseen.contains(&e.id.as_str())).for_each(Effect::is_not_added);
    let of_found: Vec<_> = found.iter().zip(constancy.into_iter().skip(own)).collect();
    let names = Names::of(
        effects,
        Judged {
            found: &of_found,
            left: unlike,
            noise_is_left: noise_left(&dependences_before, &dependences) > NOISE_LEFT,
            psf_error: instrument.quality.off_grid_excess(),
            recalibrated,
        },
    );
    notes.extend(names.note());
    let unnamed = found.iter().any(|f| f.id.starts_with("unknown"));
    let verdict = excess.verdict(left && !within || unnamed || names.uneven);
    let catalogue_incomplete = verdict != Verdict::Adequate;
    let Names { effects, nearest: resembling, left_much, .. } = names;
    nearest.extend(resembling);
    notes.splice(..0, bright_darks(seen, model.forward.noise()));
    let misjudged = now.state.terms.iter().find(|t| t.id() == PUPIL_DEFOCUS).map_or(&[][..], |t| &t.params);
    notes.extend(pupil_note(instrument, &effects, misjudged, model.forward.depth_error()));
    // Without a bead scan there are no replicates to be had.
    if instrument.replicates.is_empty() && !instrument.sensor_only() && seen.of(Role::Scene).next().is_some() {
        notes.push(
            "the instrument has no calibration replicates, so the uncertainty of the calibration is unknown and small \
             effects may be errors of the calibration; calibrate again"
                .into(),
        );
    }
    let of_rest: Vec<String> = rest_notes(&model, &now, verdict)
        .into_iter()
        .chain(calibration_note((left, within), verdict, &effects, &instrument.quality))
        .collect();
    if of_rest.is_empty() {
        notes.extend(small_note(&dependences, verdict, &effects, last));
    }
    notes.extend(of_rest);
    if JudgedOn::of(seen) == JudgedOn::SelfConsistency {
        notes.push(UNKNOWN_NOTE.into());
    }
    notes.extend(chosen_note(seen));
    notes.extend(now.gauges.iter().filter(|g| g.term >= own).map(|g| gauge_note(g, &now.state)));
    let curves = curves(&model, &now, own)?;
    notes.extend(drift_notes(&curves));
    let own_beads = own_beads(seen, options.calibrated_on);
    if own_beads {
        notes.push(OWN_BEADS_NOTE.into());
    }
    let accepted = Accepted { state: &now.state, found: &found, lost: &lost };
    let registrations = registrations(&model, &now, left_much.then_some(&before), &replicas)?;
    notes.extend(registration_notes(&registrations));
    notes.extend(unstated_notes(&model, &now, own)?);
    let mut closing = Closing {
        session: options.session_name.into(),
        calibrated_on: options.calibrated_on.iter().map(|c| c.file.clone()).collect(),
        own_beads,
        judged_on: JudgedOn::of(seen),
        verdict,
        nearest,
        before: first,
        after: last,
        held_out_frames: held_out_frames(seen),
        held_out_blocks: held_out_blocks(seen),
        estimated_frames: estimated_frames(seen),
        recorded_frames: seen.recorded,
        curves,
        effects,
        rejected: rejected(&model, &rest, &accepted, own_beads),
        catalogue_incomplete,
        faults: given.faults.to_vec(),
        dependences_before,
        dependences_after: dependences,
        retrained: None,
        registrations,
        plan: None,
        notes,
    };
    if options.plan {
        progress("which measurement next");
        closing.plan = Some(plan(&model, &planned(instrument, (&now, &replicas), &closing))?);
    }
    let mut account = pictured(&model, &before, &closed, closing);
    account.closing.notes.extend(background_notes(&model, &now.state));
    let closed = Closed { instrument: with_effects(instrument, &model, &closed.state), account };
    Ok(Attempt { closed, state: now.state })
}

/// Whether each of the added effects of a fit has one strength everywhere. The first `own` terms belong to the
/// instrument.
fn constancies(
    model: &Model<'_>,
    replicas: &Replicas,
    fit: &Fitted,
    own: usize,
) -> Result<Vec<Constancy>, ForwardError> {
    let columns = fitted_columns(model, &fit.state);
    let errors = replicas.of(model, fit)?;
    let design = Design::compute(model, fit.expansion(&[]), columns, &errors, Scope::Training)?;
    Ok((own..fit.state.terms.len()).map(|t| Constancy::of(model, fit, &design, t)).collect())
}

/// What a plan starts from: what the account leaves open.
fn planned<'a>(
    instrument: &'a Instrument,
    (now, replicas): (&'a Fitted, &'a Replicas),
    closing: &Closing,
) -> plan::Found<'a> {
    let ambiguous = closing.effects.iter().filter(|e| e.known && !e.ambiguity.is_empty());
    // Nobody measures a bead scan to learn of a fault that only bead scans have.
    let matters = |id: &str| find(id).is_none_or(|e| !e.is_of_bead_scans());
    let untestable = closing.rejected.iter().filter(|r| r.upper_limit.is_none() && matters(&r.id));
    plan::Found {
        instrument,
        now,
        replicas,
        ambiguous: ambiguous.map(|e| (e.id.clone(), e.ambiguity.clone())).collect(),
        untestable: untestable.map(|r| r.id.clone()).collect(),
    }
}

/// What the figures mean where the only known frames are those of the calibration.
pub(crate) const OWN_BEADS_NOTE: &str = "the figures are of bead frames that this instrument was calibrated on: they \
                                         show how well the model describes that scan, and nothing of what has changed \
                                         since; measure scenes of known objects or a new bead scan to test the optics";

/// Whether all frames of the figures are bead frames that the calibration has read.
pub(crate) fn own_beads(seen: &Observations, calibrated_on: &[CalibratedOn]) -> bool {
    let own = |k: usize| {
        let frame = &seen.frames[k];
        matches!(frame.shown, Shown::Bead(_)) && calibrated_on.iter().any(|c| c.stack == frame.stack)
    };
    let mut known = judged(seen).filter(|k| seen.frames[*k].shown != Shown::Unknown).peekable();
    known.peek().is_some() && known.all(own)
}

/// Deviance of the held-out cells of known objects and beads under another instrument.
fn held_out_deviance(instrument: &Instrument, seen: &Observations) -> Result<f64, CloseError> {
    let model = Model::new(instrument, seen)?;
    Ok(refit(&model, model.state(instrument)?)?.known_held_out.deviance)
}

/// Evidence from which a drift is reported, standard deviations: three effects and more are followed.
const DRIFTS: f64 = 3.5;

/// Effects that change within the recording, by the strength of each that changes most.
fn drift_notes(curves: &[Curve]) -> Vec<String> {
    let drifting: Vec<&Curve> = curves.iter().filter(|c| c.z > DRIFTS).collect();
    let note = |of: &[&Curve]| {
        let change = |c: &Curve| c.value.last().zip(c.value.first()).map_or(0.0, |(b, a)| b - a);
        let in_sigmas = |c: &Curve| change(c).abs() / c.sigma.iter().fold(f64::MIN_POSITIVE, |m, s| m.max(*s));
        let c = of.iter().max_by(|a, b| in_sigmas(a).total_cmp(&in_sigmas(b)))?;
        let ends = [c.value.first()?, c.value.last()?, c.sigma.last()?, c.time_s.first()?, c.time_s.last()?];
        let unit = if c.unit == "1" { String::new() } else { format!(" {}", c.unit) };
        Some(format!(
            "the frames differ along `{}` with time (z = {:.1}): {} is {:.3}{unit} in the first of them ({:.1} s) and \
             {:.3} +- {:.3}{unit} in the last ({:.1} s); `curves` of the account has all values",
            c.id, c.z, c.param, ends[0], ends[3], ends[1], ends[2], ends[4]
        ))
    };
    drifting.chunk_by(|a, b| a.id == b.id).filter_map(note).collect()
}

/// What a change of the specimens makes of an effect's values.
fn gauge_note(gauge: &Gauge, state: &State) -> String {
    let [values, directions] = [gauge.directions.nrows(), gauge.directions.ncols()];
    let id = state.terms.get(gauge.term).map_or("", Term::id);
    format!(
        "`{id}`: {directions} of the {values} directions of its values are changes of the specimens as well, so that \
         these frames cannot show how far the values lie along them (a displacement common to all lenses, for \
         example). The values are those with the fewest lenses changed, and their errors hold relative to the other \
         lenses"
    )
}

/// The background of each stack that has one of its own: it belongs to the session, and no effect names it.
fn background_notes(model: &Model<'_>, state: &State) -> Vec<String> {
    let role = |stack: usize| model.seen.frames.iter().find(|f| f.stack == stack).map(|f| f.role);
    let note = |(stack, [level, row, col]): (usize, &[f64; 3])| {
        let role = role(stack).filter(|_| [*level, *row, *col] != [0.0; 3])?;
        Some(format!(
            "background of the {} frames, as this session shows it: {level:.2} e- a pixel ({row:+.2} e- from the first \
             to the last row, {col:+.2} e- from the first to the last column); it was fitted beside the effects, \
             because the calibration found a background in the bead frames",
            role.name()
        ))
    };
    state.background_e.iter().enumerate().filter_map(note).collect()
}

pub(crate) fn held_out_frames(seen: &Observations) -> Vec<usize> {
    judged(seen).filter(|k| seen.frames[*k].held_out).map(|k| seen.frames[k].info.frame).collect()
}

pub(crate) fn held_out_blocks(seen: &Observations) -> [usize; 2] {
    [seen.held_out_blocks.iter().filter(|h| **h).count(), seen.held_out_blocks.len()]
}

/// The instrument with the effects of a state in place of its own.
fn with_effects(instrument: &Instrument, model: &Model<'_>, state: &State) -> Instrument {
    let is_on = |t: &&Term| t.id() != PUPIL_DEFOCUS || t.params.iter().any(|v| *v != 0.0);
    let effects = state.terms.iter().filter(is_on).map(|t| t.setting(model.lenses())).collect();
    Instrument { effects, ..instrument.clone() }
}
