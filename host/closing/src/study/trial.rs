//! Runs one case: measures a session, closes it, and compares the result with the truth.

use super::downstream::{self, Comparison};
use super::foreign;
use super::networks::Networks;
use super::plan::Case;
use super::record::{FoundEffect, HeldOut, Outcome};
use super::sessions::Holds;
use super::size::Question;
use super::subject::Subject;
use crate::evidence::{Figures, figures};
use crate::fit::{Model, Term, refit};
use crate::{Budget, CloseOptions, Closing, Observations, close};
use anyhow::Context;
use ommatidia_model::instrument::Instrument;
use ommatidia_physics::effects::{Effect, EffectSetting, Param, find};
use ommatidia_session::{Role, Session};
use std::collections::BTreeMap;
use std::time::Instant;

/// Standard deviations beyond which a dependence of the residual is reported.
const REPORTED: f64 = 5.0;

/// Runs a case. If it fails, the outcome holds the error.
pub fn run(subject: &Subject, case: &Case, networks: &dyn Networks) -> Outcome {
    let fail = |e: anyhow::Error| Outcome {
        case: case.clone(),
        kind: subject.kind,
        error: Some(format!("{e:#}")),
        ..Outcome::default()
    };
    attempt(subject, case, networks).unwrap_or_else(fail)
}

fn attempt(subject: &Subject, case: &Case, networks: &dyn Networks) -> anyhow::Result<Outcome> {
    let mut settings = Vec::new();
    for it in case.injected.iter().filter(|_| case.question != Question::Foreign) {
        let mut params = vec![(it.param.as_str(), it.value)];
        params.extend(it.others.iter().map(|(name, v)| (name.as_str(), *v)));
        settings.push(EffectSetting::new(&it.id, &params));
    }
    let holds = case.holds;
    let mut bench = holds.config(&subject.config).build_like(&subject.bench, &settings)?;
    for it in case.injected.iter().filter(|_| case.question == Question::Foreign) {
        let effect = foreign::find(&it.id).with_context(|| format!("`{}`: no foreign effect", it.id))?;
        bench = bench.with_foreign(effect, vec![it.value])?;
    }
    let folder = tempfile::tempdir()?;
    let (session, with_truths) = holds.measure_both(&bench, &folder.path().join("session"), case.seed)?;
    let mut instrument = subject.instrument.clone();
    instrument.noise.gain_dn_per_e *= case.gain;
    let mut seen = Observations::read(&session, &Budget::default())?;
    let started = Instant::now();
    let options =
        CloseOptions { session_name: &case.key, seed: case.seed, exclude: &case.excluded, ..CloseOptions::default() };
    let closed = close(&instrument, &mut seen, &options, |_| {})?;
    let seconds = started.elapsed().as_secs_f64();
    let reconstruction = match case.question {
        Question::Reconstruction => {
            let (closed, injected, seed) = (&closed.instrument, &settings, case.seed);
            Some(downstream::compare(networks, &Comparison { subject, bench: &bench, closed, injected, seed })?)
        }
        _ => None,
    };
    let mut closing = closed.account.closing;
    let own = [closing.before, closing.after].map(|f| [f.chi2_ndf, f.nrmse].map(|v| Some(v).filter(|v| v.is_finite())));
    // Where the session withholds its truths, they judge the closed instrument.
    let with_truths = with_truths.filter(|_| Holds::UNKNOWN.contains(&holds));
    if let Some(session) = &with_truths {
        seen = Observations::read(session, &Budget::default())?;
        closing.before = known(&instrument, &seen)?;
        closing.after = known(&closed.instrument, &seen)?;
    }
    let (floor, pixels) = floor(with_truths.as_ref().unwrap_or(&session), &seen, &subject.instrument)?;
    let truth = explainable(&instrument, &seen, case)?;
    let structure = closing.dependences_after.iter().filter(|d| d.z > REPORTED);
    Ok(Outcome {
        case: case.clone(),
        kind: subject.kind,
        nearest: closing.nearest.iter().map(|n| n.id.clone()).collect(),
        verdict: closing.verdict,
        incomplete: closing.catalogue_incomplete,
        structure: structure.map(|d| d.covariate.words().to_string()).collect(),
        held_out: HeldOut { before: closing.before.chi2_ndf, after: closing.after.chi2_ndf, floor, truth, pixels, own },
        found: found(closing),
        reconstruction,
        seconds,
        error: None,
    })
}

