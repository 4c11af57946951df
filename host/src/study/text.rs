//! The page of a study, Markdown.

use super::plan::{Question, Size};
use super::record::Outcome;
use super::sensitivity::Sensitivities;
use super::summary::{ByStrength, Outside, Share, Summary};
use std::collections::BTreeSet;
use std::fmt::Write;

/// Renders the page.
pub fn page(size: &Size, planned: usize, sensitivities: &[Sensitivities], all: &[Outcome], s: &Summary) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = head(&mut out, size, planned, s)
        .and_then(|()| nulls(&mut out, s))
        .and_then(|()| single(&mut out, s))
        .and_then(|()| named(&mut out, s))
        .and_then(|()| pairs(&mut out, all, s))
        .and_then(|()| beyond(&mut out, all, s))
        .and_then(|()| records(&mut out, all, s))
        .and_then(|()| pictures(&mut out, all))
        .and_then(|()| sensitivity(&mut out, sensitivities));
    out
}

/// `12 of 40 (30 %, 18 to 45 %)`.
fn share(s: Share) -> String {
    if s.n == 0 {
        return "-".into();
    }
    format!("{} of {} ({:.0} %, {:.0} to {:.0} %)", s.k, s.n, 100.0 * s.share(), 100.0 * s.low, 100.0 * s.high)
}

fn brief(s: Share) -> String {
    if s.n == 0 { "-".into() } else { format!("{}/{} ({:.0} %)", s.k, s.n, 100.0 * s.share()) }
}

fn number(v: Option<f64>) -> String {
    v.map_or_else(|| "-".into(), |v| format!("{v:.2}"))
}

fn head(out: &mut String, size: &Size, planned: usize, s: &Summary) -> std::fmt::Result {
    writeln!(
        out,
        "# How far the loop can be trusted\n\n\
         Written by `ommatidia study` from {} of {planned} planned sessions of the virtual instrument. There are {} \
         instruments of 3 x 3 lenses on\n\
         98 x 98 pixels, each calibrated once from a session of its own (bead scan at three depths, darks, flats). \
         Sessions without an effect\n\
         use them in turn; each round of the other sessions uses one. A session to close has 8 scenes of known \
         objects, 12 flats at three\n\
         levels and two exposures, and 8 darks at two exposures. The bench computes its frames by physical optics, \
         without the low-rank\n\
         model. Injected effects are not declared anywhere.\n\n\
         **1 sigma** of an effect is the sensitivity of such a session: the standard error that `close` reports for \
         the first strength of the\n\
         effect when the effect is absent. It includes noise, scatter between blocks and frames, and the calibration; \
         for foreign effects, the\n\
         noise of the scenes alone. Shares have 95 % intervals (Wilson).\n",
        s.sessions, size.instruments
    )?;
    writeln!(
        out,
        "Closing a session took {:.1} s (median; mean {:.1} s, longest {:.1} s) on one thread of a shared machine. {} \
            sessions failed.\n",
        s.seconds[0], s.seconds[1], s.seconds[2], s.failed
    )
}

fn nulls(out: &mut String, s: &Summary) -> std::fmt::Result {
    writeln!(out, "## Sessions without an effect\n")?;
    writeln!(out, "An effect or a fault was found in {} sessions.", share(s.null_found))?;
    writeln!(out, "The catalogue was called incomplete although nothing was found: {}.", share(s.null_incomplete))?;
    let named: Vec<String> = s.null_named.iter().map(|(id, n)| format!("`{id}` {n}")).collect();
    if !named.is_empty() {
        writeln!(out, "Found: {}.", named.join(", "))?;
    }
    writeln!(
        out,
        "chi-squared per pixel on held-out scenes: {:.4} with the calibrated model, {:.4} with the bench's noise-free \
            frames.\n",
        s.null_chi2[0], s.null_chi2[1]
    )
}

