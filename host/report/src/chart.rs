//! Line charts as SVG that takes its colours from the page, so that it follows a light or a dark theme.

use super::error::ReportError;
use super::ticks::{AxisKind, Places};
use maud::{Markup, PreEscaped, html};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// An axis.
#[derive(Clone, Debug)]
pub struct Axis {
    /// Label with its unit.
    pub label: &'static str,
    /// Linear or logarithmic.
    pub kind: AxisKind,
    /// Its ends; None: the range of the data.
    pub range: Option<[f64; 2]>,
}

/// One line.
#[derive(Clone, Debug)]
pub struct Line {
    /// Name in the legend.
    pub label: String,
    /// Points, x ascending. On a logarithmic axis, points that are not positive are left out.
    pub points: Vec<[f64; 2]>,
    /// Colour: 1 to 6.
    pub colour: usize,
    /// Whether the points themselves are marked.
    pub marks: Marks,
}

/// How the points of a line are shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Marks {
    /// The line alone.
    None,
    /// A dot at each point.
    Dots,
}

/// A chart.
#[derive(Clone, Debug)]
pub struct Chart {
    /// Description for screen readers.
    pub alt: String,
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
    /// Lines.
    pub lines: Vec<Line>,
}

const SIZE: (u32, u32) = (520, 320);
/// Placeholders that [`Chart::svg`] replaces by the colours of the page.
const INK: RGBColor = RGBColor(1, 1, 1);
const GRID: RGBColor = RGBColor(2, 1, 1);
const FONT: &str = "chart-font";
/// Colours of lines: `--c1` to `--c8` of the style sheet.
const COLOURS: usize = 8;

fn series_colour(i: usize, turn: Turn) -> RGBColor {
    RGBColor(3, turn.code(), (i.clamp(1, COLOURS)) as u8)
}

impl Axis {
    /// A linear axis over the data.
    pub fn linear(label: &'static str) -> Self {
        Self { label, kind: AxisKind::Linear, range: None }
    }

    /// A linear axis between two ends.
    pub fn between(label: &'static str, low: f64, high: f64) -> Self {
        Self { label, kind: AxisKind::Linear, range: Some([low, high]) }
    }

    /// A logarithmic axis over the data.
    pub fn log10(label: &'static str) -> Self {
        Self { label, kind: AxisKind::Log10, range: None }
    }

    fn place(&self, value: f64) -> Option<f64> {
        match self.kind {
            AxisKind::Linear => value.is_finite().then_some(value),
            AxisKind::Log10 => (value > 0.0 && value.is_finite()).then(|| value.log10()),
        }
    }

    fn ends(&self, values: impl Iterator<Item = f64>, margin: f64) -> [f64; 2] {
        if let Some([low, high]) = self.range {
            return [self.place(low).unwrap_or(0.0), self.place(high).unwrap_or(1.0)];
        }
        let [low, high] = values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| [low.min(v), high.max(v)]);
        // What rounding leaves is no range.
        let negligible = 1e-9 * low.abs().max(high.abs()).max(1e-3);
        match high - low {
            span if (0.0..=negligible).contains(&span) => [low - 0.5, high + 0.5],
            span if span > 0.0 => [low - margin * span, high + margin * span],
            _ => [0.0, 1.0],
        }
    }

    /// The label of a tick on an axis of length `span`: with the decimals that tell it from its neighbours.
    fn tick(&self, at: f64, span: f64) -> String {
        if self.kind == AxisKind::Log10 {
            return super::picture::number(10f64.powf(at)).replace('-', "−");
        }
        let decimals = (-(span / 10.0).log10().floor()).max(0.0);
        let text = match (at.abs() < 1e5, decimals < 5.0) {
            (true, true) => format!("{:.*}", decimals as usize, at),
            _ => super::picture::number(at),
        };
        let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
        if text == "-0" { "0".into() } else { text.replace('-', "−") }
    }
}

impl Chart {
    /// The chart with its legend.
    ///
    /// # Errors
    /// The drawing fails.
    pub fn render(&self) -> Result<Markup, ReportError> {
        let svg = self.svg()?;
        Ok(html! {
            div.chart role="img" aria-label=(self.alt) {
                (PreEscaped(svg))
                @if self.lines.len() > 1 {
                    ul.legend {
                        @for line in &self.lines { li { i.{ "c" (line.colour) } {} (line.label) } }
                        @if self.any_coincide() { li { "coinciding lines alternate, dash by dash" } }
                    }
                }
            }
        })
    }

    /// The chart without a legend, for lines that are all of one kind.
    ///
    /// # Errors
    /// The drawing fails.
    pub fn render_without_legend(&self) -> Result<Markup, ReportError> {
        let svg = self.svg()?;
        Ok(html! { div.chart role="img" aria-label=(self.alt) { (PreEscaped(svg)) } })
    }

