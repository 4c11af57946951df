//! The page of a study, Markdown.

use super::intervals::Share;
use super::record::Outcome;
use super::sensitivity::Sensitivities;
use super::size::{Question, Size};
use super::summary::{ByStrength, Outside, Summary};
use std::collections::BTreeSet;
use std::fmt::Write;

/// What was planned.
#[derive(Clone, Copy, Debug)]
pub struct Plan {
    /// Number of sessions.
    pub planned: usize,
    /// Number of the sealed study, from 1; `None`: the seeds are those for development.
    pub opened: Option<usize>,
    /// Instruments that `calibrate` refuses, and that no session is of.
    pub refused: usize,
}

/// Renders the page.
pub fn page(size: &Size, plan: Plan, sensitivities: &[Sensitivities], all: &[Outcome], s: &Summary) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = head(&mut out, size, plan, s)
        .and_then(|()| nulls(&mut out, s))
        .and_then(|()| single(&mut out, s))
        .and_then(|()| kinds(&mut out, s))
        .and_then(|()| errors(&mut out, s))
        .and_then(|()| named(&mut out, s))
        .and_then(|()| pairs(&mut out, all, s))
        .and_then(|()| beyond(&mut out, all, s))
        .and_then(|()| parts(&mut out, all, s))
        .and_then(|()| records(&mut out, all, s))
        .and_then(|()| pictures(&mut out, all))
        .and_then(|()| sensitivity(&mut out, sensitivities));
    out
}

/// `12 of 40 (30 %, 18 to 45 %)`.
pub(super) fn share(s: Share) -> String {
    if s.n == 0 {
        return "-".into();
    }
    format!("{} of {} ({:.0} %, {:.0} to {:.0} %)", s.k, s.n, 100.0 * s.share(), 100.0 * s.low, 100.0 * s.high)
}

pub(super) fn brief(s: Share) -> String {
    if s.n == 0 { "-".into() } else { format!("{}/{} ({:.0} %)", s.k, s.n, 100.0 * s.share()) }
}

pub(super) fn number(v: Option<f64>) -> String {
    v.map_or_else(|| "-".into(), |v| format!("{v:.2}"))
}

/// Three significant digits, of numbers that span decades.
pub(super) fn digits(v: Option<f64>) -> String {
    v.map_or_else(|| "-".into(), |v| if v.abs() < 0.01 { format!("{v:.4}") } else { format!("{v:.3}") })
}

/// The first line of the page, which says of which seeds it is.
pub const TITLE: &str = "# How far the loop can be trusted";

fn head(out: &mut String, size: &Size, plan: Plan, s: &Summary) -> std::fmt::Result {
    let seeds = match plan.opened {
        None if size.gentle => {
            "This is a **check that the study works**, on gentle instruments; it measures nothing.".into()
        }
        opened => seeds(opened),
    };
    let of: Vec<String> = s.instruments.iter().map(|(kind, n)| format!("{} {n}", kind.name())).collect();
    writeln!(
        out,
        "{TITLE}\n\nWritten by `ommatidia study` from {} of {} planned sessions of virtual instruments. {seeds}\n\n\
         The instruments ({}) have 3 x 3 lenses on 98 x 98 pixels. The optics of the kinds share no code with each \
         other nor\nwith the low-rank model: diffraction at pupils, rays traced through relays, and PSFs that are \
         drawn at random or were\nmeasured. Places of lenses, aberrations, apertures, distortion, light and sensor \
         are drawn for each; every one is\ncalibrated once, from a session of its own (bead scan at three depths, \
         darks, flats). A session to close has 8 scenes of known\nobjects, 12 flats at three levels and two \
         exposures, and 8 darks at two exposures, where nothing else is said. Injected effects are\nnot declared \
         anywhere.\n\n\
         **1 sigma** of an effect is the sensitivity of such a session: the standard error that `close` reports for \
         the first strength of the\neffect when the effect is absent. It includes noise, scatter between blocks and \
         frames, and the calibration; for foreign effects,\nthe noise of the scenes alone. Where a strength would \
         leave the physical range of the effect (shifts of 7 px, turns of 2 degrees,\n5 % of size, blurs of 3 px, \
         light by a factor of 3), it ends there (capped). A name is **false** whenever it is not the truth, \
         whatever\nis said beside it. Shares have 95 % intervals: the wider of Wilson's and a bootstrap over \
         instruments.\n",
        s.sessions,
        plan.planned,
        of.join(", "),
    )?;
    writeln!(
        out,
        "Closing a session took {:.1} s (median; mean {:.1} s, longest {:.1} s) on one thread of a shared machine. {} \
            sessions failed.\n",
        s.seconds[0], s.seconds[1], s.seconds[2], s.failed
    )?;
    left_out(out, plan)?;
    writeln!(out, "Held-out figures (chi2 or NRMSE) are worse after than before in {} sessions.", s.worse.len())?;
    for key in &s.worse {
        writeln!(out, "- `{key}`")?;
    }
    writeln!(out)
}

