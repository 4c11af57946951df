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

fn series_colour(i: usize) -> RGBColor {
    RGBColor(3, 1, (i.clamp(1, 6)) as u8)
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
        match high - low {
            span if span > 0.0 => [low - margin * span, high + margin * span],
            0.0 => [low - 0.5, high + 0.5],
            _ => [0.0, 1.0],
        }
    }

    fn tick(&self, at: f64) -> String {
        let value = match self.kind {
            AxisKind::Linear => at,
            AxisKind::Log10 => 10f64.powf(at),
        };
        super::picture::number(value)
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
            self.draw_axes(&mut chart)?;
            for (line, points) in self.lines.iter().zip(lines) {
                let colour = series_colour(line.colour);
                chart.draw_series(LineSeries::new(points.clone(), colour.stroke_width(2))).map_err(drawing)?;
                if line.marks == Marks::Dots {
                    chart
                        .draw_series(points.into_iter().map(|p| Circle::new(p, 3, colour.filled())))
                        .map_err(drawing)?;
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
            .x_label_formatter(&|v| self.x.tick(*v))
            .y_label_formatter(&|v| self.y.tick(*v))
            .draw()
            .map_err(drawing)
    }
}

/// Replaces the placeholders by the CSS variables of the page, and lets the drawing scale with its column.
fn themed(svg: &str) -> String {
    let mut text = svg.replacen(
        &format!("<svg width=\"{}\" height=\"{}\"", SIZE.0, SIZE.1),
        "<svg aria-hidden=\"true\" focusable=\"false\"",
        1,
    );
    text = text.replace("#010101", "var(--ink)").replace("#020101", "var(--grid)").replace(FONT, "inherit");
    (1..=6).fold(text, |t, i| t.replace(&format!("#03010{i}"), &format!("var(--c{i})")))
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
    fn points_without_a_logarithm_are_left_out_and_no_points_make_an_empty_chart() {
        let c = chart(vec![[0.0, 1.0], [1.0, 0.0], [2.0, f64::NAN], [3.0, 0.01]], AxisKind::Log10);
        assert_eq!(c.placed(&c.lines[0]), [(0.0, 0.0), (3.0, -2.0)]);
        assert!(c.svg().is_ok() && chart(Vec::new(), AxisKind::Linear).svg().is_ok());
        assert!(chart(vec![[1.0, 1.0]], AxisKind::Linear).svg().is_ok());
    }
}
