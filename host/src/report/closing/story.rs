//! The loop in plain words, and the faults of the record before anything else.

use super::{Asked, words};
use crate::closing::{Closing, Dependence, Effect, Value};
use maud::{Markup, html};

/// Effects that explain less than this share of the excess are named, not told.
const MAIN: f64 = 0.05;

/// The effects that were added to the instrument: faults of the record are told by themselves.
pub fn added(c: &Closing) -> impl Iterator<Item = &Effect> {
    c.effects.iter().filter(|e| e.stage != "record")
}

/// Faults of the record: a box that comes first, since everything else rests on them.
pub fn faults(c: &Closing) -> Markup {
    if c.faults.is_empty() {
        return html! {};
    }
    html! {
        aside.warn {
            h3 { "The session’s record is at fault" }
            p { "These entries were put right before anything was fitted. Correct them in the session, so that nobody trips over them again." }
            ul { @for f in &c.faults { li {
                b { (words::capital(&f.words())) }
                span.soft { " " (words::sigma(f.z)) "; correlation with what the record predicts "
                    (format!("{:.3}", f.correlation_before)) " → " (format!("{:.3}", f.correlation_after)) }
            } } }
        }
    }
}

/// The chapter in a few sentences.
pub fn story(c: &Closing, asked: Asked) -> Markup {
    let noted: Vec<String> = c.notes.iter().map(|n| words::capital(n)).collect();
    html! {
        p.story { (opening(c)) @if asked == Asked::Close { (found(c)) } (rest(c, asked)) }
        @if !noted.is_empty() { ul.notes { @for n in &noted { li { (n) "." } } } }
    }
}

fn opening(c: &Closing) -> Markup {
    let strong = significant(&c.dependences_before);
    let session = if c.session.is_empty() { "the session".to_string() } else { format!("“{}”", c.session) };
    html! {
        "The calibrated instrument was held against " (session) ". On what no fit has seen (" (words::held_out(c)) ") it missed by "
        b { "χ² = " (format!("{:.3}", c.before.chi2_ndf)) " per pixel" } ", where noise alone leaves 1"
        @match strong.as_slice() {
            [] => ", and the residual depended on nothing that was tested. ",
            [first, ..] => {
                ", and the residual had structure: it depended on " (strong.len()) " of " (c.dependences_before.len())
                " covariates, most of all on the " (first.covariate.words()) " (" (words::evidence(first)) "). "
            }
        }
    }
}

fn found(c: &Closing) -> Markup {
    let effects: Vec<&Effect> = added(c).collect();
    if effects.is_empty() {
        return html! { b { "Nothing was added: " } "no effect of the catalogue improves the prediction of held-out data beyond chance. \
        How small each of them must be is told below. " };
    }
    let (main, small): (Vec<&Effect>, Vec<&Effect>) =
        effects.iter().copied().partition(|e| e.id == effects[0].id || e.excess_explained.is_none_or(|f| f >= MAIN));
    html! {
        @for (i, e) in main.iter().enumerate() { (sentence(e, i)) }
        @if !small.is_empty() {
            @let names: Vec<String> = small.iter().map(|e| words::name(&e.id)).collect();
            @let share: f64 = small.iter().filter_map(|e| e.excess_explained).sum();
            "Smaller terms came after: " (words::list(&names, "and")) " (" (format!("{:.0} %", 100.0 * share)) " of the excess"
            @if small.len() > 1 { " together" } "). "
        }
    }
}

/// An effect that is told in full.
fn sentence(e: &Effect, i: usize) -> Markup {
    let others: Vec<String> = e.ambiguity.iter().map(|id| words::name(id)).collect();
    html! {
        @if i == 0 { "What was missing is " } @else { "Then " }
        b { (title(e)) }
        @if let Some(v) = leading(e) { ", " (v) }
        " (" (words::sigma(e.z))
        @if let Some(f) = e.excess_explained { ", " (format!("{:.0} %", 100.0 * f)) " of the excess over noise" }
        "). "
        @if !others.is_empty() {
            @if e.overlap >= words::ALIKE {
                "This session hardly tells it from " (words::list(&others, "or")) " (overlap " (format!("{:.2}", e.overlap)) ")"
            } @else {
                "Just then " (words::list(&others, "or")) " would have explained as much, with a mark of its own (overlap "
                (format!("{:.2}", e.overlap)) ")"
            }
            @if let Some(by) = &e.separate_by { "; to be sure: " i { (by) } }
            ". "
        }
    }
}

/// What a term without a name is called in a sentence.
fn title(e: &Effect) -> String {
    if e.known { words::name(&e.id) } else { format!("a term without a name ({})", e.id) }
}

/// The value that tells an effect's size: the one that stands out most.
fn leading(e: &Effect) -> Option<String> {
    let strength = |v: &&Value| v.sigma > 0.0 && v.value.is_finite();
    let measured: Vec<&Value> = e.params.iter().filter(strength).collect();
    let many = measured.len() > 4;
    if many && !e.known {
        return None;
    }
    let most = measured.into_iter().max_by(|a, b| (a.value / a.sigma).abs().total_cmp(&(b.value / b.sigma).abs()))?;
    let unit = words::unit(&most.unit);
    let number = words::plus_minus(most.value, most.sigma);
    let name = if many { "at most".to_string() } else { format!("{} =", words::param(&most.name)) };
    Some(format!("{name} {number}{}{unit}", if unit.is_empty() { "" } else { " " }))
}

fn rest(c: &Closing, asked: Asked) -> Markup {
    if asked == Asked::Residual {
        return match c.catalogue_incomplete {
            true => {
                html! { "Such structure is no noise: " code { "ommatidia close" } " looks for the effect behind it." }
            }
            false => html! { "The model predicts this session to within its noise." },
        };
    }
    let left = significant(&c.dependences_after);
    html! {
        @if added(c).next().is_some() { "With " @if added(c).count() == 1 { "it" } @else { "them" } " χ² is "
            b { (format!("{:.3}", c.after.chi2_ndf)) " per pixel" } ". " }
        @match (c.catalogue_incomplete, left.first()) {
            (true, Some(d)) => {
                b { "What remains is not noise: " } "it still depends on the " (d.covariate.words()) " (" (words::evidence(d))
                "), and no effect of the catalogue explains that. Take the closed model for better, not for complete."
            }
            (true, None) => {
                b { "The catalogue is incomplete: " } "part of the residual could only be described, not explained. The description holds \
                inside the range that was measured."
            }
            (false, _) => "What remains depends on nothing that was tested: noise."
        }
    }
}

/// The covariates that the residual depends on beyond chance, all of them together, strongest first.
fn significant(dependences: &[Dependence]) -> Vec<&Dependence> {
    let n = dependences.len() as f64;
    let mut strong: Vec<&Dependence> = dependences.iter().filter(|d| d.p * n < 0.01).collect();
    strong.sort_by(|a, b| words::strongest_first(a, b));
    strong
}
