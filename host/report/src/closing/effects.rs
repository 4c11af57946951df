//! The table of added effects, and charts of effects with many values.

use super::super::page::Numbers;
use super::super::panel::{Panel, Series};
use super::super::picture::number;
use super::{story, words};
use maud::{Markup, html};
use ommatidia_closing::{Closing, Effect, Value};
use ommatidia_model::instrument::Instrument;
use ommatidia_physics::effects::{COVARIATES, KNOTS, find};

/// Values in a cell before the others are folded.
const FEW: usize = 4;

/// The table of effects, and a figure for each with many values. Empty if no effect was added.
pub fn table(c: &Closing, instrument: Option<&Instrument>, numbers: &mut Numbers) -> Markup {
    let effects: Vec<&Effect> = story::added(c).collect();
    if effects.is_empty() {
        return html! {};
    }
    let rows = html! {
        thead { tr {
            th { "Effect" } th { "Stage" } th.n { "Evidence" } th { "Share of the excess" }
            th { "Values" small { "± standard error" } }
            th { "Could also be" small { "how to distinguish them" } }
        } }
        tbody { @for e in &effects {
            tr.head {
                td.nowrap { b { (words::name(&e.id)) } }
                td { (e.stage) } td.n { (words::sigma(e.z)) } td { (share(e.excess_explained)) }
                td { (values(e)) } td { (lookalikes(e)) }
            }
            tr.words { td colspan="6" { (what(e)) } }
        } }
    };
    let text = "In the order in which they were added. Evidence: score test with the nuisance parameters (light of \
                each scene, black level) projected out; its error includes the scatter between blocks and frames and \
                the uncertainty of the calibration. Share: of the excess of χ² over the noise on held-out data. Could \
                also be: effects that would explain the data nearly as well (within Δχ² of 10.8), with the squared \
                correlation of the two signatures.";
    let charts: Vec<Markup> = effects.iter().flat_map(|e| charts(e, instrument, numbers)).collect();
    html! {
        div.effects { (numbers.table("Effects found.", text, rows)) }
        @if !charts.is_empty() { div.two { @for c in charts { (c) } } }
    }
}

/// What an effect does: from the catalogue, or from the account for a term without a name.
fn what(e: &Effect) -> &str {
    if e.known {
        find(&e.id).map_or(e.description.as_str(), |known| known.descriptor().summary)
    } else {
        &e.description
    }
}

fn share(share: Option<f64>) -> Markup {
    match share {
        None => html! { span.soft { "not significant" } },
        Some(f) => html! {
            span.share title=(format!("{:.1} %", 100.0 * f)) { i style={ "width:" (format!("{:.1}%", 100.0 * f)) } {} }
            (format!("{:.0} %", 100.0 * f))
        },
    }
}

fn lookalikes(e: &Effect) -> Markup {
    let names: Vec<String> = e.ambiguity.iter().map(|id| words::name(id)).collect();
    html! {
        @if names.is_empty() { span.soft { "no other effect of the catalogue" } }
        @else {
            @if e.overlap < words::ALIKE { span.soft { "explains as much, with another signature: " } }
            (words::list(&names, "or")) span.soft { " (" (format!("{:.2}", e.overlap)) ")" }
            @if let Some(by) = &e.separate_by { div.soft { (words::capital(by)) } }
        }
    }
}

/// The values of an effect in a cell: fitted values with errors, then fixed ones.
fn values(e: &Effect) -> Markup {
    let list = |values: &[&Value]| html! { @for v in values { div { (value(v)) } } };
    let shown: Vec<&Value> = e.params.iter().filter(|v| v.sigma > 0.0).collect();
    // The seed of a table is no property of the effect.
    let chosen: Vec<&Value> = e.params.iter().filter(|v| v.sigma <= 0.0 && v.name != "seed").collect();
    html! {
        @if shown.len() <= FEW {
            (list(&shown))
            @if !chosen.is_empty() && shown.len() + chosen.len() <= FEW { span.soft { (list(&chosen)) } }
        } @else {
            details.inline {
                summary { (e.params.len()) " values, plotted below" }
                (list(&e.params.iter().collect::<Vec<_>>()))
            }
        }
    }
}

