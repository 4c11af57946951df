//! Says what a search found.

use super::basis::{Basis, Given};
use super::changed::changed;
use super::notes::{Said, background_notes, held_out_blocks, held_out_frames, notes, own_beads};
use super::settle::Settled;
use crate::account::{
    Accepted, Closed, Closing, Effect, Findings, Judged, Left, Names, Nearest, ROW_NOISE, Verdict, effects, harmful,
    imitated, pictured, registrations, rejected, shadowed,
};
use crate::evidence::{compared, curves, noise_left, structured, structured_mean};
use crate::fit::{Model, PUPIL_DEFOCUS, State, Term, estimated_frames, rhythm};
use crate::options::{CloseError, CloseOptions};
use crate::plan::{self, plan};
use crate::search::Found;
use ommatidia_model::instrument::Instrument;
use ommatidia_physics::effects::{Stage, find};

/// Effects of the noise are causes if they leave at most this share of the structure in the noise of repeated frames.
const NOISE_LEFT: f64 = 0.1;

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

/// The account of an attempt, and the closed instrument.
pub(super) fn report(
    basis: &Basis<'_>,
    settled: Settled,
    options: &CloseOptions<'_>,
    given: Given<'_>,
    progress: &mut dyn FnMut(&str),
) -> Result<Attempt, CloseError> {
    let Basis { instrument, model, own, judged_on, .. } = *basis;
    let Settled { now, closed, found, .. } = &settled;
    let seen = model.seen;
    let [before, after] = compared(model, &basis.unchanged, closed);
    let mut names = names(basis, &settled, given);
    names.effects.extend(changed(basis, &settled)?);
    let verdict = verdict(basis, &settled, &names);
    if verdict == Verdict::NotThisModel {
        names.disown(settled.recalibrated);
    }
    let curves = curves(model, now, own)?;
    let own_beads = own_beads(seen, options.calibrated_on);
    let without = names.left_much.then_some(&basis.unchanged);
    let registrations = registrations(model, now, without, &basis.replicas)?;
    let said = Said { names: &names, verdict, after, curves: &curves, registrations: &registrations, own_beads };
    let notes = notes(basis, &settled, &said)?;
    let mut nearest = out_of(&settled);
    nearest.extend(names.nearest);
    let accepted = Accepted { state: &now.state, found, lost: &settled.lost };
    let mut closing = Closing {
        session: options.session_name.into(),
        calibrated_on: options.calibrated_on.iter().map(|c| c.file.clone()).collect(),
        own_beads,
        judged_on,
        verdict,
        nearest,
        before,
        after,
        held_out_frames: held_out_frames(seen),
        held_out_blocks: held_out_blocks(seen),
        estimated_frames: estimated_frames(seen),
        recorded_frames: seen.recorded,
        curves,
        effects: names.effects,
        rejected: rejected(model, &settled.rest, &accepted, own_beads),
        catalogue_incomplete: verdict != Verdict::Adequate,
        faults: given.faults.to_vec(),
        dependences_before: basis.dependences_unchanged()?,
        dependences_after: settled.dependences.clone(),
        retrained: None,
        registrations,
        plan: None,
        notes,
    };
    if options.plan {
        progress("which measurement next");
        closing.plan = Some(plan(model, &planned(basis, &settled, &closing))?);
    }
    let mut account = pictured(model, &basis.unchanged, closed, closing);
    account.closing.notes.extend(background_notes(model, &now.state));
    let closed = Closed { instrument: with_effects(instrument, model, &closed.state), account };
    Ok(Attempt { closed, state: settled.now.state })
}

/// What is left of the excess, where tests see structure in the mean of the frames: that of the noise errs no optics.
fn left(basis: &Basis<'_>, settled: &Settled) -> Left {
    if structured_mean(&settled.dependences) { basis.left(&settled.now) } else { Left::default() }
}

/// Relative error of the PSFs in the frames of the optics.
fn psf_error(basis: &Basis<'_>) -> f64 {
    let quality = &basis.instrument.quality;
    if basis.model.shows_beads() { quality.bead_error() } else { quality.off_grid_excess() }
}

