//! Effects that were not found: their upper limits, or the measurement that would make them testable.

use super::super::page::Numbers;
use super::words;
use crate::closing::{Closing, Rejected};
use maud::{Markup, html};
use std::collections::BTreeMap;

/// Longer lists are folded.
const SHORT: usize = 6;

/// The two lists: effects with upper limits, and effects that are not testable.
pub fn limits(c: &Closing, numbers: &mut Numbers) -> Markup {
    let mut limited: Vec<(&Rejected, f64)> = c.rejected.iter().filter_map(|r| Some((r, r.upper_limit?))).collect();
    limited.sort_by(|a, b| b.0.z.abs().total_cmp(&a.0.z.abs()));
    let untestable: Vec<&Rejected> = c.rejected.iter().filter(|r| r.upper_limit.is_none()).collect();
    let summaries = [
        format!("{} effects were tested and not found", limited.len()),
        format!("{} effects are not testable with this session", untestable.len()),
    ];
    html! {
        @if !limited.is_empty() { (folded(limited.len(), &summaries[0], found(&limited, numbers))) }
        @if !untestable.is_empty() { (folded(untestable.len(), &summaries[1], not_testable(&untestable))) }
    }
}

fn folded(n: usize, summary: &str, body: Markup) -> Markup {
    html! { details open[n <= SHORT] { summary { b { (summary) } } (body) } }
}

fn found(limited: &[(&Rejected, f64)], numbers: &mut Numbers) -> Markup {
    let rows = html! {
        thead { tr {
            th { "Effect" } th { "Strength" } th.n { "Upper limit" small { "95 % confidence" } } th { "" }
            th.n { "Sensitivity" small { "standard error" } } th.n { "Evidence" }
        } }
        tbody { @for (r, limit) in limited { tr {
            td { (words::name(&r.id)) } td.soft { (words::name(&r.param)) }
            td.n { (words::number(*limit)) } td { (words::unit(&r.unit)) }
            td.n.soft { (r.sigma.map_or("–".into(), words::number)) } td.n { (words::sigma(r.z)) }
        } } }
    };
    let text = "Upper limits on the absolute value of each strength, with the added effects in the model. An effect \
                below its limit may be present.";
    numbers.table("Not found.", text, rows)
}

/// Effects that are not testable, grouped by the measurement that would make them so.
fn not_testable(rejected: &[&Rejected]) -> Markup {
    let mut groups: BTreeMap<&str, Vec<String>> = BTreeMap::new();
    for r in rejected {
        groups.entry(r.needs.as_deref().unwrap_or("other data")).or_default().push(words::name(&r.id));
    }
    html! {
        p { "Their signatures in these data are too similar to others, or too small for every plausible value. These \
             effects are neither detected nor excluded:" }
        ul { @for (needs, ids) in &groups {
            li { b { (words::capital(needs)) } " would make testable: " (ids.join(", ")) "." }
        } }
    }
}
