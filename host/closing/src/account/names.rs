//! Which of the effects that were found are named as causes.

use super::result::{Effect, Nearest, Value};
use super::verdict::{Left, claims_a_cause};
use crate::evidence::Constancy;
use crate::fit::repeats::is_of_noise;
use crate::search::Found;
use ommatidia_physics::effects::{self as physics, Param, find};

/// A name stands beside a term without a name that explains at most this share of what the effect explains.
const HALF: f64 = 0.5;
/// A name whose strength is not shown to be even stands beside terms and effects that are no causes if
/// they explain at most this share of what it explains: a true law that is a little different from that of the
/// catalogue leaves as much.
const TENTH: f64 = 0.1;

/// The effect whose offsets are independent from row to row.
pub(crate) const ROW_NOISE: &str = "row_noise";

/// An effect of less evidence than this (z) has no name if all its strengths are within so many of their errors of
/// none. The evidence knows the noise and the replicates of the calibration, the errors also what their law leaves.
const FAINT: f64 = 6.0;
const WITHIN: f64 = 3.0;

/// A strength is at the end of its range if it lies this close to it, relative.
const END: f64 = 1e-3;

/// Effects by which light is brighter or darker from place to place, the same in all frames.
const SHADES: [&str; 4] = ["vignetting", "excitation_profile", "chief_ray_response", "lens_gain"];
/// So many of them at once are a set that imitates a cause.
const SET: usize = 3;

/// What names are judged by.
#[derive(Clone, Copy)]
pub(crate) struct Judged<'a> {
    /// What was found, and whether it has one strength everywhere.
    pub(crate) found: &'a [(&'a Found, Constancy)],
    /// Shares of the excess of chi-squared that are left with structure.
    pub(crate) left: Left,
    /// Whether the noise of repeated frames still has much of its structure.
    pub(crate) noise_is_left: bool,
    /// Rows after which a wave repeats that the offsets of the rows follow, if they do.
    pub(crate) rows_wave: Option<f64>,
    /// Relative error of the PSFs between the positions of their calibration.
    pub(crate) psf_error: f64,
    /// Whether the PSFs are calibrated again, and an entry stands for that.
    pub(crate) recalibrated: bool,
}

/// Names of causes, and what only resembles one.
#[derive(Debug, Default)]
pub(crate) struct Names {
    /// Effects that are named as causes, and terms that claim none.
    pub(crate) effects: Vec<Effect>,
    /// Effects whose names are not earned. The instrument keeps them: they predict held-out data better.
    pub(crate) nearest: Vec<Nearest>,
    /// Whether one of these lost its name for what is left of the excess.
    pub(crate) left_much: bool,
    /// Whether one of these has no one strength, or is one of a set that imitates a cause.
    pub(crate) uneven: bool,
}