fn single(out: &mut String, s: &Summary) -> std::fmt::Result {
    writeln!(out, "## One undeclared effect of the catalogue\n")?;
    writeln!(
        out,
        "| sigma | anything found | true effect first | of those without a lookalike (rho < 0.7) | found or in the \
            ambiguity set | \
         another effect first | explained F (sessions) |\n|---|---|---|---|---|---|---|"
    )?;
    for b in &s.single {
        writeln!(
            out,
            "| {} | {} | {} | {} | {} | {} | {} ({}) |",
            b.sigmas,
            brief(b.detected),
            share(b.first),
            brief(b.first_where_alone),
            share(b.covered),
            brief(b.other_first),
            number(b.explained),
            b.with_excess
        )?;
    }
    writeln!(
        out,
        "\nF = (chi2 before - chi2 after) / (chi2 before - chi2 of the calibrated model with the injected effect, its \
            values fitted) on held-out\n\
         scenes; median of the sessions whose excess is beyond five standard errors. No effect explains the errors of \
         the calibration itself.\n\n\
         Pulls, (value - truth) / sigma of the first strength, where the true effect was found under its name:\n\n\
         | sigma | pulls | mean | rms | robust rms |\n|---|---|---|---|---|"
    )?;
    let pull = |b: &ByStrength| {
        format!(
            "| {} | {} | {} | {} | {} |",
            b.sigmas,
            b.pulls,
            number(b.pull_mean),
            number(b.pull_rms),
            number(b.pull_robust)
        )
    };
    for b in &s.single {
        writeln!(out, "{}", pull(b))?;
    }
    writeln!(out)
}

/// The confusion matrix, without its zeros.
fn named(out: &mut String, s: &Summary) -> std::fmt::Result {
    let strengths: Vec<String> = s.single.iter().map(|b| b.sigmas.to_string()).collect();
    let truths: BTreeSet<&str> = s.confusion.iter().map(|c| c.truth.as_str()).collect();
    if truths.is_empty() {
        return Ok(());
    }
    writeln!(
        out,
        "### What was found first\n\nA dot: nothing was found. In brackets: the largest squared correlation that \
            `close` reported between the found effect \
         and a lookalike.\n`*`: the true effect was in the ambiguity set or was found later.\n\n| true effect | {} \
         |\n|---|{}",
        strengths.iter().map(|k| format!("{k} sigma")).collect::<Vec<_>>().join(" | "),
        "---|".repeat(strengths.len())
    )?;
    for truth in truths {
        let cell = |k: &String| {
            let mut found: Vec<String> = Vec::new();
            for c in s.confusion.iter().filter(|c| c.truth == truth) {
                let Some(n) = c.sessions.get(k) else { continue };
                let times = if *n > 1 { format!("{n} x ") } else { String::new() };
                found.push(match c.found.as_str() {
                    "nothing" => format!("{times}."),
                    id if id == truth => format!("{times}**right**"),
                    id => {
                        let mark = if c.covered > 0 { "*" } else { "" };
                        format!("{times}`{id}`{mark} ({:.2})", c.overlap)
                    }
                });
            }
            found.join(", ")
        };
        writeln!(out, "| `{truth}` | {} |", strengths.iter().map(cell).collect::<Vec<_>>().join(" | "))?;
    }
    writeln!(out)
}

/// The injected and the found effects of one session.
fn line(o: &Outcome) -> String {
    let put: Vec<String> =
        o.case.injected.iter().map(|i| format!("`{}` {} = {:.3e}", i.id, i.param, i.value)).collect();
    let found: Vec<String> = o
        .found
        .iter()
        .map(|f| {
            let could =
                if f.ambiguity.is_empty() { String::new() } else { format!(" (or {})", f.ambiguity.join(", ")) };
            format!("`{}`{could}", f.id)
        })
        .collect();
    let found = if found.is_empty() { ".".into() } else { found.join("; ") };
    let incomplete = if o.incomplete { "yes" } else { "no" };
    let strength = o.case.injected.first().map_or(0.0, |i| i.sigmas);
    format!("| {} | {strength} | {found} | {incomplete} | {} |", put.join(", "), number(o.held_out.explained()))
}

const SESSIONS: &str = "| injected | sigma | found | called incomplete | explained F |\n|---|---|---|---|---|";

fn lines(out: &mut String, all: &[Outcome], question: Question) -> std::fmt::Result {
    let mut of: Vec<&Outcome> = all.iter().filter(|o| o.case.question == question && o.error.is_none()).collect();
    of.sort_by(|a, b| a.case.key.cmp(&b.case.key));
    if of.is_empty() {
        return writeln!(out);
    }
    writeln!(out, "\n{SESSIONS}")?;
    for o in of {
        writeln!(out, "{}", line(o))?;
    }
    writeln!(out)
}

fn pairs(out: &mut String, all: &[Outcome], s: &Summary) -> std::fmt::Result {
    writeln!(
        out,
        "## Two effects at once\n\nBoth named (found or in an ambiguity set): {}; at least one: {}.",
        share(s.pairs_both),
        share(s.pairs_one)
    )?;
    lines(out, all, Question::Pair)
}

