//! The result in a few sentences, and the faults of the records.

use super::{Asked, words};
use maud::{Markup, html};
use ommatidia_closing::{Closing, Dependence, Effect, Fault, JudgedOn, Value};
use ommatidia_physics::effects::find;

/// Effects that explain less than this share of the excess are named without details.
const MAIN: f64 = 0.05;
/// Faults of the records before the others are folded.
const FEW: usize = 4;
/// A fall of chi-squared by less than this share is not called better.
const VISIBLE: f64 = 1e-3;

/// The effects that were added to the instrument, without faults of the records.
pub fn added(c: &Closing) -> impl Iterator<Item = &Effect> {
    c.effects.iter().filter(|e| e.stage != "record")
}

/// Faults of the records, in a box. It comes first, since every other result depends on the records.
pub fn faults(c: &Closing) -> Markup {
    if c.faults.is_empty() {
        return html! {};
    }
    html! {
        aside.warn {
            h3 { "The records of the session have faults" }
            @if !c.faults.iter().any(|f| f.kind.is_of_all_truths()) {
                p { "They were corrected before the fit. Correct them in the session as well." }
            }
            @let (few, more) = c.faults.split_at(c.faults.len().min(FEW));
            (listed(few))
            @if !more.is_empty() { details { summary { (more.len()) " more frames" } (listed(more)) } }
        }
    }
}

fn listed(faults: &[Fault]) -> Markup {
    html! {
        ul { @for f in faults { li {
            b { (words::capital(&f.words())) }
            span.soft { " " (words::sigma(f.z)) "; correlation with the frame that the record predicts "
                (format!("{:.3}", f.correlation_before)) " → " (format!("{:.3}", f.correlation_after)) }
        } } }
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
        "The calibrated instrument was compared with " (session)
        @if c.judged_on == JudgedOn::Nothing {
            ". Nobody knows the specimens of its frames, so how well the optics predict them was not judged: only what \
             follows the grid of the pixels was looked for"
        } @else {
        ". On " @if c.own_beads { "data that are not independent" } @else { "held-out data" }
        " (" (words::held_out(c)) ") the residual was "
        b { "χ² = " (format!("{:.3}", c.before.chi2_ndf)) " per pixel" } "; noise alone gives 1"
        }
        @match strong.as_slice() {
            [] => ". The residual depended on none of the tested covariates. ",
            [first, ..] => {
                ". The residual had structure: it depended on " (strong.len()) " of " (c.dependences_before.len())
                " covariates, most significantly on the " (first.covariate.words()) " (" (words::evidence(first)) "). "
            }
        }
    }
}

fn found(c: &Closing) -> Markup {
    let effects: Vec<&Effect> = added(c).collect();
    if c.faults.iter().any(|f| f.kind.is_of_all_truths()) {
        return html! { b { "No effect was searched for" } ", since the truths are misplaced. " };
    }
    if effects.is_empty() && !c.nearest.is_empty() {
        return nearest(c);
    }
    if effects.is_empty() {
        return html! { b { "No effect was added: " } "none of the catalogue improves the prediction of held-out data \
        significantly. The upper limit of each is listed below. " };
    }
    let (main, small): (Vec<&Effect>, Vec<&Effect>) =
        effects.iter().copied().partition(|e| e.id == effects[0].id || e.excess_explained.is_none_or(|f| f >= MAIN));
    html! {
        @for (i, e) in main.iter().enumerate() { (sentence(e, i)) }
        @if !small.is_empty() {
            @let names: Vec<String> = small.iter().map(|e| words::name(&e.id)).collect();
            @let share: f64 = small.iter().filter_map(|e| e.excess_explained).sum();
            "Smaller effects were added after: " (words::list(&names, "and"))
            " (" (format!("{:.0} %", 100.0 * share)) " of the excess"
            @if small.len() > 1 { " together" } "). "
        }
        (nearest(c))
    }
}

/// Effects that are like what was seen without being its cause.
fn nearest(c: &Closing) -> Markup {
    html! {
        @if !c.nearest.is_empty() {
            b { "Not shown as a cause: " }
            @for (i, same) in c.nearest.chunk_by(|a, b| a.why == b.why).enumerate() {
                @let names: Vec<String> = same.iter().map(|n| words::name(&n.id)).collect();
                @if i > 0 { "; " } (words::list(&names, "and")) ": " (same[0].why)
            }
            ". "
        }
    }
}

