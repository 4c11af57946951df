//! The residual against each covariate: small multiples, the most significant first.

use super::super::page::Numbers;
use super::super::panel::{Panel, Series};
use super::super::picture::number;
use super::{Asked, words};
use maud::{Markup, html};
use ommatidia_closing::{Closing, Covariate, Dependence};

/// The panels. Empty if no test was made.
pub fn panels(c: &Closing, asked: Asked, numbers: &mut Numbers) -> Markup {
    if c.dependences_before.is_empty() {
        return html! {};
    }
    let mut order: Vec<&Dependence> = c.dependences_before.iter().collect();
    order.sort_by(|a, b| words::strongest_first(a, b));
    let after = |d: &Dependence| c.dependences_after.iter().find(|a| a.covariate == d.covariate);
    let closed = asked == Asked::Close;
    let body = html! {
        div.panels { @for d in order { (one(d, after(d).filter(|_| closed))) } }
        ul.legend {
            @if closed { li { i.before {} "before" } li { i.after {} "after" } } @else { li { i.after {} "residual" } }
            li { i.bandkey {} "±2 standard deviations of the mean if the model is right" }
        }
    };
    let text = "Mean residual in bins of each covariate, in standard deviations of one pixel (for neighbours and the \
                next frame: correlation of residuals; for repeats and for flats and darks: standard errors). Bins hold \
                about equal numbers of pixels of all training scenes. Beside each name: significance of the \
                dependence, from simulated residuals with noise and calibration errors.";
    numbers.figure("What the residual depends on.", text, body)
}

fn one(before: &Dependence, after: Option<&Dependence>) -> Markup {
    let class = if before.z.max(after.map_or(0.0, |a| a.z)) < 3.0 { "plate faint" } else { "plate" };
    html! {
        div class=(class) {
            p.name { (words::capital(before.covariate.words())) span {
                (words::evidence(before))
                @if let Some(a) = after { " → " b { (words::evidence(a)) } }
            } }
            (panel(before, after).render())
        }
    }
}

fn panel(before: &Dependence, after: Option<&Dependence>) -> Panel {
    let place = |n: usize| move |i: usize| if n > 1 { i as f64 / (n - 1) as f64 } else { 0.5 };
    // A few discrete bins keep a margin; a curve fills the width.
    let kinds = before.at.len() <= 9 || !follows(before.covariate);
    let at = |n: usize| move |i: usize| if kinds { (i as f64 + 0.5) / n as f64 } else { place(n)(i) };
    let points = |d: &Dependence| -> Vec<[f64; 3]> {
        d.mean.iter().enumerate().map(|(i, m)| [at(d.mean.len())(i), *m, 0.0]).collect()
    };
    let null = after.unwrap_or(before);
    let n = null.band.len();
    let mut band: Vec<[f64; 3]> = null.band.iter().enumerate().map(|(i, b)| [at(n)(i), -2.0 * b, 2.0 * b]).collect();
    if let (true, Some(first), Some(last)) = (kinds, band.first().copied(), band.last().copied()) {
        band.insert(0, [0.0, first[1], first[2]]);
        band.push([1.0, last[1], last[2]]);
    }
    let joined = follows(before.covariate);
    let series = match after {
        None => vec![Series { class: "after", points: points(before), joined }],
        Some(a) => vec![
            Series { class: "before", points: points(before), joined },
            Series { class: "after", points: points(a), joined },
        ],
    };
    let evidence = match after {
        None => words::evidence(before),
        Some(a) => format!("{} before, {} after", words::evidence(before), words::evidence(a)),
    };
    Panel {
        alt: format!("Mean residual against {}: {evidence}", before.covariate.words()),
        size: [260.0, 148.0],
        labels: labels(before, &at(before.at.len())),
        x_name: String::new(),
        band,
        series,
    }
}

/// Labels below the bins.
fn labels(d: &Dependence, at: &dyn Fn(usize) -> f64) -> Vec<(f64, String)> {
    let n = d.at.len();
    let each = |names: &[&str]| names.iter().take(n).enumerate().map(|(i, s)| (at(i), (*s).to_string())).collect();
    match d.covariate {
        Covariate::RowParity | Covariate::ColumnParity => each(&["even", "odd"]),
        Covariate::Checkerboard => each(&["even", "odd"]),
        Covariate::Neighbours => each(&["→ 1", "↓ 1", "↘ 1", "→ 2", "↓ 2"]),
        Covariate::NextFrame => each(&["next frame"]),
        Covariate::Repeats => each(&["σ²", "→", "↓", "↘", "tails", "rows", "cols"]),
        Covariate::FixedPattern => each(&["response", "offset"]),
        Covariate::Lens if n <= 9 => (0..n).map(|i| (at(i), (i + 1).to_string())).collect(),
        Covariate::Frame if n <= 9 => d.at.iter().enumerate().map(|(i, v)| (at(i), number(*v))).collect(),
        kind => {
            let unit = match kind {
                Covariate::Intensity | Covariate::LocalMean | Covariate::PreviousFrame | Covariate::TotalLight => " e⁻",
                Covariate::Depth => " µm",
                Covariate::Row | Covariate::Column | Covariate::Radius => " px",
                Covariate::FieldRow | Covariate::FieldColumn => " px",
                _ => "",
            };
            let mut places = vec![0, n / 2, n - 1];
            places.dedup();
            let largest = d.at.iter().fold(0.0f64, |m, v| m.max(v.abs()));
            let text = |i: usize| {
                let v = match d.at[i] {
                    v if v.abs() < 2e-3 * largest => 0.0,
                    v if v.abs() >= 10.0 => v.round(),
                    v => v,
                };
                format!("{}{}", number(v).replace('-', "−"), if i + 1 == n { unit } else { "" })
            };
            places.into_iter().map(|i| (at(i), text(i))).collect()
        }
    }
}

/// Whether the covariate is continuous, so that a line joins the bins.
fn follows(covariate: Covariate) -> bool {
    !matches!(
        covariate,
        Covariate::RowParity
            | Covariate::ColumnParity
            | Covariate::Checkerboard
            | Covariate::Lens
            | Covariate::Frame
            | Covariate::Neighbours
            | Covariate::NextFrame
            | Covariate::Repeats
            | Covariate::FixedPattern
    )
}