fn value(v: &Value) -> Markup {
    let unit = words::unit(&v.unit);
    html! {
        span.soft { (words::param(&v.name)) " = " }
        span.nowrap { (words::plus_minus(v.value, v.sigma)) @if !unit.is_empty() { " " (unit) } }
    }
}

/// Charts of numbered values: one per lens, or the knots of a curve.
fn charts(e: &Effect, instrument: Option<&Instrument>, numbers: &mut Numbers) -> Vec<Markup> {
    if let Some(chart) = profile(e, numbers) {
        return vec![chart];
    }
    let mut groups: Vec<(&str, Vec<&Value>)> = Vec::new();
    for v in &e.params {
        let Some((name, index)) = v.name.rsplit_once('_') else { continue };
        if index.parse::<usize>().is_err() {
            continue;
        }
        match groups.iter_mut().find(|g| g.0 == name) {
            Some(group) => group.1.push(v),
            None => groups.push((name, vec![v])),
        }
    }
    groups.into_iter().filter(|(_, v)| v.len() > FEW).map(|(name, v)| row(e, name, &v, instrument, numbers)).collect()
}

fn row(e: &Effect, name: &str, values: &[&Value], instrument: Option<&Instrument>, numbers: &mut Numbers) -> Markup {
    let n = values.len();
    let at = |i: usize| (i as f64 + 0.5) / n as f64;
    let array = instrument.filter(|i| i.geometry.anchors_px.len() == n).map(|i| &i.manifest.array);
    let label = |i: usize| array.map_or_else(|| (i + 1).to_string(), |a| a.lens_name(i));
    let every = n.div_ceil(10);
    let panel = Panel {
        alt: format!("{} of {} by index", words::param(name), words::name(&e.id)),
        size: [520.0, 210.0],
        labels: (0..n).step_by(every).map(|i| (at(i), label(i))).collect(),
        x_name: if array.is_some() { "lens".into() } else { "index".into() },
        band: Vec::new(),
        series: vec![Series {
            class: "value",
            points: values.iter().enumerate().map(|(i, v)| [at(i), v.value, v.sigma]).collect(),
            joined: false,
        }],
    };
    let unit = values.first().map(|v| words::unit(&v.unit)).filter(|u| !u.is_empty());
    let title = format!(
        "{}: {}{}.",
        words::capital(&words::name(&e.id)),
        words::param(name),
        unit.map_or(String::new(), |u| format!(" ({u})"))
    );
    numbers.figure(&title, "Bars: one standard error.", panel.render())
}

/// The curve of a term without a name.
fn profile(e: &Effect, numbers: &mut Numbers) -> Option<Markup> {
    let of = |name: &str| e.params.iter().find(|v| v.name == name).map(|v| v.value);
    let knots: Vec<&Value> = e.params.iter().filter(|v| v.name.starts_with("knot_")).collect();
    let (low, high) = (of("low")?, of("high")?);
    if knots.len() != KNOTS {
        return None;
    }
    let covariate = COVARIATES.get(of("covariate")? as usize).copied().unwrap_or("covariate");
    let (what, gain) =
        if of("additive")? == 0.0 { ("factor on the light, per cent", 100.0) } else { ("light added, e⁻/ms", 1.0) };
    let place = |i: usize| i as f64 / (KNOTS - 1) as f64;
    let panel = Panel {
        alt: format!("{}: {what} against {covariate}", e.id),
        size: [520.0, 230.0],
        labels: [0.0, 0.25, 0.5, 0.75, 1.0].map(|t| (t, number(low + t * (high - low)).replace('-', "−"))).to_vec(),
        x_name: covariate.replace("e-", "e⁻"),
        band: Vec::new(),
        series: vec![Series {
            class: "value",
            points: knots.iter().enumerate().map(|(i, v)| [place(i), gain * v.value, gain * v.sigma]).collect(),
            joined: true,
        }],
    };
    let text = "A curve that was fitted because no effect of the catalogue explains the residual. Bars: one standard \
                error. It is valid within the range of the axis only; its cause is not known.";
    Some(numbers.figure(&format!("{}: {what}.", words::capital(&e.id)), text, panel.render()))
}