/// Which of the effects that were found are named as causes.
fn names(basis: &Basis<'_>, settled: &Settled, given: Given<'_>) -> Names {
    let Settled { now, found, tests, .. } = settled;
    let (own, left) = (basis.own, left(basis, settled));
    let findings = Findings { before: &basis.unchanged, now, own, found, tests, left };
    let mut effects = effects(basis.model, findings, given.faults);
    effects.iter_mut().filter(|e| settled.unseen.contains(&e.id.as_str())).for_each(Effect::is_not_added);
    let of_truths = |e: &&mut Effect| find(&e.id).is_some_and(|effect| effect.is_of_truths());
    effects.iter_mut().filter(of_truths).for_each(Effect::is_of_truths);
    if settled.by_share {
        // What explains most is named first. Faults of the records stay before it.
        let is_fault = |e: &Effect| e.stage == Stage::Record.part();
        effects.sort_by(|a, b| is_fault(b).cmp(&is_fault(a)).then(b.held_out_gain.total_cmp(&a.held_out_gain)));
    }
    let found: Vec<_> = found.iter().zip(settled.constancy.iter().copied().skip(own)).collect();
    let has_row_noise = found.iter().any(|(f, _)| f.id == ROW_NOISE);
    let judged = Judged {
        found: &found,
        left,
        noise_is_left: noise_left(&basis.dependences, &settled.dependences) > NOISE_LEFT,
        rows_wave: has_row_noise.then(|| rhythm(basis.model, &now.predicted)).flatten(),
        psf_error: psf_error(basis),
        recalibrated: settled.recalibrated,
    };
    Names::of(effects, judged)
}

fn verdict(basis: &Basis<'_>, settled: &Settled, names: &Names) -> Verdict {
    let unnamed = settled.found.iter().any(|f| f.id.starts_with("unknown"));
    let left = structured(&settled.dependences) && !basis.within_calibration(&settled.now);
    basis.excess(&settled.now).verdict(left || unnamed || names.uneven)
}

/// Effects that resemble the cause, of those that are out.
fn out_of(settled: &Settled) -> Vec<Nearest> {
    let out = &settled.out;
    // The account numbers terms without a name.
    let label = |f: &Found| if f.id.starts_with("unknown") { "unknown-1" } else { f.id };
    let mut nearest = shadowed(&out.shadowed, settled.found.first().map(label));
    nearest.extend(imitated(&out.imitations));
    let harmed: Vec<_> = out.taken_back.iter().map(|(found, _)| found.clone()).collect();
    nearest.extend(harmful(&harmed));
    nearest
}

/// What a plan starts from: what the account leaves open.
fn planned<'a>(basis: &'a Basis<'_>, settled: &'a Settled, closing: &Closing) -> plan::Found<'a> {
    let ambiguous = closing.effects.iter().filter(|e| e.known && !e.ambiguity.is_empty());
    // Nobody measures a bead scan to learn of a fault that only bead scans have.
    let matters = |id: &str| find(id).is_none_or(|e| !e.is_of_bead_scans());
    let untestable = closing.rejected.iter().filter(|r| r.upper_limit.is_none() && matters(&r.id));
    plan::Found {
        instrument: basis.instrument,
        now: &settled.now,
        replicas: &basis.replicas,
        ambiguous: ambiguous.map(|e| (e.id.clone(), e.ambiguity.clone())).collect(),
        untestable: untestable.map(|r| r.id.clone()).collect(),
    }
}

/// The instrument with the effects of a state in place of its own.
fn with_effects(instrument: &Instrument, model: &Model<'_>, state: &State) -> Instrument {
    let is_on = |t: &&Term| !t.effect.is_of_truths() && (t.id() != PUPIL_DEFOCUS || t.params.iter().any(|v| *v != 0.0));
    let effects = state.terms.iter().filter(is_on).map(|t| t.setting(model.lenses())).collect();
    Instrument { effects, ..instrument.clone() }
}
