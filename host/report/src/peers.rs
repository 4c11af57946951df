//! Figures of methods beyond their error: resolution by place, spectra by radius, receptive fields, filters, ablations.

use super::chart::{Axis, Chart, Line, Marks};
use super::colour::ColourMap;
use super::error::ReportError;
use super::page::Numbers;
use super::picture::{Scale, number, picture};
use super::scenes::Colours;
use maud::{Markup, html};
use ndarray::{ArrayView2, Axis as Dim};
use ommatidia_network::evaluate::Evaluation;
use ommatidia_network::evaluate::receptive::{ReceptiveFields, middle};
use ommatidia_network::evaluate::resolution::Resolution;
use ommatidia_network::methods::title;
use serde_json::Value;

/// Period of the bars whose profiles are drawn, object pixels.
const DRAWN_PX: f64 = 3.0;
/// Filters that are pictured, and the side of what is shown of them, pixels.
const PICTURED: usize = 9;
const SIDE: usize = 160;

/// The finest resolved line pair of each method, and profiles of one line pair. `json`: what `resolution --json`
/// printed.
///
/// # Errors
/// A chart cannot be drawn.
pub fn resolution(json: &Value, numbers: &mut Numbers) -> Result<Markup, ReportError> {
    let all: Vec<Resolution> = serde_json::from_value(json["resolution"].clone()).unwrap_or_default();
    let focus_um = all.iter().map(|r| r.z_um).min_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or(0.0);
    let (found, elsewhere): (Vec<Resolution>, Vec<Resolution>) = all.iter().cloned().partition(|r| r.z_um == focus_um);
    let pixel_um = json["object_pixel_um"].as_f64().unwrap_or(1.0);
    let um = |v: Option<f64>| v.map_or("–".to_string(), number);
    let colours = Colours::of(found.iter().map(|r| r.name.as_str()));
    let table = html! {
        thead { tr { th { "Method" } th.n { "Centre" small { "µm per line pair" } } th.n { "Edges" small { "µm per \
            line pair" } } } }
        tbody { @for r in &found { tr {
            td { i.dot.{ "c" (colours.get(&r.name)) } {} (title(&r.name)) } td.n { (um(r.centre_um)) } td.n {
                (um(r.edges_um)) }
        } } }
    };
    let text = "Groups of three bars along rows and columns, at the centre of the field and at its four edges, from 2 \
        to 6 object pixels \
                per line pair. A line pair is resolved if every gap is darker than 0.81 of the bars beside it and \
                every coarser pair \
                is resolved too; at the edges, this must hold at all four.";
    let table = numbers.table("Finest line pairs.", text, table);
    let profiles = |place: &str, along: &str| {
        let lines = found.iter().filter_map(|r| {
            let of = r.readings.iter().find(|g| g.place == place && g.along == along && g.period_px == DRAWN_PX)?;
            let points = of.profile.iter().enumerate().map(|(i, v)| [i as f64 * pixel_um, *v]).collect();
            Some(Line { label: title(&r.name), points, colour: colours.get(&r.name), marks: Marks::None })
        });
        let chart = Chart {
            alt: format!("Line profiles through bars at the {place} of the field"),
            x: Axis::linear("Distance (µm)"),
            y: Axis::between("Light, relative to its maximum", 0.0, 1.05),
            lines: lines.collect(),
        };
        chart.render()
    };
    let body = html! {
        div.two {
            div.plate { p.name { "a  Centre" } (profiles("centre", "cols")?) }
            div.plate { p.name { "b  Left edge" } (profiles("left", "cols")?) }
        }
    };
    let text = format!(
        "Profiles across three bars of {} µm per line pair, mean over the middle half of the bars.",
        number(DRAWN_PX * pixel_um)
    );
    let profiles = numbers.figure("Line profiles.", &text, body);
    let depth = if elsewhere.is_empty() {
        html! {}
    } else {
        over_depth(&all, &found, numbers)?
    };
    Ok(html! { (table) (profiles) (depth) })
}

