//! Effects that the instrument had already, and that have other strengths in this session.

use super::basis::Basis;
use super::settle::Settled;
use crate::account::{Effect, Value, by_depth, values};
use crate::evidence::Test;
use crate::fit::{Model, State, Term, refit};
use ommatidia_model::forward::ForwardError;
use ommatidia_physics::effects::EffectSetting;

/// A strength has changed from this many of its standard errors ...
const CHANGED: f64 = 5.0;
/// ... and by this share of the largest strength of its unit: the instrument does not keep the errors of its effects.
const MUCH: f64 = 0.05;

/// The effects of the instrument that have changed.
///
/// # Errors
/// An object holds negative or non-finite light.
pub(super) fn changed(basis: &Basis<'_>, settled: &Settled) -> Result<Vec<Effect>, ForwardError> {
    let Basis { instrument, model, own, .. } = *basis;
    let (now, mut effects) = (&settled.now, Vec::new());
    for (t, term) in now.state.terms.iter().enumerate().take(own) {
        let setting = instrument.effects.iter().find(|e| e.id == term.id());
        let (Some(setting), Some(Some(test))) = (setting, settled.tests.get(t)) else { continue };
        let changes = Changes::of(model, term, setting, test);
        if changes.z < CHANGED {
            continue;
        }
        // What the change is worth: all else is fitted to the effect as it was.
        let mut state = State { held: [now.state.held.clone(), vec![term.id().into()]].concat(), ..now.state.clone() };
        state.terms[t].params.clone_from(&changes.before);
        let gain = refit(model, state)?.held_out.deviance - now.held_out.deviance;
        if gain > 0.0 {
            effects.push(changes.effect(term, gain, basis));
        }
    }
    Ok(effects)
}

/// How an effect differs from that of the instrument.
struct Changes {
    /// The largest significant change, standard errors; 0: none.
    z: f64,
    /// Its values in the instrument.
    before: Vec<f64>,
    /// Its values now.
    values: Vec<Value>,
    /// The strengths that have changed, in words.
    words: Vec<String>,
}

impl Changes {
    fn of(model: &Model<'_>, term: &Term, setting: &EffectSetting, test: &Test) -> Self {
        let expanded = term.expanded(model.lenses());
        let before: Vec<f64> =
            expanded.iter().map(|(name, p)| setting.params.get(name).copied().unwrap_or(p.off)).collect();
        let size = |unit: &str| {
            let same = expanded.iter().zip(&before).filter(|((_, p), _)| p.is_strength() && p.unit == unit);
            same.map(|((_, p), v)| (v - p.off).abs()).fold(0.0, f64::max)
        };
        let mut values = values(model, term, Some(test));
        by_depth(model, term.id(), &mut values);
        let (mut z, mut words) = (0.0, Vec::new());
        for ((Value { name, value, sigma, .. }, (_, p)), was) in values.iter().zip(&expanded).zip(&before) {
            let change = (value - was).abs();
            if p.is_strength() && *sigma > 0.0 && change > (CHANGED * sigma).max(MUCH * size(p.unit)) {
                z = f64::max(z, change / sigma);
                let unit = if p.unit == "1" { String::new() } else { format!(" {}", p.unit) };
                words.push(format!("{name} was {was:.4}{unit}, and is {value:.4} +- {sigma:.4}{unit}"));
            }
        }
        Self { z, before, values, words }
    }

    fn effect(self, term: &Term, gain: f64, basis: &Basis<'_>) -> Effect {
        let chi2 = basis.unchanged.held_out;
        let excess = chi2.chi2 - chi2.pixels;
        Effect {
            id: term.id().into(),
            known: !term.id().starts_with("unknown"),
            stage: term.effect.descriptor().stage.part().into(),
            added: true,
            changed: true,
            z: self.z,
            excess_explained: (excess > 3.0 * (2.0 * chi2.pixels).sqrt()).then(|| (gain / excess).clamp(0.0, 1.0)),
            held_out_gain: gain,
            ambiguity: Vec::new(),
            overlap: 0.0,
            separate_by: None,
            params: self.values,
            description: format!("an effect that the instrument had has changed: {}", self.words.join("; ")),
        }
    }
}
