//! How a training went, read from the header of its checkpoint.

use super::chart::{Axis, Chart, Line, Marks};
use super::error::ReportError;
use super::look::Look;
use super::page::{Numbers, pairs};
use super::picture::{number, picture};
use maud::{Markup, html};
use ommatidia_network::train::Sample;
use serde_json::Value;

/// Loss and PSNR against the step, held-out pictures, and the sizes of the network. `header` is the header of the
/// checkpoint.
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
    let best = body["best_step"]
        .as_u64()
        .map(|s| {
            format!(
                " The checkpoint holds the weights of step \
            {s}."
            )
        })
        .unwrap_or_default();
    let text = format!(
        "a, loss on training batches and on held-out scenes; b, PSNR of reconstructions of those \
            scenes.{best}"
    );
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
        "Sizes of the network; sides in pixels. Filters, then a light residual channel-attention network.",
        pairs(&shape),
    );
    Ok(html! { (figure) (samples) div style="max-width:640px" { (table) } })
}

/// Held-out frames, their objects, and what the kept weights make of them.
fn pictures(samples: &[Sample], numbers: &mut Numbers) -> Result<Markup, ReportError> {
    let mut plates = Vec::new();
    for (i, Sample { case, found }) in samples.iter().enumerate() {
        let (raw, truth) = (Look::Raw.scale(case.frame_dn.view()), Look::Light.scale(case.truth.view()));
        for (name, image, scale) in
            [("Raw frame", &case.frame_dn, &raw), ("Truth", &case.truth, &truth), ("Reconstruction", found, &truth)]
        {
            let picture = picture(image.view(), scale, &format!("{name} {i}, held out"), &[])?;
            plates.push(html! { div.plate { p.name { (name) } (picture) } });
        }
    }
    let body = html! { div.plates style="grid-template-columns:repeat(3,1fr)" { @for plate in plates { (plate) } } };
    let text = "Held-out frames, their objects, and the reconstructions with the weights of the checkpoint, each with \
        one \
                free scale; truth and reconstruction share a colour scale from 0 to the 99.7th percentile of the \
                truth.";
    Ok(numbers.figure("Held-out scenes.", text, body))
}

/// The sizes of a network as rows of a table, in words.
fn pairs_of(object: &Value) -> Vec<(String, Markup)> {
    let fields = object.as_object().into_iter().flatten();
    let mut rows: Vec<(usize, String, Markup)> =
        fields.map(|(name, of)| (place(name), words_of(name), html! { (short(of)) })).collect();
    rows.sort_by_key(|row| row.0);
    rows.into_iter().map(|(_, name, value)| (name, value)).collect()
}

/// Name of a family of networks, as publications print it.
fn family_title(name: &str) -> &str {
    match name {
        "svfouriernet" => "SV-FourierNet",
        "multiwienernet" => "MultiWienerNet",
        "multiflatnet" => "MultiFlatNet",
        "cm2net" => "CM2Net",
        other => other,
    }
}

/// Place of a field in the table: what comes in and out first.
fn place(field: &str) -> usize {
    let order = ["family", "architecture", "frame", "object", "channels", "filter_size"];
    order.iter().position(|name| *name == field).unwrap_or(order.len())
}

/// What a field of the network's configuration is called in the table.
fn words_of(field: &str) -> String {
    match field {
        "frame" => "Raw frame".into(),
        "object" => "Reconstruction".into(),
        "filter_size" => "Side of a filter".into(),
        "channels" => "Filters".into(),
        "width" => "Features".into(),
        "groups" => "Residual groups".into(),
        "blocks" => "Blocks per group".into(),
        "reduction" => "Channel reduction of the attention".into(),
        "family" | "architecture" => "Architecture".into(),
        other => sentence(other),
    }
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
        Value::Object(fields) => {
            let text = |(name, value): (&String, &Value)| match name.as_str() {
                "name" => family_title(value.as_str().unwrap_or_default()).to_string(),
                name => format!("{} {}", name.replace('_', " "), short(value)),
            };
            fields.iter().map(text).collect::<Vec<_>>().join(", ")
        }
        Value::Bool(yes) => if *yes { "yes" } else { "no" }.into(),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use serde_json::json;

    #[test]
    fn a_network_is_described_without_json() {
        let network = json!({"frame": [214, 214], "channels": 6, "family": {"name": "svfouriernet"}});
        let rows: Vec<(String, String)> =
            pairs_of(&network).into_iter().map(|(name, value)| (name, value.into_string())).collect();
        let pair = |name: &str, value: &str| (name.to_string(), value.to_string());
        assert_eq!(rows[0], pair("Architecture", "SV-FourierNet"));
        assert!(rows.contains(&pair("Filters", "6")) && rows.contains(&pair("Raw frame", "214 × 214")));
        assert!(rows.iter().all(|(_, value)| !value.contains('{')), "{rows:?}");
        // Whatever the field is called, and whatever else it holds.
        let others = json!({"architecture": {"name": "cm2net", "crop_px": [70, 70]}, "with_maps": true});
        let text: Vec<String> = pairs_of(&others).into_iter().map(|(name, value)| name + ": " + &value.0).collect();
        assert_eq!(text, ["Architecture: crop px 70 × 70, CM2Net", "With maps: yes"]);
    }
}
