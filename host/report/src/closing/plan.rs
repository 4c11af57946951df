//! The measurements that would separate what a session leaves open.

use super::super::page::Numbers;
use super::words;
use maud::{Markup, html};
use ommatidia_closing::{Closing, Goal};

/// The goals with what each measurement is expected to bring; nothing where no plan was asked for.
pub fn plan(c: &Closing, numbers: &mut Numbers) -> Markup {
    let Some(plan) = c.plan.as_ref().filter(|p| !p.goals.is_empty()) else { return html! {} };
    let name = |g: &Goal| match &g.other {
        Some(other) => format!("{} or {}", words::name(&g.id), words::name(other)),
        None => words::name(&g.id),
    };
    let rows = html! {
        thead { tr {
            th { "To separate, or to test" } th.n { "Strength" } th { "" } th.n { "Now" }
            @for (i, _) in plan.measurements.iter().enumerate() { th.n { "After " (i + 1) } }
        } }
        tbody { @for (g, goal) in plan.goals.iter().enumerate() { tr {
            td { (name(goal)) } td.n.soft { (words::number(goal.strength)) } td { (words::unit(&goal.unit)) }
            td.n { (words::sigma(goal.sigmas_now)) }
            @for m in &plan.measurements { td.n { (words::sigma(m.sigmas.get(g).copied().unwrap_or(0.0))) } }
        } } }
    };
    let text = "Expected standard deviations with each measurement and all before it.";
    html! {
        h3 { "Measure next" }
        @if plan.measurements.is_empty() {
            p { "No measurement of the catalogue brings what is open much nearer." }
        } @else {
            ol { @for m in &plan.measurements { li { (words::capital(&m.words)) "." } } }
        }
        (numbers.table("What to expect.", text, rows))
        ul.notes { @for a in &plan.assumptions { li { (words::capital(a)) "." } } }
    }
}