/// One effect in a sentence.
fn sentence(e: &Effect, i: usize) -> Markup {
    let others: Vec<String> = e.ambiguity.iter().map(|id| words::name(id)).collect();
    html! {
        @if find(&e.id).is_some_and(|effect| effect.is_of_truths()) { "The truths of the session are blurred: " }
        @else if e.changed { "The instrument had this effect already, with another strength: " }
        @else if i == 0 { "The model lacked " } @else { "It also lacked " }
        b { (title(e)) }
        @if let Some(v) = leading(e) { ", " (v) }
        " (" (words::sigma(e.z))
        @if let Some(f) = e.excess_explained { ", " (format!("{:.0} %", 100.0 * f)) " of the excess over noise" }
        "). "
        @if !others.is_empty() {
            @if e.overlap >= words::ALIKE {
                "This session hardly distinguishes it from " (words::list(&others, "or"))
                " (overlap " (format!("{:.2}", e.overlap)) ")"
            } @else {
                (words::capital(&words::list(&others, "or")))
                " would have explained as much, with another signature (overlap "
                (format!("{:.2}", e.overlap)) ")"
            }
            @if let Some(by) = &e.separate_by { "; to distinguish them: " i { (by) } }
            ". "
        }
    }
}

/// Name of an effect in a sentence.
fn title(e: &Effect) -> String {
    if e.known { words::name(&e.id) } else { format!("a term without a name ({})", e.id) }
}

/// The most significant value of an effect.
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

/// Whether the closed instrument predicts held-out data visibly better.
fn is_better(c: &Closing) -> bool {
    c.effects.iter().any(|e| e.added) && c.after.chi2_ndf < (1.0 - VISIBLE) * c.before.chi2_ndf
}

fn rest(c: &Closing, asked: Asked) -> Markup {
    if asked == Asked::Residual {
        return match c.catalogue_incomplete {
            true => {
                html! { "This structure is not noise; " code { "ommatidia close" } " searches for its cause." }
            }
            false => match significant(&c.dependences_before).first() {
                Some(d) => trace(d),
                None => html! { "The model predicts this session within its noise." },
            },
        };
    }
    let left = significant(&c.dependences_after);
    html! {
        @if added(c).next().is_some() && c.judged_on != JudgedOn::Nothing {
            "With " @if added(c).count() == 1 { "it" } @else { "them" } " χ² is "
            b { (format!("{:.3}", c.after.chi2_ndf)) " per pixel" } ". " }
        @match (c.catalogue_incomplete, left.first()) {
            (true, Some(d)) => {
                b { "The remaining residual is not noise: " }
                "it still depends on the " (d.covariate.words()) " (" (words::evidence(d))
                "), and no effect of the catalogue explains that."
                @if is_better(c) { " The closed model is better but not complete." }
            }
            (true, None) => {
                b { "The catalogue is incomplete: " } "part of the residual is described by a term without a name, \
                                                       whose cause is not identified. It is valid in the measured \
                                                       range only."
            }
            (false, Some(d)) => (trace(d))
            (false, None) => "The remaining residual depends on none of the tested covariates; it is consistent with \
                              noise."
        }
    }
}

/// A dependence that is significant, and too small to count as structure.
fn trace(d: &Dependence) -> Markup {
    html! {
        "A trace of structure is left: the residual depends on the " (d.covariate.words()) " (" (words::evidence(d))
        ")"
        @if let Some(size) = d.size {
            ", " (words::number(100.0 * size)) " % of the variance of a pixel’s noise"
        }
        ". That is significant, but too small to count as an effect."
    }
}

/// The significant tests at a family-wise level of 1 % (Bonferroni), strongest first.
pub fn significant(dependences: &[Dependence]) -> Vec<&Dependence> {
    let n = dependences.len() as f64;
    let mut strong: Vec<&Dependence> = dependences.iter().filter(|d| d.p * n < 0.01).collect();
    strong.sort_by(|a, b| words::strongest_first(a, b));
    strong
}