fn outside(out: &mut String, title: &str, o: &Outside) -> std::fmt::Result {
    writeln!(
        out,
        "| {title} | {} | {} | {} | {} |",
        share(o.noticed),
        share(o.abstains),
        share(o.false_naming),
        number(o.explained)
    )
}

fn beyond(out: &mut String, all: &[Outcome], s: &Summary) -> std::fmt::Result {
    writeln!(
        out,
        "## The true effect is not among the candidates\n\n\
         False naming: `close` names an effect of the catalogue and does not report that the catalogue is \
         incomplete.\n\n\
         | | noticed | called incomplete | false naming | explained F |\n|---|---|---|---|---|"
    )?;
    outside(out, "catalogue without the true effect, 30 sigma", &s.minus_one)?;
    for (k, o) in &s.foreign {
        outside(out, &format!("foreign effects, {k} sigma of the noise"), o)?;
    }
    writeln!(out, "\n### Catalogue without the true effect")?;
    lines(out, all, Question::MinusOne)?;
    writeln!(out, "### Foreign effects")?;
    lines(out, all, Question::Foreign)
}

fn records(out: &mut String, all: &[Outcome], s: &Summary) -> std::fmt::Result {
    writeln!(
        out,
        "## Wrong records\n\nA gain that the calibration states 5 % too high is traced to the gain in {}.\n\
         Faults of the records (truths exchanged, upside down, mirrored left to right, exposure 1.25 times the \
         recorded one) are found\n\
         in the right frame in {}.",
        share(s.gain),
        share(s.records)
    )?;
    lines(out, all, Question::Gain)?;
    lines(out, all, Question::Records)
}

/// PSNR of fine-tuned networks.
fn pictures(out: &mut String, all: &[Outcome]) -> std::fmt::Result {
    let mut of: Vec<&Outcome> = all.iter().filter(|o| o.reconstruction.is_some()).collect();
    of.sort_by(|a, b| a.case.key.cmp(&b.case.key));
    if of.is_empty() {
        return Ok(());
    }
    writeln!(
        out,
        "## Effect on reconstructions\n\nPSNR, dB, of the smallest network on eight scenes of another session: \
            trained on the calibrated instrument, then \
         fine-tuned on\nthe closed instrument and on the true one (the calibrated one with the injected effect), with \
         the same steps on the same scenes.\n\n\
         | injected | sigma | found | before | closed | true | closed - true |\n|---|---|---|---|---|---|---|"
    )?;
    for o in of {
        let (Some(r), Some(it)) = (o.reconstruction, o.case.injected.first()) else { continue };
        let found: Vec<String> = o.found.iter().map(|f| format!("`{}`", f.id)).collect();
        writeln!(
            out,
            "| `{}` {} = {:.3e} | {} | {} | {:.2} | {:.2} | {:.2} | {:+.2} |",
            it.id,
            it.param,
            it.value,
            it.sigmas,
            found.join(", "),
            r.before_db,
            r.closed_db,
            r.truth_db,
            r.closed_db - r.truth_db
        )?;
    }
    writeln!(out)
}

fn sensitivity(out: &mut String, all: &[Sensitivities]) -> std::fmt::Result {
    writeln!(
        out,
        "## Sensitivity of a session\n\n| effect | strength | 1 sigma, each instrument | unit (empty: relative) \
            |\n|---|---|---|---|"
    )?;
    let ids: BTreeSet<&String> = all.iter().flat_map(|s| s.of.keys()).collect();
    for id in ids {
        let of: Vec<_> = all.iter().filter_map(|s| s.of.get(id)).collect();
        let sigmas: Vec<String> = of.iter().map(|s| format!("{:.2e}", s.sigma)).collect();
        let (param, unit) = of.first().map_or(("", ""), |s| (s.param.as_str(), s.unit.as_str()));
        let unit = if unit == "1" { "" } else { unit };
        writeln!(out, "| `{id}` | {param} | {} | {unit} |", sigmas.join(", "))?;
    }
    let cannot: BTreeSet<&str> = all.iter().flat_map(|s| s.cannot.iter().map(String::as_str)).collect();
    if !cannot.is_empty() {
        let list: Vec<String> = cannot.iter().map(|c| format!("`{c}`")).collect();
        writeln!(out, "\nSuch a session cannot determine, and the figures do not include: {}.", list.join(", "))?;
    }
    Ok(())
}