impl Names {
    /// Takes the names from effects that imitate the cause in part: where much is left beside them, where their
    /// strength differs from frame to frame or over the sensor, and where the noise still has structure.
    pub(crate) fn of(all: Vec<Effect>, judged: Judged<'_>) -> Self {
        let found = |e: &Effect| judged.found.iter().find(|(f, _)| f.id == e.id);
        // Darks and even light prove a table pixel by pixel, whatever is left of the scenes. Nothing but blurred truths
        // makes scenes sharper by more than any effect of the optics, and their blur is no Gaussian.
        let may_imitate = |e: &Effect| {
            let proved = |effect: &&dyn physics::Effect| effect.table().is_some() || effect.is_of_truths();
            claims_a_cause(e, judged.recalibrated) && !find(&e.id).is_some_and(|effect| proved(&effect))
        };
        let objection = |e: &Effect| found(e).and_then(|(_, constancy)| constancy.objection(judged.psf_error));
        let uneven: Vec<&Found> = all
            .iter()
            .filter(|e| may_imitate(e) && objection(e).is_some())
            .filter_map(|e| found(e).map(|(f, _)| *f))
            .collect();
        let stronger = |e: &Effect| {
            let (own, _) = found(e)?;
            uneven.iter().find(|f| own.share_of(f) > 1.0).map(|f| f.id)
        };
        let share = 100.0 * judged.left.judged.max(judged.left.even);
        let mut names = Self::default();
        for effect in all {
            let why = if !may_imitate(&effect) {
                None
            } else if let Some(share) = whole_share(&effect) {
                Some(format!("{share} is all of the light: it imitates the cause"))
            } else if effect.z < FAINT && is_within_errors(&effect) {
                Some(format!(
                    "its evidence is faint (z = {:.1}), and with the error of the calibration its strength is less \
                     than {WITHIN} errors from none",
                    effect.z
                ))
            } else if let Some(rows) = judged.rows_wave.filter(|_| effect.id == ROW_NOISE) {
                Some(format!(
                    "the offsets of the rows follow a wave of {rows:.1} rows, with another phase in each frame, and \
                     those of row noise are independent: interference, of a supply or a clock for example"
                ))
            } else if found(&effect).is_some_and(|(f, constancy)| !judged.left.earns(f, *constancy)) {
                names.left_much = true;
                Some(format!(
                    "{share:.0} % of the excess is left beside it, with structure: it imitates the cause in part"
                ))
            } else if let Some(why) = objection(&effect) {
                names.uneven = true;
                Some(why)
            } else if let Some(id) = stronger(&effect) {
                // What imitates a cause leaves some of it, and weaker effects mend that.
                Some(format!(
                    "it explains less than `{id}`, whose strength is not the same everywhere, and may mend what that \
                     leaves"
                ))
            } else if let Some(share) = found(&effect).and_then(|(f, _)| beside_unnamed(f, judged.found)) {
                Some(format!(
                    "a term without a name explains {:.0} % of what it explains: a cause outside the catalogue is at \
                     work, which this effect may imitate in part",
                    100.0 * share
                ))
            } else if let Some((share, ids)) = found(&effect).and_then(|it| beside_no_causes(it, &uneven, judged.found))
            {
                Some(format!(
                    "what is no cause ({ids}) explains {:.0} % of what it explains, and its own strength is not shown \
                     to be even over frames and sensor: it imitates the cause in part",
                    100.0 * share
                ))
            } else if judged.noise_is_left
                && find(&effect.id).is_some_and(is_of_noise)
                && !found(&effect).is_some_and(|(_, constancy)| constancy.is_shown())
            {
                // A cause in the noise is first shared out among the effects of the noise. One strength in the means of
                // all frames is no matter of the noise.
                Some("the noise of repeated frames still has structure beside it: it imitates the cause in part".into())
            } else {
                None
            };
            match why {
                Some(why) => names.nearest.push(Nearest { id: effect.id, z: effect.z, why }),
                None => names.effects.push(effect),
            }
        }
        names.without_sets();
        names
    }

    /// Takes the names from effects that only as a set make the change that was seen: three of those that make light
    /// brighter or darker from place to place describe any smooth shade together. That three of them have changed at
    /// once is less likely than one cause outside the catalogue.
    fn without_sets(&mut self) {
        let shades = |e: &Effect| SHADES.contains(&e.id.as_str());
        if self.effects.iter().filter(|e| shades(e)).count() < SET {
            return;
        }
        let (set, kept): (Vec<Effect>, _) = std::mem::take(&mut self.effects).into_iter().partition(shades);
        self.effects = kept;
        self.uneven = true;
        let ids: Vec<String> = set.iter().map(|e| e.id.clone()).collect();
        self.nearest.extend(set.into_iter().map(|e| Nearest {
            why: format!(
                "only together do {} describe the shade that was seen, as they would any other",
                ids.join(", ")
            ),
            id: e.id,
            z: e.z,
        }));
    }

    /// Takes the names from all effects but blurred truths: the model does not describe the session, so that what was
    /// found is at most a part of what is wrong, pixel tables of darks and flats included.
    /// `recalibrated`: as in [`Judged::recalibrated`].
    pub(crate) fn disown(&mut self, recalibrated: bool) {
        let of_truths = |e: &Effect| find(&e.id).is_some_and(|effect| effect.is_of_truths());
        let disowned = |e: &Effect| claims_a_cause(e, recalibrated) && !of_truths(e);
        let (named, kept): (Vec<Effect>, _) = std::mem::take(&mut self.effects).into_iter().partition(disowned);
        self.effects = kept;
        self.nearest.extend(named.into_iter().map(|e| Nearest {
            id: e.id,
            z: e.z,
            why: "the frames are not those of this model: what was found is at most a part of what is wrong".into(),
        }));
    }

    /// Says which terms the instrument has that are no causes. None: there are none.
    pub(crate) fn note(&self) -> Option<String> {
        let ids: Vec<&str> = self.nearest.iter().map(|n| n.id.as_str()).collect();
        (!ids.is_empty()).then(|| {
            format!(
                "the closed instrument corrects its frames by terms in the form of {}, with which it predicts held-out \
                 data better. They only resemble the cause, and are not named as it",
                ids.join(", ")
            )
        })
    }
}