/// The finest line pairs of each method over the depth of the targets.
fn over_depth(all: &[Resolution], methods: &[Resolution], numbers: &mut Numbers) -> Result<Markup, ReportError> {
    let colours = Colours::of(methods.iter().map(|r| r.name.as_str()));
    let chart = |what: &str, finest: fn(&Resolution) -> Option<f64>| {
        let line = |method: &Resolution| {
            let of = all.iter().filter(|r| r.name == method.name);
            let mut points: Vec<[f64; 2]> = of.filter_map(|r| Some([r.z_um, finest(r)?])).collect();
            points.sort_by(|a, b| a[0].total_cmp(&b[0]));
            Line { label: title(&method.name), points, colour: colours.get(&method.name), marks: Marks::Dots }
        };
        let chart = Chart {
            alt: format!("Finest line pair over depth, {what}"),
            x: Axis::linear("Depth (µm)"),
            y: Axis::linear("Finest line pair (µm)"),
            lines: methods.iter().map(line).filter(|line| !line.points.is_empty()).collect(),
        };
        chart.render()
    };
    let body = html! {
        div.two {
            div.plate { p.name { "a  Centre" } (chart("centre", |r| r.centre_um)?) }
            div.plate { p.name { "b  Edges" } (chart("edges", |r| r.edges_um)?) }
        }
    };
    let text = "The same targets at other depths. A method without a point at a depth resolves none of the line pairs \
        there.";
    Ok(numbers.figure("Resolution over depth.", text, body))
}

/// Fourier ring correlation of the innermost and the outermost part of the field.
///
/// # Errors
/// A chart cannot be drawn.
pub fn spectra(e: &Evaluation, numbers: &mut Numbers) -> Result<Option<Markup>, ReportError> {
    if e.summary.methods.iter().all(|m| m.spectra.is_empty()) {
        return Ok(None);
    }
    let colours = Colours::of(e.summary.methods.iter().map(|m| m.name.as_str()));
    let chart = |ring: usize, what: &str| {
        let lines = e.summary.methods.iter().filter_map(|m| {
            let of = m.spectra.get(ring)?;
            let points = of.frequency_per_um.iter().zip(&of.correlation).map(|(f, c)| [1e3 * f, *c]).collect();
            Some(Line { label: title(&m.name), points, colour: colours.get(&m.name), marks: Marks::Dots })
        });
        let chart = Chart {
            alt: format!("Correlation with the truth by spatial frequency, {what}"),
            x: Axis::linear("Spatial frequency (1/mm)"),
            y: Axis::between("Correlation with the truth", 0.0, 1.0),
            lines: lines.collect(),
        };
        chart.render()
    };
    let last = e.summary.methods.iter().map(|m| m.spectra.len()).max().unwrap_or(1) - 1;
    let body = html! {
        div.two {
            div.plate { p.name { "a  Innermost third" } (chart(0, "innermost third of the field")?) }
            div.plate { p.name { "b  Outermost third" } (chart(last, "outermost third of the field")?) }
        }
    };
    let text = "Fourier ring correlation of patches of 24 × 24 object pixels under a Hann window, grouped by the \
        distance of the patch \
                from the centre of the field. 1: the band is reproduced; 0: it is missing or invented.";
    Ok(Some(numbers.figure("Spatial frequencies across the field.", text, body)))
}

