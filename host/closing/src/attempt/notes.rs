//! Sentences of the account, and what they are of.

use super::basis::Basis;
use super::settle::Settled;
use crate::account::{
    Effect, Names, TruthRegistration, Verdict, calibration_note, end_notes, pupil_note, registration_notes, rest_notes,
    small_note, unstated_notes,
};
use crate::data::{Observations, Shown, bright_darks};
use crate::evidence::{Curve, Figures, JudgedOn, excess, judged, structured};
use crate::fit::gauge::Gauge;
use crate::fit::{Fitted, Model, PUPIL_DEFOCUS, State, Term, UNKNOWN_NOTE, chosen_notes};
use crate::options::CalibratedOn;
use crate::search::is_laplacian;
use ommatidia_model::forward::ForwardError;
use ommatidia_model::instrument::{Instrument, LightUnit};
use ommatidia_physics::effects::{MOMENT, find};
use ommatidia_physics::noise::Source;
use ommatidia_session::Role;
use std::collections::BTreeSet;

/// What sentences are made from beside what a search ends with.
pub(super) struct Said<'a> {
    pub names: &'a Names,
    pub verdict: Verdict,
    /// Figures of held-out data, after.
    pub after: Figures,
    pub curves: &'a [Curve],
    pub registrations: &'a [TruthRegistration],
    /// Whether the only known frames are those of the calibration.
    pub own_beads: bool,
}

/// All sentences, in their order.
pub(super) fn notes(basis: &Basis<'_>, settled: &Settled, said: &Said<'_>) -> Result<Vec<String>, ForwardError> {
    let Basis { instrument, model, own, .. } = *basis;
    let Settled { now, dependences, .. } = settled;
    let (seen, effects, verdict) = (model.seen, &said.names.effects, said.verdict);
    let mut notes = bright_darks(seen, model.forward.noise());
    notes.extend(out_notes(settled));
    notes.extend(said.names.note());
    notes.extend(effects.iter().find_map(truth_note));
    notes.extend(settled.views_chi2.filter(|_| verdict != Verdict::Adequate).map(views_note));
    notes.extend(effects.iter().find_map(moment_note));
    notes.extend(end_notes(effects));
    notes.extend(noise_note(basis, now, said));
    let misjudged = now.state.terms.iter().find(|t| t.id() == PUPIL_DEFOCUS).map_or(&[][..], |t| &t.params);
    notes.extend(pupil_note(instrument, effects, misjudged, model.forward.depth_error()));
    // Without a bead scan there are no replicates to be had.
    if instrument.replicates.is_empty() && !instrument.sensor_only() && seen.of(Role::Scene).next().is_some() {
        notes.push(
            "the instrument has no calibration replicates, so the uncertainty of the calibration is unknown and small \
             effects may be errors of the calibration; calibrate again"
                .into(),
        );
    }
    notes.extend(pattern_notes(instrument, effects));
    notes.extend(light_notes(instrument, model, &now.state));
    let structure = (structured(dependences), basis.within_calibration(now));
    let of_rest: Vec<String> = rest_notes(model, now, verdict)
        .into_iter()
        .chain(calibration_note(structure, verdict, effects, (&instrument.quality, basis.model.shows_beads())))
        .collect();
    if of_rest.is_empty() {
        notes.extend(small_note(dependences, verdict, effects, said.after));
    }
    notes.extend(of_rest);
    if basis.judged_on == JudgedOn::SelfConsistency {
        notes.push(UNKNOWN_NOTE.into());
    }
    notes.extend(chosen_notes(seen));
    notes.extend(now.gauges.iter().filter(|g| g.term >= own).map(|g| gauge_note(g, &now.state)));
    notes.extend(drift_notes(said.curves));
    if said.own_beads {
        notes.push(OWN_BEADS_NOTE.into());
    }
    notes.extend(registration_notes(said.registrations));
    notes.extend(unstated_notes(model, now, own)?);
    notes.extend(sharper_note(&now.state.terms[own..]));
    Ok(notes)
}

/// That scenes are sharper than their truths predict.
fn sharper_note(found: &[Term]) -> Option<String> {
    let sharper = |t: &&Term| is_laplacian(t) && t.params[0] < 0.0;
    found.iter().find(sharper).map(|_| {
        "the scenes are sharper than their truths predict, everywhere alike: truths that were interpolated or taken by \
         a camera of less resolution are blurred, and a calibration with beads that are larger than stated has too \
         wide PSFs; a bead scan of this day distinguishes them"
            .into()
    })
}

/// What agrees where the truths do not.
fn views_note(chi2: f64) -> String {
    format!(
        "the frames contradict their truths, and the views behind the lenses contradict one another far less: with \
         specimens that are estimated from the frames, under the instrument as it was calibrated, chi-squared per \
         pixel is {chi2:.3}. Either the truths are wrong (their resolution, their light, a specimen that has changed \
         since), or something acts on all views alike, such as light or blur that belongs to the specimen, or a \
         displacement of the array. Without `truth` in the stack, the rest of the optics is tested all the same"
    )
}