/// Whether all strengths of an effect are within [`WITHIN`] of their errors of none. Not those that each lens has.
fn is_within_errors(effect: &Effect) -> bool {
    let params = find(&effect.id).map_or(&[][..], |e| e.descriptor().params);
    let is_strength = |v: &&Value| params.iter().any(|p| p.name == v.name && p.is_strength());
    let mut strengths = effect.params.iter().filter(is_strength).peekable();
    strengths.peek().is_some() && strengths.all(|v| v.value.abs() < WITHIN * v.sigma)
}

/// Strengths of an effect that are at an end of their range, each with the end.
fn ends(effect: &Effect) -> impl Iterator<Item = (&Value, &'static Param)> {
    let params = find(&effect.id).map_or(&[][..], |e| e.descriptor().params);
    effect.params.iter().filter_map(|v| {
        let p = params.iter().find(|p| p.name == v.name && p.is_strength())?;
        let is_at = |end: f64| end != p.off && (v.value - end).abs() < END * (end - p.off).abs();
        (is_at(p.min) || is_at(p.max)).then_some((v, p))
    })
}

/// The share of the light that is all of it, in words: all of the light in a halo, say, is no halo. None: no strength
/// of the effect is such a share.
fn whole_share(effect: &Effect) -> Option<String> {
    let whole = ends(effect).find(|(v, p)| p.unit == "1" && p.max == 1.0 && v.value > p.off);
    whole.map(|(v, _)| format!("its {} of {:.2}", v.name, v.value))
}

/// Says which strengths of named effects stopped at the end of the range that is searched.
pub(crate) fn end_notes(effects: &[Effect]) -> Vec<String> {
    let of = |e: &Effect| {
        let one = |(v, p): (&Value, &Param)| match p.unit {
            "1" => format!("{} = {}", v.name, v.value),
            unit => format!("{} = {} {unit}", v.name, v.value),
        };
        let all: Vec<String> = ends(e).map(one).collect();
        (!all.is_empty()).then(|| {
            format!(
                "`{}`: {} is the end of the range that is searched. The true value may lie beyond it, and its error \
                 says nothing of that",
                e.id,
                all.join(", ")
            )
        })
    };
    effects.iter().filter_map(of).collect()
}

/// What the strongest term without a name explains of held-out data, over what an effect does, where that is half or
/// more.
fn beside_unnamed(effect: &Found, all: &[(&Found, Constancy)]) -> Option<f64> {
    let unnamed = all.iter().filter(|(f, _)| f.id.starts_with("unknown"));
    Some(unnamed.map(|(f, _)| effect.share_of(f)).fold(0.0, f64::max)).filter(|share| *share > HALF)
}