/// Instruments that no session is of.
pub(super) fn left_out(out: &mut String, plan: Plan) -> std::fmt::Result {
    match plan.refused {
        0 => Ok(()),
        1 => writeln!(out, "Of the instruments that were drawn `calibrate` refused 1, which is left out.\n"),
        n => writeln!(out, "Of the instruments that were drawn `calibrate` refused {n}, which are left out.\n"),
    }
}

/// Which seeds a page is of.
pub(super) fn seeds(opened: Option<usize>) -> String {
    match opened {
        Some(n) => format!(
            "These are **sealed seeds of study number {n}**: each sealed study draws instruments and sessions of its \
             own, so no threshold was set on these."
        ),
        None => "These are **development seeds**: thresholds were set on them, so the figures flatter.".to_string(),
    }
}

fn nulls(out: &mut String, s: &Summary) -> std::fmt::Result {
    writeln!(out, "## Sessions without an effect\n")?;
    writeln!(out, "| sessions | an effect or a fault was found |\n|---|---|\n| all | {} |", share(s.null_found))?;
    for (holds, found) in &s.null_by {
        writeln!(out, "| {} | {} |", holds.words(), share(*found))?;
    }
    for (kind, found) in &s.null_by_kind {
        writeln!(out, "| {} | {} |", kind.name(), share(*found))?;
    }
    writeln!(out, "\nThe catalogue was called incomplete although nothing was found: {}.", share(s.null_incomplete))?;
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
    writeln!(
        out,
        "## One undeclared effect of the catalogue\n\n| sigma | chi2 / pixel of the effect | true effect first | a \
         false name | true and no other | false names a session | anything found |\n|---|---|---|---|---|---|---|"
    )?;
    for b in &s.single {
        let capped = if b.capped > 0 { format!(" ({} capped)", b.capped) } else { String::new() };
        writeln!(
            out,
            "| {}{capped} | {} | {} | {} | {} | {:.2} | {} |",
            b.sigmas,
            digits(b.excess),
            share(b.first),
            share(b.false_name),
            brief(b.true_alone),
            b.extra_names,
            brief(b.detected),
        )?;
    }
    writeln!(
        out,
        "\n| sigma | explained F (sessions) | F >= 0.9 | first, without a lookalike (rho < 0.7) | found or in the \
         ambiguity set | terms without a name a session |\n|---|---|---|---|---|---|"
    )?;
    for b in &s.single {
        writeln!(
            out,
            "| {} | {} ({}) | {} | {} | {} | {:.2} |",
            b.sigmas,
            number(b.explained),
            b.removed.n,
            share(b.removed),
            brief(b.first_where_alone),
            brief(b.covered),
            b.unnamed,
        )?;
    }
    writeln!(
        out,
        "\nF = (chi2 before - chi2 after) / (chi2 before - chi2 of the calibrated model with the injected effect, its \
            values fitted) on held-out\nscenes; median of the sessions whose excess is beyond five standard errors. No \
            effect explains the errors of the calibration itself.\n"
    )?;
    let worst: Vec<String> = {
        let mut of: Vec<(&String, &usize)> = s.false_names.iter().collect();
        of.sort_by(|a, b| b.1.cmp(a.1).then(a.0.cmp(b.0)));
        of.iter().map(|(id, n)| format!("`{id}` {n}")).collect()
    };
    if !worst.is_empty() {
        writeln!(out, "False names: {}.\n", worst.join(", "))?;
    }
    Ok(())
}

fn kinds(out: &mut String, s: &Summary) -> std::fmt::Result {
    writeln!(
        out,
        "### By kind of instruments\n\n| instruments | sigma | chi2 / pixel of the effect | true effect first | a \
         false name | explained F |\n\
|---|---|---|---|---|---|"
    )?;
    for (kind, of) in &s.single_by_kind {
        for b in of {
            let (first, wrong) = (brief(b.first), brief(b.false_name));
            let (excess, removed) = (digits(b.excess), number(b.explained));
            writeln!(out, "| {} | {} | {excess} | {first} | {wrong} | {removed} |", kind.name(), b.sigmas)?;
        }
    }
    writeln!(out)
}

/// Pulls and ranks.
fn errors(out: &mut String, s: &Summary) -> std::fmt::Result {
    writeln!(
        out,
        "### Quoted errors\n\nPulls, (value - truth) / sigma of the first strength, where the true effect was found \
         under its name, and the histogram of the truths'\nranks in what value and sigma say of them (even where the \
         errors are right; heavy ends: errors too small). p: chi2 test of evenness.\n\n\
         | sigma | pulls | mean | rms | robust rms | ranks from 0 to 1 | p |\n|---|---|---|---|---|---|---|"
    )?;
    for b in &s.single {
        writeln!(out, "{}", ranks(b))?;
    }
    writeln!(out)
}

