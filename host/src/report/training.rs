//! The course of the training, read from the header of a checkpoint.

use super::ReportError;
use super::chart::{Axis, Chart, Line, Marks};
use super::page::{Numbers, pairs};
use super::picture::{number, picture};
use super::scenes::{raw_scale, truth_scale};
use crate::train::Sample;
use maud::{Markup, html};
use serde_json::Value;

/// Loss and quality against the step, and the shape of the network.
///
/// # Errors
/// A chart cannot be drawn.
pub fn training(header: &Value, samples: &[Sample], numbers: &mut Numbers) -> Result<Markup, ReportError> {
    let body = &header["body"];
    let curve: &[Value] = body["curve"].as_array().map_or(&[], Vec::as_slice);
    let line = |key: &str, label: &str, colour| Line {
        label: label.into(),
        points: curve.iter().filter_map(|p| Some([p["step"].as_f64()?, p[key].as_f64()?])).collect(),
        colour,
        marks: Marks::None,
    };
    let loss = Chart {
        alt: "Training and validation loss against the step".into(),
        x: Axis::linear("Step"),
        y: Axis::log10("Loss, BCE + MSE"),
        lines: vec![line("train_loss", "training", 5), line("validation_loss", "validation", 1)],
    };
    let psnr = Chart {
        alt: "Validation PSNR against the step".into(),
        x: Axis::linear("Step"),
        y: Axis::linear("PSNR (dB)"),
        lines: vec![line("psnr_db", "validation", 1)],
    };
    let best =
        body["best_step"].as_u64().map(|s| format!(" The weights kept are those of step {s}.")).unwrap_or_default();
    let text = format!("a, loss on training batches and on scenes kept out of them; b, PSNR on those scenes.{best}");
    let figure = html! {
        div.two {
            div.plate { p.name { "a  Loss" } (loss.render()?) }
            div.plate { p.name { "b  Quality" } (psnr.render()?) }
        }
    };
    let figure = numbers.figure("Training.", &text, figure);
    let samples = if samples.is_empty() {
        html! {}
    } else {
        pictures(samples, numbers)?
    };
    let shape = pairs_of(&body["network"]);
    let table = numbers.table(
        "Network.",
        "Shape of the network: Fourier filter bank, then a light residual channel-attention network.",
        pairs(&shape),
    );
    Ok(html! { (figure) (samples) div style="max-width:640px" { (table) } })
}

/// Held-out frames, their objects, and what the kept weights make of them.
fn pictures(samples: &[Sample], numbers: &mut Numbers) -> Result<Markup, ReportError> {
    let mut plates = Vec::new();
    for (i, Sample { case, found }) in samples.iter().enumerate() {
        let (raw, truth) = (raw_scale(case.frame_dn.view()), truth_scale(case.truth.view()));
        for (name, image, scale) in
            [("Raw frame", &case.frame_dn, &raw), ("Truth", &case.truth, &truth), ("Reconstruction", found, &truth)]
        {
            let picture = picture(image.view(), scale, &format!("{name} {i} of those held out"), &[])?;
            plates.push(html! { div.plate { p.name { (name) } (picture) } });
        }
    }
    let body = html! { div.plates style="grid-template-columns:repeat(3,1fr)" { @for plate in plates { (plate) } } };
    let text = "Frames that no step has seen, their objects, and the reconstructions of the kept weights, each at one free scale; truth and \
                reconstruction share a colour scale from 0 to the 99.7th percentile of the truth.";
    Ok(numbers.figure("Held out.", text, body))
}

/// The fields of a JSON object as rows of a table, in words.
fn pairs_of(object: &Value) -> Vec<(String, Markup)> {
    let fields = object.as_object().into_iter().flatten();
    fields.map(|(name, value)| (sentence(name), html! { (short(value)) })).collect()
}

/// `peak_bytes` as `Peak bytes`.
pub fn sentence(name: &str) -> String {
    let words = name.replace('_', " ");
    let mut letters = words.chars();
    letters.next().map_or(String::new(), |first| first.to_uppercase().chain(letters).collect())
}

/// A value in few characters.
pub fn short(value: &Value) -> String {
    match value {
        Value::Null => "–".into(),
        Value::String(s) => s.clone(),
        Value::Number(n) if n.is_f64() => number(n.as_f64().unwrap_or(0.0)),
        Value::Array(items) => items.iter().map(short).collect::<Vec<_>>().join(" × "),
        other => other.to_string(),
    }
}