/// What terms without a name and effects with no one strength (`uneven`) explain of held-out data, over what an effect
/// does, with their ids. None: that is little, or the strength of the effect is even everywhere, or it cannot be
/// compared.
fn beside_no_causes(
    (effect, constancy): &(&Found, Constancy),
    uneven: &[&Found],
    all: &[(&Found, Constancy)],
) -> Option<(f64, String)> {
    if !constancy.is_compared() || constancy.is_even() {
        return None;
    }
    let unnamed = all.iter().map(|(f, _)| *f).filter(|f| f.id.starts_with("unknown"));
    let others: Vec<&Found> = unnamed.chain(uneven.iter().copied()).filter(|f| f.id != effect.id).collect();
    let share: f64 = others.iter().map(|f| effect.share_of(f).max(0.0)).sum();
    let ids: Vec<&str> = others.iter().map(|f| f.id).collect();
    tracing::info!("what is no cause ({}) explains {share:.3} of what {} explains", ids.join(", "), effect.id);
    (share > TENTH).then(|| (share, ids.join(", ")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::Spread;

    /// Nothing is left beside what was found.
    fn judged<'a>(found: &'a [(&'a Found, Constancy)]) -> Judged<'a> {
        Judged {
            found,
            left: Left::default(),
            noise_is_left: false,
            rows_wave: None,
            psf_error: 0.0,
            recalibrated: false,
        }
    }

    fn effect(id: &str) -> Effect {
        Effect {
            id: id.into(),
            known: !id.starts_with("unknown"),
            stage: "optics".into(),
            added: true,
            changed: false,
            z: 9.0,
            excess_explained: None,
            held_out_gain: 0.0,
            ambiguity: Vec::new(),
            overlap: 0.0,
            separate_by: None,
            params: Vec::new(),
            description: String::new(),
        }
    }

    fn found(id: &'static str, held_out_gain: f64) -> Found {
        Found {
            id,
            z: 9.0,
            held_out_gain,
            of_even_light: 0.0,
            proved_by_even_light: false,
            ambiguity: Vec::new(),
            table_sigma: None,
        }
    }

    fn names(of: &[(&Found, Constancy)], left: Left, noise_is_left: bool) -> Names {
        let all = of.iter().map(|(f, _)| effect(f.id)).collect();
        Names::of(all, Judged { left, noise_is_left, ..judged(of) })
    }

    #[test]
    fn what_has_no_one_strength_is_no_cause_nor_what_is_weaker() {
        let uneven = Constancy { frames: Spread { tau: 0.7, z: 9.0, resolution: 0.05 }, ..Constancy::default() };
        let [strong, uneven_one, weak] = [found("array_shift", 9e3), found("magnification", 1e3), found("halo", 1e2)];
        let of = [(&strong, Constancy::default()), (&uneven_one, uneven), (&weak, Constancy::default())];
        let it = names(&of, Left::default(), false);
        let ids: Vec<&str> = it.effects.iter().map(|e| e.id.as_str()).collect();
        assert_eq!((ids, it.uneven, it.left_much), (vec!["array_shift"], true, false));
        assert!(it.nearest[0].why.contains("70 % between frames") && it.nearest[1].why.contains("`magnification`"));
        assert!(it.note().is_some_and(|note| note.contains("magnification, halo")));
    }

    #[test]
    fn a_model_that_does_not_describe_the_session_names_nothing_and_keeps_what_claims_no_cause() {
        let [table, unnamed] = [found("hot_pixels", 9e3), found("unknown_factor", 1e3)];
        let none = Constancy::default();
        let mut it = names(&[(&table, none), (&unnamed, none)], Left::default(), false);
        assert_eq!(it.effects.len(), 2);
        it.disown(false);
        assert_eq!((it.effects[0].id.as_str(), it.nearest[0].id.as_str()), ("unknown_factor", "hot_pixels"));
        assert_eq!((it.effects.len(), it.nearest.len()), (1, 1));
        // Nor are truths in doubt that are blurred so much that no model describes their scenes.
        let (truths, much) = (found("truth_blur", 9e3), Left { judged: 0.9, even: 0.0, much: true });
        let mut it = names(&[(&truths, none)], much, false);
        it.disown(false);
        assert_eq!((it.effects.len(), it.left_much), (1, false));
    }

    #[test]
    fn the_rows_of_interference_are_no_row_noise() {
        let (noise, none) = (found("row_noise", 1e2), Constancy::default());
        let named = |rows_wave| {
            let found = [(&noise, none)];
            let judged = Judged { rows_wave, ..judged(&found) };
            Names::of(vec![effect("row_noise")], judged)
        };
        assert_eq!(named(None).effects.len(), 1);
        assert!(named(Some(12.3)).nearest[0].why.contains("12.3 rows"));
    }

    #[test]
    fn faint_evidence_names_nothing_that_its_error_does_not_tell_from_none() {
        let (halo, none) = (found("halo", 1e3), Constancy::default());
        let named = |z: f64, value: f64| {
            let value = Value { name: "weight".into(), value, sigma: 7e-4, sigma_noise: 4e-4, unit: "1".into() };
            let found = [(&halo, none)];
            let judged = judged(&found);
            Names::of(vec![Effect { z, params: vec![value], ..effect("halo") }], judged)
        };
        assert!(named(4.0, 1.6e-3).nearest[0].why.contains("faint (z = 4.0)"));
        assert_eq!((named(4.0, 3e-3).effects.len(), named(9.0, 1.6e-3).effects.len()), (1, 1));
    }

    #[test]
    fn a_halo_of_all_light_is_none() {
        let (halo, none) = (found("halo", 1e3), Constancy::default());
        let of = |value: f64| {
            let value = Value { name: "weight".into(), value, sigma: 0.1, sigma_noise: 0.1, unit: "1".into() };
            let found = [(&halo, none)];
            let judged = judged(&found);
            Names::of(vec![Effect { params: vec![value], ..effect("halo") }], judged)
        };
        assert_eq!(of(0.4).effects.len(), 1);
        assert!(of(1.0).nearest[0].why.contains("weight of 1.00"));
        assert!(end_notes(&of(0.4).effects).is_empty());
    }

    #[test]
    fn a_strength_that_stopped_at_the_end_of_what_is_searched_has_its_name_and_a_note() {
        let (distortion, none) = (found("radial_distortion", 1e3), Constancy::default());
        let value =
            |value| Value { name: "k1_per_mm2".into(), value, sigma: 0.1, sigma_noise: 0.1, unit: "mm^-2".into() };
        let judged = Judged {
            found: &[(&distortion, none)],
            left: Left::default(),
            noise_is_left: false,
            rows_wave: None,
            psf_error: 0.0,
            recalibrated: false,
        };
        let of = |v| Names::of(vec![Effect { params: vec![value(v)], ..effect("radial_distortion") }], judged).effects;
        assert!([-20.0, 20.0].iter().all(|v| of(*v).len() == 1 && end_notes(&of(*v))[0].contains("k1_per_mm2 = ")));
        assert!(end_notes(&of(19.0)).is_empty());
    }

    #[test]
    fn three_shades_are_a_set_and_two_are_not() {
        let all = ["chief_ray_response", "lens_gain", "array_shift", "excitation_profile"].map(|id| found(id, 1e3));
        let of = all.each_ref().map(|f| (f, Constancy::default()));
        let it = names(&of, Left::default(), false);
        let ids: Vec<&str> = it.effects.iter().map(|e| e.id.as_str()).collect();
        assert_eq!((ids, it.nearest.len(), it.uneven), (vec!["array_shift"], 3, true));
        assert!(it.nearest[0].why.contains("chief_ray_response, lens_gain, excitation_profile"), "{it:?}");
        assert_eq!(names(&of[..3], Left::default(), false).effects.len(), 3);
    }

    #[test]
    fn a_name_needs_more_than_a_term_without_a_name_beside_it() {
        let none = Constancy::default();
        let [named, unnamed] = [found("lens_gain", 1e3), found("unknown_factor", 2e3)];
        let it = names(&[(&named, none), (&unnamed, none)], Left::default(), false);
        assert!(it.nearest[0].why.contains("200 %") && it.effects.len() == 1, "{it:?}");
        let strong = found("lens_gain", 5e3);
        assert_eq!(names(&[(&strong, none), (&unnamed, none)], Left::default(), false).effects.len(), 2);
        // A curve that flats prove has nothing to do with a shadow that scenes alone show.
        let curve = Found { of_even_light: 0.9, ..found("nonlinearity", 1e3) };
        assert_eq!(names(&[(&curve, none), (&unnamed, none)], Left::default(), false).effects.len(), 2);
    }

    #[test]
    fn what_is_not_shown_to_be_even_is_no_cause_beside_what_is_none() {
        let of = |tau: f64| Constancy {
            frames: Spread { tau: 0.0, z: 0.3, resolution: 0.04 },
            blocks: Spread { tau, z: 5.0, resolution: 0.05 },
            light: 0.0,
        };
        let [strong, weak] = [found("lens_gain", 9e3), found("charge_diffusion", 1e3)];
        let named = |tau, gain| {
            let weak = Found { held_out_gain: gain, ..weak.clone() };
            let it = names(&[(&strong, of(tau)), (&weak, of(0.2))], Left::default(), false);
            it.effects.iter().map(|e| e.id.clone()).collect::<Vec<_>>()
        };
        // The weaker one has no one strength. The other: shown to be even, not shown, and not shown beside little.
        assert_eq!(named(0.07, 2e3), ["lens_gain"]);
        assert!(named(0.12, 1e3).is_empty());
        assert_eq!(named(0.12, 5e2), ["lens_gain"]);
        // Nothing to compare, such as the noise alone shows.
        let unnamed = found("unknown_factor", 1e3);
        let it = names(&[(&strong, Constancy::default()), (&unnamed, Constancy::default())], Left::default(), false);
        assert_eq!(it.effects.len(), 2);
    }

    #[test]
    fn names_stand_where_nothing_is_against_them() {
        let [optics, noise] = [found("array_shift", 9e3), found("row_noise", 1e2)];
        let of = [(&optics, Constancy::default()), (&noise, Constancy::default())];
        assert_eq!(names(&of, Left::default(), false).effects.len(), 2);
        let it = names(&of, Left::default(), true);
        assert_eq!((it.effects.len(), it.nearest[0].id.as_str()), (1, "row_noise"));
        // What the means of all frames prove needs no noise.
        let drift = found("black_level_drift", 1e2);
        let even = Spread { tau: 0.0, z: 0.4, resolution: 0.01 };
        let it = names(&[(&drift, Constancy { frames: even, blocks: even, light: 0.0 })], Left::default(), true);
        assert_eq!(it.effects.len(), 1);
        let it = names(&of, Left { judged: 0.3, even: 0.3, much: false }, false);
        assert!(it.effects.is_empty() && it.left_much && it.nearest[0].why.contains("30 %"));
    }
}