    fn any_coincide(&self) -> bool {
        let lines: Vec<Vec<(f64, f64)>> = self.lines.iter().map(|l| self.placed(l)).collect();
        let [low, high] = self.y.ends(lines.iter().flatten().map(|p| p.1), 0.08);
        turns(&lines, high - low).iter().any(|turn| turn.of > 1)
    }

    fn svg(&self) -> Result<String, ReportError> {
        let lines: Vec<Vec<(f64, f64)>> = self.lines.iter().map(|l| self.placed(l)).collect();
        let [x0, x1] = self.x.ends(lines.iter().flatten().map(|p| p.0), 0.0);
        let [y0, y1] = self.y.ends(lines.iter().flatten().map(|p| p.1), 0.08);
        let mut text = String::new();
        {
            let root = SVGBackend::with_string(&mut text, SIZE).into_drawing_area();
            let mut chart = ChartBuilder::on(&root)
                .margin_top(10)
                .margin_right(18)
                .x_label_area_size(40)
                .y_label_area_size(58)
                .build_cartesian_2d(Places::new(self.x.kind, x0, x1), Places::new(self.y.kind, y0, y1))
                .map_err(drawing)?;
            self.draw_axes(&mut chart, [x1 - x0, y1 - y0])?;
            let turns = turns(&lines, y1 - y0);
            for ((line, points), turn) in self.lines.iter().zip(lines).zip(turns) {
                let stroke = series_colour(line.colour, turn).stroke_width(2);
                chart.draw_series(LineSeries::new(points.clone(), stroke)).map_err(drawing)?;
                if line.marks == Marks::Dots {
                    // Where lines coincide, the dots of those drawn before show as rings.
                    let size = 3 + (turn.of.saturating_sub(turn.number + 1)) as i32;
                    let fill = series_colour(line.colour, Turn::ALONE).filled();
                    chart.draw_series(points.into_iter().map(|p| Circle::new(p, size, fill))).map_err(drawing)?;
                }
            }
            root.present().map_err(drawing)?;
        }
        Ok(themed(&text))
    }

    fn placed(&self, line: &Line) -> Vec<(f64, f64)> {
        line.points.iter().filter_map(|p| Some((self.x.place(p[0])?, self.y.place(p[1])?))).collect()
    }

    fn draw_axes<DB: DrawingBackend>(
        &self,
        chart: &mut ChartContext<'_, DB, Cartesian2d<Places, Places>>,
        [width, height]: [f64; 2],
    ) -> Result<(), ReportError> {
        let text = |size: i32| (FONT, size).into_font().color(&INK);
        chart
            .configure_mesh()
            .disable_x_mesh()
            .x_labels(6)
            .y_labels(6)
            .axis_style(INK)
            .bold_line_style(GRID)
            .light_line_style(TRANSPARENT)
            .set_all_tick_mark_size(4)
            .label_style(text(12))
            .axis_desc_style(text(13).pos(Pos::new(HPos::Center, VPos::Center)))
            .x_desc(self.x.label)
            .y_desc(self.y.label)
            .x_label_formatter(&|v| self.x.tick(*v, width))
            .y_label_formatter(&|v| self.y.tick(*v, height))
            .draw()
            .map_err(drawing)
    }
}

/// A line among those that coincide with it: they take turns, dash by dash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Turn {
    /// Number of the line, from 0.
    number: usize,
    /// How many lines coincide.
    of: usize,
}

impl Turn {
    /// A line that coincides with no other.
    const ALONE: Self = Self { number: 0, of: 1 };
    /// Most lines that take turns.
    const MOST: usize = 6;
    /// Length of a dash, pixels.
    const DASH: usize = 9;

    /// Stands for the turn in the placeholder of a colour.
    fn code(self) -> u8 {
        (16 * self.of + self.number) as u8
    }
}

/// The turn of each line. `height` is the length of the vertical axis.
fn turns(lines: &[Vec<(f64, f64)>], height: f64) -> Vec<Turn> {
    // Less than a line's width apart.
    let close = |a: &(f64, f64), b: &(f64, f64)| a.0 == b.0 && (a.1 - b.1).abs() < 0.008 * height;
    let coincide = |a: &[(f64, f64)], b: &[(f64, f64)]| {
        let near = a.iter().zip(b).filter(|(a, b)| close(a, b)).count();
        a.len() == b.len() && a.len() > 1 && 4 * near >= 3 * a.len()
    };
    let turn = |i: usize| {
        let group: Vec<usize> = (0..lines.len()).filter(|&j| coincide(&lines[i], &lines[j])).collect();
        let number = group.iter().position(|&j| j == i).unwrap_or(0);
        if group.len() > 1 && group.len() <= Turn::MOST { Turn { number, of: group.len() } } else { Turn::ALONE }
    };
    (0..lines.len()).map(turn).collect()
}