fn found(closing: Closing) -> Vec<FoundEffect> {
    let one = |e: crate::Effect| FoundEffect {
        id: e.id,
        known: e.known,
        z: e.z,
        ambiguity: e.ambiguity,
        overlap: e.overlap,
        excess_explained: e.excess_explained,
        params: e.params.into_iter().map(|v| (v.name, [v.value, v.sigma])).collect::<BTreeMap<_, _>>(),
        description: e.description,
    };
    closing.effects.into_iter().map(one).collect()
}

/// chi-squared per pixel on held-out scenes of the instrument with the injected effects, their values fitted from the
/// true ones. None for faults of records and of the gain, which are not effects of an instrument.
fn explainable(instrument: &Instrument, seen: &Observations, case: &Case) -> anyhow::Result<Option<f64>> {
    // Of sessions that hold less, the figures of `close` are of other data than known scenes.
    let of_scenes =
        matches!(case.holds, Holds::Whole | Holds::ManyFrames | Holds::Bright) || Holds::UNKNOWN.contains(&case.holds);
    if matches!(case.question, Question::Records | Question::Gain) || case.injected.is_empty() || !of_scenes {
        return Ok(None);
    }
    if case.injected.iter().any(|it| foreign::find(&it.id).is_some_and(|f| f.noise_only())) {
        return Ok(None);
    }
    let model = Model::new(instrument, seen)?;
    let mut state = model.state(instrument)?;
    for it in &case.injected {
        let effect: &'static dyn Effect = match case.question {
            Question::Foreign => foreign::find(&it.id).with_context(|| format!("`{}`: no foreign effect", it.id))?,
            _ => find(&it.id).with_context(|| format!("`{}`: no effect", it.id))?,
        };
        let value = |(name, p): (String, &Param)| if name == it.param { it.value } else { p.off };
        let params: Vec<f64> = effect.descriptor().expanded(model.lenses()).into_iter().map(value).collect();
        let table = effect.table().map(|_| effect.draw_table(&params, seen.sensor));
        state.terms.push(Term { effect, params, table, table_error: 0.0 });
    }
    let fitted = refit(&model, state)?;
    Ok(Some(figures(&model, &fitted).chi2_ndf))
}

/// How well an instrument predicts a session whose objects are known.
fn known(instrument: &Instrument, seen: &Observations) -> anyhow::Result<Figures> {
    let model = Model::new(instrument, seen)?;
    Ok(figures(&model, &refit(&model, model.state(instrument)?)?))
}

/// chi-squared per pixel of the held-out scenes against the noise-free frames of the bench, and the number of pixels.
fn floor(session: &Session, seen: &Observations, instrument: &Instrument) -> anyhow::Result<(f64, usize)> {
    let Some(stack) = session.stacks_of(Role::Scene).next() else { return Ok((0.0, 0)) };
    let mut expected = stack.expected()?.context("the bench wrote no noise-free frames")?;
    let noise = &instrument.noise;
    let dark = noise.variance_dn2(noise.black_level_dn);
    let (mut chi2, mut n) = (0.0, 0usize);
    for f in seen.frames.iter().filter(|f| f.role == Role::Scene && f.held_out) {
        let mu = expected.read(f.info.frame)?;
        // The fixed pattern of the offset makes no noise; what its map errs by is as often below as above.
        let lit = instrument.offset_dn.as_ref().map_or_else(|| mu.clone(), |offset| &mu - offset);
        for ((y, mu), lit) in f.measured.iter().zip(&mu).zip(&lit) {
            let light = f64::from(*lit) - noise.black_level_dn;
            let variance = (dark + noise.gain_dn_per_e * light).max(0.25 * dark);
            if f64::from(*mu) + 4.0 * variance.sqrt() < noise.saturation_dn {
                chi2 += f64::from(y - mu).powi(2) / variance;
                n += 1;
            }
        }
    }
    Ok((chi2 / n.max(1) as f64, n))
}
