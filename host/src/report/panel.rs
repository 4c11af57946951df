//! Small charts, drawn by hand as SVG: a band, lines, dots with error bars. They take their colours from the page.

use super::picture::number;
use maud::{Markup, PreEscaped, html};
use std::fmt::Write;

/// A small chart. Places along x are fractions of its width.
#[derive(Clone, Debug)]
pub struct Panel {
    /// Description for screen readers.
    pub alt: String,
    /// Width and height of the drawing in its own units; text is 11 units high.
    pub size: [f64; 2],
    /// Labels along x: place and text.
    pub labels: Vec<(f64, String)>,
    /// A name under the labels, or nothing.
    pub x_name: String,
    /// Shaded between low and high: place, low, high.
    pub band: Vec<[f64; 3]>,
    /// What is drawn over it, in order.
    pub series: Vec<Series>,
}

/// One row of points.
#[derive(Clone, Debug)]
pub struct Series {
    /// Class of the style sheet that gives its colour: `before`, `after`, `value`.
    pub class: &'static str,
    /// Place, value and error (0: none is drawn).
    pub points: Vec<[f64; 3]>,
    /// Whether neighbouring points are joined.
    pub joined: bool,
}

/// Room left of, right of, above and below the drawing.
const ROOM: [f64; 4] = [38.0, 8.0, 6.0, 18.0];

impl Panel {
    /// The chart.
    pub fn render(&self) -> Markup {
        html! { div.panel role="img" aria-label=(self.alt) { (PreEscaped(self.svg())) } }
    }

    fn svg(&self) -> String {
        let [width, height] = self.size;
        let below = if self.x_name.is_empty() { ROOM[3] } else { ROOM[3] + 14.0 };
        let [left, right, top, bottom] = [ROOM[0], width - ROOM[1], ROOM[2], height - below];
        let [low, high] = self.ends();
        let ticks = ticks(low, high);
        let x = |at: f64| left + at * (right - left);
        let y = |v: f64| bottom - (v - low) / (high - low) * (bottom - top);
        let mut svg = format!("<svg viewBox=\"0 0 {width} {height}\" aria-hidden=\"true\" focusable=\"false\">");
        // Writing to a string cannot fail.
        for t in &ticks {
            let class = if *t == 0.0 { "zero" } else { "grid" };
            let _ = write!(
                svg,
                "<path class=\"{class}\" d=\"M{left} {0:.1}H{right}\"/><text \
                    x=\"{1}\" y=\"{2:.1}\" text-anchor=\"end\">{3}</text>",
                y(*t),
                left - 5.0,
                y(*t) + 3.8,
                number(*t).replace('-', "−")
            );
        }
        if self.band.len() > 1 {
            let edge = |i: usize| move |b: &[f64; 3]| format!("{:.1} {:.1}", x(b[0]), y(b[i].clamp(low, high)));
            let path: Vec<String> = self.band.iter().map(edge(1)).chain(self.band.iter().rev().map(edge(2))).collect();
            let _ = write!(svg, "<path class=\"band\" d=\"M{}Z\"/>", path.join("L"));
        }
        for series in &self.series {
            let points: Vec<&[f64; 3]> = series.points.iter().filter(|p| p[1].is_finite()).collect();
            let at: Vec<String> = points.iter().map(|p| format!("{:.1} {:.1}", x(p[0]), y(p[1]))).collect();
            if series.joined && at.len() > 1 {
                let _ = write!(svg, "<path class=\"line {}\" d=\"M{}\"/>", series.class, at.join("L"));
            }
            for p in points {
                if p[2] > 0.0 {
                    let (a, b) = (y((p[1] - p[2]).clamp(low, high)), y((p[1] + p[2]).clamp(low, high)));
                    let _ = write!(svg, "<path class=\"line {}\" d=\"M{:.1} {a:.1}V{b:.1}\"/>", series.class, x(p[0]));
                }
                let _ = write!(
                    svg,
                    "<circle class=\"{}\" cx=\"{:.1}\" cy=\"{:.1}\" r=\"2.2\"/>",
                    series.class,
                    x(p[0]),
                    y(p[1])
                );
            }
        }
        for (place, label) in &self.labels {
            let anchor = match *place {
                p if p <= 0.02 && self.labels.len() > 1 => "start",
                p if p >= 0.98 && self.labels.len() > 1 => "end",
                _ => "middle",
            };
            let _ = write!(
                svg,
                "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"{anchor}\">{}</text>",
                x(*place),
                bottom + 14.0,
                escaped(label)
            );
        }
        if !self.x_name.is_empty() {
            let _ = write!(
                svg,
                "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
                (left + right) / 2.0,
                height - 4.0,
                escaped(&self.x_name)
            );
        }
        svg.push_str("</svg>");
        svg
    }

    /// The values shown: all of them, zero, and a margin.
    fn ends(&self) -> [f64; 2] {
        let points = self.series.iter().flat_map(|s| &s.points).flat_map(|p| [p[1] - p[2], p[1] + p[2]]);
        let all = points.chain(self.band.iter().flat_map(|b| [b[1], b[2]])).filter(|v| v.is_finite());
        let [low, high] = all.fold([0.0f64, 0.0f64], |[l, h], v| [l.min(v), h.max(v)]);
        match high - low {
            span if span > 0.0 => [low - 0.06 * span, high + 0.06 * span],
            _ => [-1.0, 1.0],
        }
    }
}

/// Round values between two ends, zero among them: three to five.
fn ticks(low: f64, high: f64) -> Vec<f64> {
    let decade = 10f64.powf((high - low).log10().floor());
    let steps = [0.1, 0.2, 0.5, 1.0, 2.0].map(|m| m * decade);
    let within = |step: f64| ((low / step).ceil() as i64, (high / step).floor() as i64);
    let count = |step: &f64| within(*step).1 - within(*step).0 + 1;
    let step = steps.into_iter().find(|s| count(s) <= 5).unwrap_or(decade);
    let (first, last) = within(step);
    (first..=last).map(|i| i as f64 * step).collect()
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn panel(points: Vec<[f64; 3]>) -> Panel {
        let series = vec![Series { class: "after", points, joined: true }];
        let labels = vec![(0.0, "a < b".to_string()), (1.0, "c".into())];
        Panel { alt: "x".into(), size: [260.0, 150.0], labels, x_name: "row".into(), band: Vec::new(), series }
    }

    #[test]
    fn ticks_are_round_and_hold_zero() {
        assert_eq!(ticks(-0.32, 0.1), [-0.3, -0.2, -0.1, 0.0, 0.1].map(|v: f64| (v * 10.0).round() * 0.1));
        assert_eq!(ticks(-1.06, 1.06), [-1.0, -0.5, 0.0, 0.5, 1.0]);
        for (low, high) in [(0.0, 7e-5), (-3.0, 1e4), (-1e-9, 0.0)] {
            let t = ticks(low, high);
            assert!((3..=5).contains(&t.len()) && t.contains(&0.0), "{low} {high}: {t:?}");
        }
    }

    #[test]
    fn anything_can_be_drawn() {
        let svg = panel(vec![[0.0, 0.5, 0.1], [1.0, -0.2, 0.0]]).svg();
        for part in ["a &lt; b", "line after", "<circle", "class=\"zero\""] {
            assert!(svg.contains(part), "{part}");
        }
        for empty in [panel(Vec::new()), panel(vec![[0.5, 0.0, 0.0], [0.7, f64::NAN, 0.0]])] {
            assert!(!empty.svg().contains("NaN"));
        }
    }
}