/// Replaces the placeholders by the CSS variables of the page, and lets the drawing scale with its column.
fn themed(svg: &str) -> String {
    let mut text = svg.replacen(
        &format!("<svg width=\"{}\" height=\"{}\"", SIZE.0, SIZE.1),
        "<svg aria-hidden=\"true\" focusable=\"false\"",
        1,
    );
    text = text.replace("#010101", "var(--ink)").replace("#020101", "var(--grid)").replace(FONT, "inherit");
    for of in 1..=Turn::MOST {
        for number in 0..of {
            let dash = Turn::DASH;
            let dashes = match of {
                1 => String::new(),
                _ => {
                    format!(" stroke-dasharray=\"{dash} {}\" stroke-dashoffset=\"-{}\"", dash * (of - 1), dash * number)
                }
            };
            for i in 1..=COLOURS {
                let placeholder = format!("#03{:02X}0{i}", Turn { number, of }.code());
                text = text.replace(&format!("\"{placeholder}\""), &format!("\"var(--c{i})\"{dashes}"));
            }
        }
    }
    text
}

fn drawing(error: impl std::fmt::Display) -> ReportError {
    ReportError::Chart(error.to_string())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn chart(points: Vec<[f64; 2]>, kind: AxisKind) -> Chart {
        let y = Axis { label: "Error", kind, range: None };
        let line = |colour| Line { label: "a".into(), points: points.clone(), colour, marks: Marks::Dots };
        Chart { alt: "a chart".into(), x: Axis::linear("Rank"), y, lines: vec![line(1), line(2)] }
    }

    #[test]
    fn colours_come_from_the_page() {
        let html = chart(vec![[0.0, 1.0], [1.0, 0.5]], AxisKind::Linear).render().unwrap().into_string();
        for text in ["var(--ink)", "var(--grid)", "var(--c1)", "var(--c2)", "Rank", "Error", "aria-label=\"a chart\""] {
            assert!(html.contains(text), "{text} is missing");
        }
        assert!(!html.contains("#01") && !html.contains("#03"), "a placeholder is left");
    }

    #[test]
    fn of_lines_that_coincide_each_is_seen() {
        let points = vec![[0.0, 1.0], [1.0, 0.5], [2.0, 0.7]];
        let html = chart(points, AxisKind::Linear).render().unwrap().into_string();
        assert!(html.matches("stroke-dasharray").count() == 2 && html.contains("coinciding lines"), "{html}");
        assert!(html.contains("stroke-dashoffset=\"-0\"") && html.contains("stroke-dashoffset=\"-9\""));
        let three = [vec![(0.0, 1.0), (1.0, 2.0)], vec![(0.0, 1.1), (1.0, 2.1)], vec![(0.0, 1.0), (1.0, 2.0)]];
        let turn = |number, of| Turn { number, of };
        assert_eq!(turns(&three, 2.0), [turn(0, 2), Turn::ALONE, turn(1, 2)]);
    }

    #[test]
    fn ticks_have_the_decimals_that_their_distance_needs_and_no_residue_of_rounding() {
        let axis = Axis::linear("x");
        assert_eq!([28.9, 28.95, 29.0].map(|v| axis.tick(v, 0.2)), ["28.9", "28.95", "29"]);
        assert_eq!([-1.1e-16, 0.5, -100.0].map(|v| axis.tick(v, 2.0)), ["0", "0.5", "−100"]);
        assert_eq!(axis.tick(2e6, 1e7), "2 × 10⁶");
        assert_eq!(Axis::log10("x").tick(-4.0, 5.0), "10⁻⁴");
        // A quantity that is zero but for rounding, as a residual of exact frames.
        let rounding = chart(vec![[0.0, -1.1e-16], [1.0, 2.2e-16], [2.0, 0.0]], AxisKind::Linear);
        let svg = rounding.svg().unwrap();
        assert!(!svg.contains("⁻¹⁶") && !svg.contains("e-16") && svg.contains("0.4"), "{svg}");
    }

    #[test]
    fn points_without_a_logarithm_are_left_out_and_no_points_make_an_empty_chart() {
        let c = chart(vec![[0.0, 1.0], [1.0, 0.0], [2.0, f64::NAN], [3.0, 0.01]], AxisKind::Log10);
        assert_eq!(c.placed(&c.lines[0]), [(0.0, 0.0), (3.0, -2.0)]);
        assert!(c.svg().is_ok() && chart(Vec::new(), AxisKind::Linear).svg().is_ok());
        assert!(chart(vec![[1.0, 1.0]], AxisKind::Linear).svg().is_ok());
    }
}
