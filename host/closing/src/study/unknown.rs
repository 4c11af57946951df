//! The page of a study of sessions whose specimens nobody knows, Markdown.

use super::intervals::Share;
use super::record::Outcome;
use super::sensitivity::{Sensitivities, Sensitivity};
use super::sessions::Holds;
use super::size::Question;
use super::summary::{ByStrength, Summary, by_strengths};
use super::text::{Plan, SESSIONS, brief, digits, left_out, line, number, ranks, seeds, share};
use std::collections::BTreeSet;
use std::fmt::Write;

/// The first line of the page.
pub const TITLE: &str = "# How far the loop can be trusted with unknown specimens";

/// Renders the page.
pub fn page(plan: Plan, sensitivities: &[Sensitivities], all: &[Outcome], s: &Summary) -> String {
    let mut out = String::new();
    let good: Vec<&Outcome> = all.iter().filter(|o| o.error.is_none()).collect();
    // Writing to a string cannot fail.
    let _ = head(&mut out, plan, s)
        .and_then(|()| nothing(&mut out, &good))
        .and_then(|()| single(&mut out, &good))
        .and_then(|()| truths(&mut out, &good))
        .and_then(|()| gauges(&mut out, &good))
        .and_then(|()| sensitivity(&mut out, sensitivities))
        .and_then(|()| sessions(&mut out, &good));
    out
}

fn head(out: &mut String, plan: Plan, s: &Summary) -> std::fmt::Result {
    let of: Vec<String> = s.instruments.iter().map(|(kind, n)| format!("{} {n}", kind.name())).collect();
    writeln!(
        out,
        "{TITLE}\n\nWritten by `ommatidia study --unknown` from {} of {} planned sessions of virtual instruments. \
         {}\n\n\
         The instruments ({}) are drawn as for [study.md](study.md), with other seeds: 3 x 3 lenses on 98 x 98 pixels, \
         calibrated once\neach from a session of beads, darks and flats. A session to close has 1, 8 or 100 scenes, 12 \
         flats and 8 darks. `close` gets the frames\nand not the truths; afterwards the truths judge the closed \
         instrument.\n\n\
         **1 sigma** of an effect is its standard error in such a session where the effect is absent, with everything \
         projected out that\nanother specimen could make. Strengths end at the physical range of the effect (capped). \
         A name is **false** whenever it is not the\ntruth, whatever is said beside it. Shares have 95 % intervals: \
         the wider of Wilson's and a bootstrap over instruments.\n",
        s.sessions,
        plan.planned,
        seeds(plan.opened),
        of.join(", "),
    )?;
    writeln!(
        out,
        "Closing a session took {:.1} s (median; mean {:.1} s, longest {:.1} s) on one thread of a shared machine. {} \
         sessions failed.\n",
        s.seconds[0], s.seconds[1], s.seconds[2], s.failed
    )?;
    left_out(out, plan)
}

/// The outcomes of one kind of sessions.
fn of_kind<'a>(all: &[&'a Outcome], question: Question, holds: Holds) -> Vec<&'a Outcome> {
    all.iter().copied().filter(|o| o.case.question == question && o.case.holds == holds).collect()
}

fn nothing(out: &mut String, all: &[&Outcome]) -> std::fmt::Result {
    writeln!(
        out,
        "## Sessions without an effect\n\n| scenes | an effect or a fault was found | called incomplete, nothing \
         found | found |\n|---|---|---|---|"
    )?;
    for holds in Holds::UNKNOWN {
        let mut of = of_kind(all, Question::Unknown, holds);
        of.retain(|o| o.case.injected.is_empty());
        let found: Vec<String> = of.iter().flat_map(|o| &o.found).map(|f| format!("`{}`", f.id)).collect();
        let any = Share::of(of.iter().copied(), Outcome::detected);
        let incomplete = Share::of(of.iter().copied(), |o| !o.detected() && o.incomplete);
        writeln!(out, "| {} | {} | {} | {} |", scenes(holds), share(any), brief(incomplete), found.join(", "))?;
    }
    writeln!(out)
}

fn scenes(holds: Holds) -> &'static str {
    match holds {
        Holds::OneUnknown => "1",
        Holds::ManyUnknown => "100",
        _ => "8",
    }
}

fn with_effect<'a>(all: &[&'a Outcome], holds: Holds) -> Vec<&'a Outcome> {
    let mut of = of_kind(all, Question::Unknown, holds);
    of.retain(|o| !o.case.injected.is_empty());
    of
}

fn single(out: &mut String, all: &[&Outcome]) -> std::fmt::Result {
    writeln!(
        out,
        "## One undeclared effect of the catalogue\n\n| scenes | sigma | true effect first | a false name | true and \
         no other | anything found |\n|---|---|---|---|---|---|"
    )?;
    let by = |holds| by_strengths(&with_effect(all, holds));
    let capped = |b: &ByStrength| if b.capped > 0 { format!(" ({} capped)", b.capped) } else { String::new() };
    for (holds, b) in Holds::UNKNOWN.into_iter().flat_map(|h| by(h).into_iter().map(move |b| (h, b))) {
        let (first, wrong, alone, any) = (share(b.first), share(b.false_name), brief(b.true_alone), brief(b.detected));
        let sigmas = format!("{}{}", b.sigmas, capped(&b));
        writeln!(out, "| {} | {sigmas} | {first} | {wrong} | {alone} | {any} |", scenes(holds))?;
    }
    writeln!(
        out,
        "\n### Quoted errors\n\nPulls, (value - truth) / sigma of the first strength, where the true effect was \
         found, and the truths' ranks (see [study.md](study.md)).\n\n| sigma | pulls | mean | rms | robust rms | \
         ranks from 0 to 1 | p |\n|---|---|---|---|---|---|---|"
    )?;
    let together: Vec<&Outcome> = Holds::UNKNOWN.into_iter().flat_map(|h| with_effect(all, h)).collect();
    for b in by_strengths(&together) {
        writeln!(out, "{}", ranks(&b))?;
    }
    writeln!(out)
}

