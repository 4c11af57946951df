//! What was not found: how small it must be, or what it would take to tell.

use super::super::page::Numbers;
use super::words;
use crate::closing::{Closing, Rejected};
use maud::{Markup, html};
use std::collections::BTreeMap;

/// Longer lists are folded.
const SHORT: usize = 6;

/// The two lists.
pub fn limits(c: &Closing, numbers: &mut Numbers) -> Markup {
    let mut told: Vec<(&Rejected, f64)> = c.rejected.iter().filter_map(|r| Some((r, r.upper_limit?))).collect();
    told.sort_by(|a, b| b.0.z.abs().total_cmp(&a.0.z.abs()));
    let blind: Vec<&Rejected> = c.rejected.iter().filter(|r| r.upper_limit.is_none()).collect();
    html! {
        @if !told.is_empty() { (folded(told.len(), &format!("{} effects were looked for and not found", told.len()), found(&told, numbers))) }
        @if !blind.is_empty() { (folded(blind.len(), &format!("{} effects this session cannot tell", blind.len()), unseen(&blind))) }
    }
}

fn folded(n: usize, summary: &str, body: Markup) -> Markup {
    html! { details open[n <= SHORT] { summary { b { (summary) } } (body) } }
}

fn found(told: &[(&Rejected, f64)], numbers: &mut Numbers) -> Markup {
    let rows = html! {
        thead { tr { th { "Effect" } th { "Strength" } th.n { "is below" small { "95 % confidence" } } th { "" } th.n { "Sensitivity" small { "standard error" } } th.n { "Evidence" } } }
        tbody { @for (r, limit) in told { tr {
            td { (words::name(&r.id)) } td.soft { (words::name(&r.param)) }
            td.n { (words::number(*limit)) } td { (words::unit(&r.unit)) }
            td.n.soft { (r.sigma.map_or("–".into(), words::number)) } td.n { (words::sigma(r.z)) }
        } } }
    };
    let text = "Upper limits on the size of each strength, whatever its sign, beside all that was added. Nothing found means nothing \
                without them.";
    numbers.table("Not found.", text, rows)
}

/// Grouped by what they need: that is what to measure next.
fn unseen(blind: &[&Rejected]) -> Markup {
    let mut groups: BTreeMap<&str, Vec<String>> = BTreeMap::new();
    for r in blind {
        groups.entry(r.needs.as_deref().unwrap_or("other data")).or_default().push(words::name(&r.id));
    }
    html! {
        p { "Their marks in these data are too like something else, or too small to matter to any value that makes sense. Neither found nor \
             ruled out:" }
        ul { @for (needs, ids) in &groups { li { b { (words::capital(needs)) } " would tell: " (ids.join(", ")) "." } } }
    }
}
