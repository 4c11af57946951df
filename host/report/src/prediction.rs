//! Measured beside predicted frames, with details, and the residual against the distance from the middle of the sensor
//! (Fig. 2e of Yang et al. 2024).

use super::chart::{Axis, Chart, Line, Marks};
use super::error::ReportError;
use super::look::{Look, residuals};
use super::page::Numbers;
use super::picture::{Mark, Scale, picture};
use super::scenes::{Detail, details};
use maud::{Markup, html};
use ndarray::{ArrayView2, Axis as Dim};
use ommatidia_network::evaluate::Evaluation;

/// The first pictured frame beside its prediction, and the residual by radius; None without an instrument.
///
/// # Errors
/// A picture or chart cannot be made.
pub fn prediction(e: &Evaluation, numbers: &mut Numbers) -> Result<Option<Markup>, ReportError> {
    let (Some(predicted), Some(figures)) = (&e.predicted, &e.summary.prediction) else { return Ok(None) };
    let Some(frame) = e.summary.pictured.first() else { return Ok(None) };
    let measured = e.raw_dn.index_axis(Dim(0), 0);
    let found = details(measured);
    let (rows, cols) = measured.dim();
    let plate = |name: &str, image: ArrayView2<'_, f32>, scale: &Scale, unit: &str| -> Result<Markup, ReportError> {
        let marks: Vec<Mark> = found.iter().map(|d| d.mark(rows, cols)).collect();
        let zoom = |d: &Detail| {
            picture(d.of(&image), scale, &format!("{name}, detail {}", d.letter), &[Mark::Letter(d.letter)])
        };
        let zooms = found.iter().map(zoom).collect::<Result<Vec<_>, _>>()?;
        Ok(html! {
            div.plate {
                p.name { (name) span { "scene " (frame) } }
                (picture(image, scale, &format!("{name}, scene {frame}"), &marks)?)
                div.details { @for zoom in zooms { (zoom) } }
                (scale.bar(unit))
            }
        })
    };
    let grey = Look::Raw.scale(measured);
    let signed = residuals();
    let plates = [
        plate("Measured", measured, &grey, "DN")?,
        plate("Predicted", predicted.frames_dn.index_axis(Dim(0), 0), &grey, "DN")?,
        plate("Measured − predicted", predicted.residual_sigma.index_axis(Dim(0), 0), &signed, "standard deviations")?,
    ];
    let text = "A measured frame, the frame that the calibrated model predicts for the known object, both on one \
        scale, and their difference \
                in standard deviations of the noise model. a, b: details near the middle and towards the edge of the \
                sensor.";
    let body = html! { div.plates style="grid-template-columns:repeat(3,1fr)" { @for plate in plates { (plate) } } };
    let pictures = numbers.figure("Measured and predicted.", text, body);
    let rings: Vec<_> = figures.by_radius.iter().filter(|r| r.pixels > 0).collect();
    if rings.is_empty() {
        return Ok(Some(pictures));
    }
    let points = |value: &dyn Fn(usize) -> f64| -> Vec<[f64; 2]> {
        (0..rings.len()).map(|i| [(rings[i].inner_px + rings[i].outer_px) / 2.0, value(i)]).collect()
    };
    let edge = rings.iter().fold(0.0f64, |m, r| m.max(r.outer_px));
    let line = |label: &str, points, colour, marks| Line { label: label.into(), points, colour, marks };
    let chi2 = Chart {
        alt:
            "Chi-squared per pixel of measured frames against the prediction, by distance from the middle of the sensor"
                .into(),
        x: Axis::between("Distance from the middle of the sensor (px)", 0.0, edge),
        y: Axis::linear("χ² per lit pixel"),
        lines: vec![
            line("all frames", points(&|i| rings[i].chi2_ndf), 1, Marks::Dots),
            line("noise alone", points(&|_| 1.0), 5, Marks::None),
        ],
    };
    let bias = Chart {
        alt: "Mean of measured minus predicted light by distance from the middle of the sensor".into(),
        x: Axis::between("Distance from the middle of the sensor (px)", 0.0, edge),
        y: Axis::linear("Measured − predicted (% of light)"),
        lines: vec![
            line("all frames", points(&|i| 100.0 * rings[i].bias), 2, Marks::Dots),
            line("zero", points(&|_| 0.0), 5, Marks::None),
        ],
    };
    let text = format!(
        "Lit pixels of {} frames in rings round the middle of the sensor. a, χ² per pixel: 1 where model and noise \
            explain the \
         frames. b, mean residual: vignetting, shading or stray light that the model lacks would appear as a slope.",
        figures.frames
    );
    let body = html! {
        div.two {
            div.plate { p.name { "a  χ² per pixel" } (chi2.render()?) }
            div.plate { p.name { "b  Mean residual" } (bias.render()?) }
        }
    };
    Ok(Some(html! { (pictures) (numbers.figure("Residual by radius.", &text, body)) }))
}