/// A row of the table of pulls and ranks.
pub(super) fn ranks(b: &ByStrength) -> String {
    let counts: Vec<String> = b.ranks.counts.iter().map(usize::to_string).collect();
    let p = b.ranks.p.map_or_else(|| "-".into(), |p| format!("{p:.3}"));
    format!(
        "| {} | {} | {} | {} | {} | {} | {p} |",
        b.sigmas,
        b.pulls,
        number(b.pull_mean),
        number(b.pull_rms),
        number(b.pull_robust),
        counts.join(" "),
    )
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
pub(super) fn line(o: &Outcome) -> String {
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
    let wrong = o.false_names().len();
    let strength = o.case.injected.first().map_or(0.0, |i| i.sigmas);
    let (put, kind, removed) = (put.join(", "), o.kind.name(), number(o.held_out.explained()));
    format!("| {put} | {kind} | {strength} | {found} | {wrong} | {incomplete} | {removed} |")
}

/// Head of a table of sessions, one [`line`] each.
pub(super) const SESSIONS: &str = "| injected | instrument | sigma | found | false names | called incomplete | \
                                   explained F |\n|---|---|---|---|---|---|---|";

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
        "## Two effects at once\n\nBoth named (found or in an ambiguity set): {}; at least one: {}; a false name: {}.",
        share(s.pairs_both),
        share(s.pairs_one),
        share(s.pairs_false)
    )?;
    lines(out, all, Question::Pair)
}

fn outside(out: &mut String, title: &str, o: &Outside) -> std::fmt::Result {
    writeln!(
        out,
        "| {title} | {} | {} | {} | {} | {} |",
        share(o.false_naming),
        brief(o.noticed),
        brief(o.abstains),
        number(o.explained),
        brief(o.removed)
    )
}

fn beyond(out: &mut String, all: &[Outcome], s: &Summary) -> std::fmt::Result {
    writeln!(
        out,
        "## The true effect is not among the candidates\n\nEvery name is false here.\n\n\
         | | a false name | noticed | called incomplete | explained F | F >= 0.7 |\n|---|---|---|---|---|---|"
    )?;
    for (k, o) in &s.minus_one {
        outside(out, &format!("catalogue without the true effect, {k} sigma"), o)?;
    }
    for (k, o) in &s.foreign {
        outside(out, &format!("foreign effects, {k} sigma of the noise"), o)?;
    }
    for (like, o) in &s.foreign_like {
        outside(out, &format!("foreign effects, {like}"), o)?;
    }
    writeln!(out, "\n### Catalogue without the true effect")?;
    lines(out, all, Question::MinusOne)?;
    writeln!(out, "### Foreign effects")?;
    lines(out, all, Question::Foreign)
}

/// Sessions that hold less, or whose truths are misplaced.
fn parts(out: &mut String, all: &[Outcome], s: &Summary) -> std::fmt::Result {
    writeln!(
        out,
        "## Sessions of other kinds\n\nWith one effect of 30 or 300 sigma (of a whole session) or none; misplaced \
         truths have none, so that every name is false.\nWhat a session cannot show cannot be named: the share of \
         true names is of all sessions with an effect.\n\n\
         | the session | true effect named | a false name |\n|---|---|---|"
    )?;
    for (holds, named, wrong) in &s.holds {
        writeln!(out, "| {} | {} | {} |", holds.words(), share(*named), share(*wrong))?;
    }
    lines(out, all, Question::Parts)?;
    lines(out, all, Question::Registration)
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
        "## Sensitivity of a session\n\n| effect | strength | 1 sigma: median of the instruments (smallest to largest) \
            | unit (empty: relative) |\n|---|---|---|---|"
    )?;
    let ids: BTreeSet<&String> = all.iter().flat_map(|s| s.of.keys()).collect();
    for id in ids {
        let of: Vec<_> = all.iter().filter_map(|s| s.of.get(id)).collect();
        let mut sigmas: Vec<f64> = of.iter().map(|s| s.sigma).collect();
        sigmas.sort_by(f64::total_cmp);
        let (low, middle, high) = (sigmas.first(), sigmas.get(sigmas.len() / 2), sigmas.last());
        let [low, middle, high] = [low, middle, high].map(|v| v.copied().unwrap_or(f64::NAN));
        let (param, unit) = of.first().map_or(("", ""), |s| (s.param.as_str(), s.unit.as_str()));
        let unit = if unit == "1" { "" } else { unit };
        writeln!(out, "| `{id}` | {param} | {middle:.2e} ({low:.2e} to {high:.2e}) | {unit} |")?;
    }
    let cannot: BTreeSet<&str> = all.iter().flat_map(|s| s.cannot.iter().map(String::as_str)).collect();
    if !cannot.is_empty() {
        let list: Vec<String> = cannot.iter().map(|c| format!("`{c}`")).collect();
        writeln!(out, "\nSuch a session cannot determine, and the figures do not include: {}.", list.join(", "))?;
    }
    Ok(())
}