/// What to do about blurred truths.
fn truth_note(effect: &Effect) -> Option<String> {
    find(&effect.id).filter(|e| e.is_of_truths())?;
    let width_px = effect.params.first()?.value.sqrt();
    Some(format!(
        "the scenes are sharper than their truths predict, by more than any change of the optics explains: the truths \
         are blurred, as if by a Gaussian of {width_px:.2} px (standard deviation). What such a blur leaves hides \
         smaller changes of the optics, and where it is much the search ends. Take truths of a better resolution, or \
         leave `truth` out of the stack: the specimens are estimated then"
    ))
}

/// What the moment of a jump means in another session.
fn moment_note(effect: &Effect) -> Option<String> {
    let since_s = effect.params.iter().find(|v| v.name == MOMENT)?.value;
    Some(format!(
        "`{}` acts from {since_s:.3} s on, by the times of this session. In sessions with other times the closed \
         instrument would have it in the wrong frames: close each of them from the calibration, or calibrate again",
        effect.id
    ))
}

/// A chi-squared that effects on the noise change by more than this is worth a word.
const BY_NOISE: f64 = 0.02;

/// What chi-squared is over the noise that was found: effects that act on the noise alone change no prediction, and the
/// figures keep the noise of the calibration, so that no fit gains by a larger one.
fn noise_note(basis: &Basis<'_>, now: &Fitted, said: &Said<'_>) -> Option<String> {
    let of_noise = |e: &&Effect| find(&e.id).is_some_and(|effect| effect.noise_only());
    let ids: Vec<String> = said.names.effects.iter().filter(of_noise).map(|e| format!("`{}`", e.id)).collect();
    if ids.is_empty() {
        return None;
    }
    let [over, _] = excess(basis.model, now, basis.judged_on);
    let is_worth_it = (said.after.chi2_ndf - 1.0 - over).abs() > BY_NOISE;
    is_worth_it.then(|| {
        format!(
            "the chi-squared of {:.3} per pixel is over the noise of the calibration, and effects that act on the \
             noise alone leave it as it was. Over the noise with {} it is {:.3}",
            said.after.chi2_ndf,
            ids.join(" and "),
            1.0 + over
        )
    })
}

/// Effects that stand for a pattern of the sensor which the calibration did not know.
fn pattern_notes(instrument: &Instrument, effects: &[Effect]) -> Vec<String> {
    let no_flats = instrument.noise.sources.gain != Source::Measured;
    let unknown = [
        ("dsnu", "offset", "darks", instrument.offset_dn.is_none()),
        (
            "prnu",
            "response",
            "darks and flats",
            instrument.response.is_none() && (no_flats || instrument.offset_dn.is_none()),
        ),
    ];
    let named = unknown.iter().filter(|(id, .., missing)| *missing && effects.iter().any(|e| e.id == *id));
    let note = |(id, what, frames, _): &(&str, &str, &str, bool)| {
        format!(
            "the calibration did not know the {what} of each pixel: `{id}` stands for that pattern, and for no change \
             since. What it leaves can keep an effect of the optics from being named; calibrate with {frames}, or add \
             them to this session"
        )
    };
    named.map(note).collect()
}

/// Light of known specimens that is off by more than this factor is worth a word: lamps age, tables err by tens.
const LIGHT: f64 = 1.5;

/// Stacks whose scenes are much brighter or darker than their records and truths predict. The light of each stack is
/// fitted, so that no test sees it.
fn light_notes(instrument: &Instrument, model: &Model<'_>, state: &State) -> Vec<String> {
    // Without truths in the calibration their unit is not known.
    if !matches!(instrument.light_unit, LightUnit::Truth { .. }) {
        return Vec::new();
    }
    let known = model.seen.frames.iter().filter(|f| matches!(f.shown, Shown::Object(_)));
    let known_stacks: BTreeSet<usize> = known.map(|f| f.stack).collect();
    let off = known_stacks.iter().filter_map(|stack| {
        let factor = *state.scale.get(*stack)?;
        (factor > 0.0 && factor.ln().abs() > LIGHT.ln()).then_some((stack, factor))
    });
    let several = known_stacks.len() > 1;
    off.map(|(stack, factor)| {
        let of = if several { format!(" of stack {stack} (the first is 0)") } else { String::new() };
        format!(
            "the scenes{of} are {factor:.3} times as bright as exposure, illumination and truths predict \
             from the calibration. Their light is fitted, so that nothing else here depends on it; if the lamp was the \
             same, correct `exposure_ms` or `illumination` in their table, or the unit of the truths"
        )
    })
    .collect()
}

/// What was added once, and is out.
fn out_notes(settled: &Settled) -> Vec<String> {
    let note = |why: &str, ids: Vec<&str>| (!ids.is_empty()).then(|| format!("{why}: {}", ids.join(", ")));
    let harmed = settled.out.taken_back.iter().map(|(found, _)| found.id).collect();
    let removed = settled.out.removed.iter().map(Term::id).collect();
    let worse = "taken back, because held-out data were predicted worse with it than before";
    let unnecessary = "added and later removed, because the effects that were added after them made them unnecessary";
    [note(worse, harmed), note(unnecessary, removed)].into_iter().flatten().collect()
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
pub(super) fn background_notes(model: &Model<'_>, state: &State) -> Vec<String> {
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