/// What the withheld truths say of the closed instruments.
fn truths(out: &mut String, all: &[&Outcome]) -> std::fmt::Result {
    writeln!(
        out,
        "## Judged by the withheld truths\n\nchi-squared per pixel of held-out scenes of known objects, which `close` \
         has not seen: by how much an effect raises it, which share\nF of that the closed instrument removes, and how \
         often the closed instrument is worse than the calibrated one.\n\n| scenes | sigma | excess, median | F, \
         median | F >= 0.9 | worse with the truths | worse by its own figures |\n|---|---|---|---|---|---|---|"
    )?;
    for holds in Holds::UNKNOWN {
        let of = with_effect(all, holds);
        for b in by_strengths(&of) {
            let at: Vec<&Outcome> =
                of.iter().copied().filter(|o| o.case.injected.iter().any(|i| i.sigmas == b.sigmas)).collect();
            let worse = Share::of(at.iter().copied(), |o| o.held_out.is_worse_with_truths());
            let (excess, removed, most) = (digits(b.excess), number(b.explained), brief(b.removed));
            let (k, own) = (b.sigmas, b.worse);
            let n = scenes(holds);
            writeln!(out, "| {n} | {k} | {excess} | {removed} | {most} | {} | {own} |", brief(worse))?;
        }
    }
    let worse: Vec<String> = all
        .iter()
        .filter(|o| o.held_out.is_worse_with_truths())
        .map(|o| format!("`{}` {:.4} -> {:.4}", o.case.key, o.held_out.before, o.held_out.after))
        .collect();
    if !worse.is_empty() {
        writeln!(out, "\nWorse with the truths: {}.", worse.join(", "))?;
    }
    writeln!(out)
}

fn gauges(out: &mut String, all: &[&Outcome]) -> std::fmt::Result {
    let of: Vec<&Outcome> = all.iter().copied().filter(|o| o.case.question == Question::Gauge).collect();
    let named = Share::of(of.iter().copied(), |o| o.found.iter().any(|f| o.case.injected.iter().any(|i| i.id == f.id)));
    let wrong = Share::of(of.iter().copied(), Outcome::names_falsely);
    writeln!(
        out,
        "## What another specimen could make\n\nEffects that such a session calls not testable, injected at 100 sigma \
         of a session with known objects: named {}, a false name {}.\n",
        share(named),
        share(wrong)
    )
}

/// What is lost by not knowing the specimens.
fn sensitivity(out: &mut String, all: &[Sensitivities]) -> std::fmt::Result {
    writeln!(
        out,
        "## Sensitivity\n\nStandard error of the first strength where the effect is absent, medians of the \
         instruments: with 8 known objects, and with unknown ones.\n\n| effect | strength | unit | 8 known | 1 \
         unknown | 8 unknown | 100 unknown |\n|---|---|---|---|---|---|---|"
    )?;
    let ids: BTreeSet<&String> = all.iter().flat_map(|s| s.of.keys().chain(&s.cannot)).collect();
    let kinds = [Holds::OneUnknown, Holds::Unknown, Holds::ManyUnknown];
    for id in ids {
        let known: Vec<&Sensitivity> = all.iter().filter_map(|s| s.of.get(id)).collect();
        let of = |holds: Holds| all.iter().filter_map(move |s| s.of_kinds.get(&holds)?.of.get(id)).collect::<Vec<_>>();
        let Some(any) = known.first().copied().or_else(|| kinds.iter().find_map(|h| of(*h).first().copied())) else {
            continue;
        };
        let median = |of: Vec<&Sensitivity>| {
            let mut sigmas: Vec<f64> = of.iter().map(|s| s.sigma).collect();
            sigmas.sort_by(f64::total_cmp);
            let testable = sigmas.len();
            match sigmas.get(testable / 2) {
                None => "not testable".to_string(),
                Some(v) if testable < all.len() => format!("{v:.1e} ({testable} of {})", all.len()),
                Some(v) => format!("{v:.1e}"),
            }
        };
        let unit = if any.unit == "1" { "" } else { any.unit.as_str() };
        let [one, eight, many] = kinds.map(|h| median(of(h)));
        writeln!(out, "| `{id}` | {} | {unit} | {} | {one} | {eight} | {many} |", any.param, median(known))?;
    }
    writeln!(out)
}

fn sessions(out: &mut String, all: &[&Outcome]) -> std::fmt::Result {
    writeln!(out, "## All sessions\n\n{SESSIONS}")?;
    let mut of = all.to_vec();
    of.sort_by(|a, b| a.case.key.cmp(&b.case.key));
    of.iter().try_for_each(|o| writeln!(out, "{}", line(o)))
}