/// Receptive fields beside PSFs, and filters beside pseudo-inverses.
///
/// # Errors
/// A picture cannot be encoded.
pub fn receptive(r: &ReceptiveFields, numbers: &mut Numbers) -> Result<Markup, ReportError> {
    let percent = |v: f64| format!("{:.1} %", 100.0 * v);
    let table = html! {
        thead { tr {
            th { "Place" } th { "Object pixel" } th.n { "PCC" small { "with its PSF" } } th.n { "PCC" small { "with \
                that of the mirrored place" } }
            th.n { "On foci" small { "of the positive weight" } } th.n { "Foci" small { "of the frame" } } th.n {
                "Negative" small { "of all weight" } }
        } }
        tbody { @for p in &r.summary.places { tr {
            td { (p.name) } td { (p.pixel[0]) ", " (p.pixel[1]) } td.n { (format!("{:.3}", p.pcc)) } td.n {
                (format!("{:.3}", p.pcc_elsewhere)) }
            td.n { (percent(p.on_foci)) } td.n { (percent(p.foci_area)) } td.n { (percent(p.negative)) }
        } } }
    };
    let text = format!(
        "Gradient of one reconstructed pixel of {} with respect to the frame, mean over {} frames; its positive part \
            is compared \
         with the calibrated PSF of the place. Outside the field the PSF is that of the nearest calibrated pixel, \
         moved along \
         its chief rays.",
        title(&r.summary.network),
        r.summary.frames
    );
    let table = numbers.table("Effective receptive fields.", &text, table);
    let signed = Scale::linear(-1.0, 1.0, ColourMap::Diverging);
    let light = Scale::linear(0.0, 1.0, ColourMap::Inferno);
    let plate = |name: String, image: ArrayView2<'_, f32>, scale: &Scale| -> Result<Markup, ReportError> {
        Ok(html! { div.plate { p.name { (name) } (picture(image, scale, &name, &[])?) } })
    };
    let mut plates = Vec::new();
    for (i, p) in r.summary.places.iter().enumerate() {
        plates.push(plate(format!("{}, receptive field", p.name), r.fields.index_axis(Dim(0), i), &signed)?);
        plates.push(plate(format!("{}, PSF", p.name), r.psfs.index_axis(Dim(0), i), &light)?);
    }
    let fields = numbers.figure(
        "Receptive fields and PSFs.",
        "Each over the whole frame, relative to its largest magnitude.",
        html! { div.plates style="grid-template-columns:repeat(4,1fr)" { @for p in plates { (p) } } },
    );
    if r.filters.is_empty() {
        return Ok(html! { (table) (fields) });
    }
    let mut plates = Vec::new();
    for i in 0..r.filters.len_of(Dim(0)).min(PICTURED) {
        let figures = r.summary.filters.get(i).map_or(0.0, |f| f.pcc);
        let name = format!("filter {}, PCC {figures:.2}", i + 1);
        plates.push(plate(name, middle(r.filters.index_axis(Dim(0), i), SIDE), &signed)?);
        plates.push(plate(
            format!("pseudo-inverse {}", i + 1),
            middle(r.inverses.index_axis(Dim(0), i), SIDE),
            &signed,
        )?);
    }
    let text = format!(
        "Learned filters in real space, zero shift in the middle, and pseudo-inverses of as many calibrated PSFs \
            (regularisation K: a \
         tenth of the mean power); not paired. PCC: correlation with the most similar pseudo-inverse. {:.1} % of the \
         energy of \
         the filters lies in the span of these pseudo-inverses.",
        100.0 * r.summary.in_span
    );
    let filters = numbers.figure(
        "Filters in real space.",
        &text,
        html! { div.plates style="grid-template-columns:repeat(4,1fr)" { @for p in plates { (p) } } },
    );
    Ok(html! { (table) (fields) (filters) })
}

/// The table of an ablation.
pub fn ablation(json: &Value, numbers: &mut Numbers) -> Markup {
    let rows = json["ablation"].as_array().map_or(&[][..], Vec::as_slice);
    let figure =
        |row: &Value, key: &str, digits: usize| row[key].as_f64().map_or("–".into(), |v| format!("{v:.digits$}"));
    let best = rows.iter().filter_map(|r| r["psnr_db"].as_f64()).fold(f64::NEG_INFINITY, f64::max);
    let table = html! {
        thead { tr {
            th { "Variant" } th.n { "Parameters" } th.n { "PSNR" small { "dB" } } th.n { "SSIM" } th.n { "NRMSE" }
                th.n { "Training" small { "s" } }
        } }
        tbody { @for row in rows { tr.best[row["psnr_db"].as_f64() == Some(best)] {
            td { (row["variant"].as_str().unwrap_or_default()) } td.n { (row["parameters"]) } td.n { (figure(row,
                "psnr_db", 2)) }
            td.n { (figure(row, "ssim", 3)) } td.n { (figure(row, "nrmse", 3)) } td.n { (figure(row, "train_seconds",
                0)) }
        } } }
    };
    let text = format!(
        "Networks that differ in one choice each: {} steps on the same pairs, with the same enhancement, loss and \
            schedule; means \
         over {} held-out scenes.",
        json["steps"], json["frames"]
    );
    numbers.table("Ablations.", &text, table)
}
