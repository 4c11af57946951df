//! Reconstructions side by side, the table of methods, PSNR against field radius, and figures of predicted frames.

use super::chart::{Axis, Chart, Line, Marks};
use super::error::ReportError;
use super::look::Look;
use super::page::{Key, Numbers};
use super::picture::{Mark, number, picture, scale_bar};
use maud::{Markup, html};
use ndarray::{ArrayView2, Axis as Dim, s};
use ommatidia_model::metrics::PredictionFigures;
use ommatidia_network::evaluate::{Evaluation, MethodFigures};
use ommatidia_network::methods::title;
use std::path::Path;

/// Colours of the methods of a page. A kind of method has the same colour on every page, and two methods of one kind
/// differ as long as there are colours.
pub struct Colours(Vec<(String, usize)>);

/// Colours that no kind has for itself.
const SPARE: [usize; 3] = [7, 8, 5];

impl Colours {
    /// Chooses a colour for each of the names, in their order.
    pub fn of<'a>(names: impl IntoIterator<Item = &'a str>) -> Self {
        let mut chosen: Vec<(String, usize)> = Vec::new();
        for name in names {
            let is_free = |colour: &usize| chosen.iter().all(|(_, other)| other != colour);
            let own = Self::of_kind(name);
            let colour = std::iter::once(own).chain(SPARE).find(is_free).unwrap_or(own);
            if chosen.iter().all(|(known, _)| known != name) {
                chosen.push((name.into(), colour));
            }
        }
        Self(chosen)
    }

    /// The colour of a method.
    pub fn get(&self, name: &str) -> usize {
        let known = self.0.iter().find(|(known, _)| known == name);
        known.map_or_else(|| Self::of_kind(name), |(_, colour)| *colour)
    }

    fn of_kind(name: &str) -> usize {
        match name.split('@').next().unwrap_or(name) {
            "svfouriernet" => 1,
            "svfouriernet-blob" => 6,
            "device" | "firmware-on-host" => 3,
            "wiener" => 2,
            "richardson-lucy" => 4,
            _ => 5,
        }
    }
}

/// A detail of the object: upper left corner and side, pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Detail {
    row: usize,
    col: usize,
    side: usize,
    pub(super) letter: &'static str,
}

impl Detail {
    pub(super) fn mark(&self, rows: usize, cols: usize) -> Mark {
        let (w, h) = (cols as f64, rows as f64);
        let side = self.side as f64;
        Mark::Box([self.col as f64 / w, self.row as f64 / h, side / w, side / h], self.letter)
    }

    pub(super) fn of<'a>(&self, image: &ArrayView2<'a, f32>) -> ArrayView2<'a, f32> {
        image.slice_move(s![self.row..self.row + self.side, self.col..self.col + self.side])
    }
}

/// Two details, a quarter of the object wide: the one with most light near the centre, and the one with most light
/// towards the edge.
pub(super) fn details(truth: ArrayView2<'_, f32>) -> Vec<Detail> {
    let (rows, cols) = truth.dim();
    let side = (rows.min(cols) / 4).max(1);
    let off_centre = |d: &Detail| {
        let at = |start: usize, n: usize| (start as f64 + side as f64 / 2.0) / n as f64 - 0.5;
        at(d.row, rows).hypot(at(d.col, cols))
    };
    let step = (side / 4).max(1);
    let corners =
        (0..=rows - side).step_by(step).flat_map(|row| (0..=cols - side).step_by(step).map(move |col| (row, col)));
    let all: Vec<Detail> = corners.map(|(row, col)| Detail { row, col, side, letter: "" }).collect();
    let brightest = |letter, inside: &dyn Fn(f64) -> bool| {
        let candidates = all.iter().filter(|d| inside(off_centre(d)));
        let best = candidates.max_by(|a, b| a.of(&truth).sum().total_cmp(&b.of(&truth).sum()))?;
        Some(Detail { letter, ..*best })
    };
    [brightest("a", &|r| r < 0.2), brightest("b", &|r| r > 0.38)].into_iter().flatten().collect()
}

const CAPTION: &str = "The raw frame contains the overlapping views of all lenses. Truth and reconstructions share \
    one linear colour scale, \
                       from 0 to the 99.7th percentile of the truth; each reconstruction has one free scale factor \
                       and no offset. \
                       a, b: details near the centre and towards the edge of the field. Beside each name: PSNR of \
                       this frame. Scale \
                       bars: on the sensor for the raw frame, in the object for the others.";

/// The scenes with their reconstructions, one figure a scene.
///
/// # Errors
/// A picture cannot be encoded.
pub fn pictures(e: &Evaluation, numbers: &mut Numbers) -> Result<Markup, ReportError> {
    let figures = (0..e.pictures()).map(|p| scene(e, p, numbers)).collect::<Result<Vec<_>, _>>()?;
    Ok(html! { @for f in figures { (f) } })
}

fn scene(e: &Evaluation, p: usize, numbers: &mut Numbers) -> Result<Markup, ReportError> {
    let (truth, raw) = (e.truths.index_axis(Dim(0), p), e.raw_dn.index_axis(Dim(0), p));
    let details = details(truth);
    let scale = Look::Light.scale(truth);
    let raw_scale = Look::Raw.scale(raw);
    let (sensor, object) = (&e.summary.sensor, &e.summary.object);
    let bar = scale_bar(object.cols as f64 * object.pixel_um);
    let plate = |name: &str, figure: String, image: ArrayView2<'_, f32>| -> Result<Markup, ReportError> {
        let marks: Vec<Mark> = details.iter().map(|d| d.mark(object.rows, object.cols)).chain([bar.clone()]).collect();
        let whole = picture(image, &scale, &format!("{name}, scene {}", e.summary.pictured[p]), &marks)?;
        let zooms = details
            .iter()
            .map(|d| picture(d.of(&image), &scale, &format!("{name}, detail {}", d.letter), &[Mark::Letter(d.letter)]));
        let zooms = zooms.collect::<Result<Vec<_>, _>>()?;
        Ok(html! {
            div.plate {
                p.name { (name) span { (figure) } }
                (whole)
                div.details { @for zoom in zooms { (zoom) } }
            }
        })
    };
    let mut plates = vec![html! {
        div.plate {
            p.name { "Raw frame" span { (sensor.rows) " × " (sensor.cols) } }
            (picture(raw, &raw_scale, "Raw frame of the sensor", &[scale_bar(sensor.cols as f64 *
                sensor.pixel_pitch_um)])?)
            (raw_scale.bar("DN"))
        }
    }];
    plates.push(plate("Truth", format!("{} × {}", object.rows, object.cols), truth)?);
    for (method, stack) in e.summary.methods.iter().zip(&e.reconstructions) {
        let psnr = method.frames.get(e.summary.pictured[p]).map(|f| format!("{:.1} dB", f.psnr_db)).unwrap_or_default();
        plates.push(plate(&title(&method.name), psnr, stack.index_axis(Dim(0), p))?);
    }
    let columns = if plates.len() > 5 { plates.len().div_ceil(2) } else { plates.len() };
    let body = html! {
        div.plates style={ "grid-template-columns:repeat(" (columns) ",1fr)" } { @for plate in plates { (plate) } }
        (scale.bar("(unit of the truth)"))
    };
    let text = match p {
        0 => CAPTION,
        _ => "As in the previous figure.",
    };
    Ok(numbers.figure(&format!("Scene {}.", e.summary.pictured[p]), text, body))
}

/// The table of methods and, beside it, the error against field radius.
///
/// # Errors
/// The chart cannot be drawn.
pub fn figures(e: &Evaluation, numbers: &mut Numbers) -> Result<Markup, ReportError> {
    let best = |f: fn(&MethodFigures) -> f64| e.summary.methods.iter().map(f).fold(f64::NEG_INFINITY, f64::max);
    let best_psnr = best(|m| m.psnr_db);
    let colours = Colours::of(e.summary.methods.iter().map(|m| m.name.as_str()));
    let table = html! {
        thead { tr {
            th { "Method" } th.n { "PSNR" small { "dB, mean ± s.d." } } th.n { "SSIM" } th.n { "NRMSE" } th.n { "PCC" }
            th.n { "Time per frame" small { "wall" } } th.n { "Peak memory" small { "process" } }
        } }
        tbody { @for m in &e.summary.methods { tr.best[m.psnr_db == best_psnr] {
            td { i.dot.{ "c" (colours.get(&m.name)) } {} (title(&m.name)) }
            td.n { (format!("{:.2}", m.psnr_db)) span.pm { (format!(" ± {:.2}", m.psnr_db_std)) } }
            td.n { (format!("{:.3}", m.ssim)) } td.n { (format!("{:.3}", m.nrmse)) } td.n { (format!("{:.3}", m.pcc)) }
            td.n { (m.seconds_per_frame.map_or("–".into(), seconds)) } td.n { (m.peak_bytes.map_or("–".into(), bytes)) }
        } } }
    };
    let caption = format!(
        "Mean over {} scenes of known truth in “{}”. PSNR with the maximum of the truth as peak; SSIM after Wang et \
            al. (2004); one \
         free scale per frame. Reconstructions read from a file have no time.",
        e.summary.frames, e.summary.session
    );
    let lines = e.summary.methods.iter().map(|m| Line {
        label: title(&m.name),
        points: m.field.iter().map(|r| [(r.inner_um + r.outer_um) / 2.0, r.psnr_db]).collect(),
        colour: colours.get(&m.name),
        marks: Marks::Dots,
    });
    let rings = e.summary.methods.iter().flat_map(|m| &m.field);
    let edge = rings.fold(0.0f64, |edge, ring| edge.max(ring.outer_um));
    let chart = Chart {
        alt: "Peak signal-to-noise ratio of each method against field radius".into(),
        x: Axis::between("Field radius (µm)", 0.0, edge),
        y: Axis::linear("PSNR (dB)"),
        lines: lines.collect(),
    };
    let field = numbers.figure(
        "Quality across the field.",
        "PSNR in rings of equal width round the centre of the field, relative to the peak of the whole frame. \
            Aberrations and \
         vignetting increase outwards.",
        chart.render()?,
    );
    let methods = numbers.table("Methods side by side.", &caption, table);
    let prediction = e.summary.prediction.as_ref().map(|p| prediction(p, numbers));
    Ok(html! { (methods) div.two { (field) (prediction.unwrap_or_default()) } })
}

fn prediction(p: &PredictionFigures, numbers: &mut Numbers) -> Markup {
    let mut rows = vec![
        ("NRMSE of the light above the black level".to_string(), html! { (format!("{:.2} %", 100.0 * p.nrmse)) }),
        ("Pearson correlation".into(), html! { (format!("{:.5}", p.pcc)) }),
        ("Free scale of the stack".into(), html! { (format!("{:.4}", p.scale)) }),
        ("χ²/ndf of measured frames against the model".into(), html! { (format!("{:.3}", p.chi2_ndf)) }),
    ];
    if p.chi2_ndf_expected > 0.0 {
        rows.push((
            "χ²/ndf of measured frames against the true expectation".into(),
            html! { (format!("{:.3}", p.chi2_ndf_expected)) },
        ));
    }
    rows.push(("Lit pixels".into(), html! { (p.lit_pixels) }));
    if let Some(b) = &p.background {
        let [level, row, col] = b.mean_e;
        let name = if b.added { "Background, added to the prediction" } else { "Background, too small to matter" };
        let value = format!(
            "{level:.2} ± {:.2} e⁻ a pixel ({row:+.2} from first to last row, {col:+.2} from first to last column)",
            b.sigma_e[0]
        );
        rows.push((name.into(), html! { (value) }));
        if b.added {
            rows.push(("NRMSE without it".into(), html! { (format!("{:.2} %", 100.0 * b.nrmse_without)) }));
            rows.push(("χ²/ndf without it".into(), html! { (format!("{:.3}", b.chi2_ndf_without)) }));
        }
    }
    let text = format!(
        "{} scene frames compared with the calibrated model. χ² over lit pixels, whose expected signal exceeds three \
            times the read \
         noise; variance from the noise model at the expected signal.",
        p.frames
    );
    numbers.table("Predicted frames.", &text, super::page::pairs(&rows))
}

/// Key figures of an evaluation.
pub fn keys(e: &Evaluation) -> Vec<Key> {
    let find = |name: &str| e.summary.methods.iter().find(|m| m.name == name);
    let mut keys = Vec::new();
    if let Some(best) = e.summary.methods.iter().max_by(|a, b| a.psnr_db.total_cmp(&b.psnr_db)) {
        let value = format!("{:.2}", best.psnr_db);
        keys.push(Key { name: "Best PSNR".into(), value, unit: "dB", note: title(&best.name), holds: None });
    }
    if let (Some(network), Some(wiener)) = (find("svfouriernet"), find("wiener")) {
        let gain = network.psnr_db - wiener.psnr_db;
        keys.push(Key {
            name: "Gain of the network over Wiener".into(),
            value: format!("{gain:+.2}"),
            unit: "dB",
            note: "target: +2 dB or more".into(),
            holds: Some(gain >= 2.0),
        });
    }
    if let Some(network) = find("svfouriernet")
        && let Some(blob) = find("svfouriernet-blob").or_else(|| file_of(&e.summary.methods, network))
    {
        let loss = network.psnr_db - blob.psnr_db;
        keys.push(Key {
            name: "Loss by half precision".into(),
            // A loss that rounds to nothing has no sign.
            value: format!("{loss:.3}").replace("-0.000", "0.000"),
            unit: "dB",
            note: "target: 0.1 dB or less".into(),
            holds: Some(loss <= 0.1),
        });
    }
    keys
}

/// Of several network files the one that was made of a checkpoint, by its name.
fn file_of<'m>(methods: &'m [MethodFigures], network: &MethodFigures) -> Option<&'m MethodFigures> {
    let stem = |m: &MethodFigures| Path::new(&m.source).file_stem().map(ToOwned::to_owned);
    methods.iter().find(|m| m.name.starts_with("svfouriernet-blob@") && stem(m) == stem(network))
}

/// A time in s or ms, whichever fits.
pub fn seconds(s: f64) -> String {
    match s {
        s if s < 1.0 => format!("{} ms", number(1e3 * s)),
        s => format!("{} s", number(s)),
    }
}

/// A size in B, KiB, MiB or GiB, whichever fits.
pub fn bytes(n: u64) -> String {
    match n as f64 {
        n if n < 1024.0 => format!("{n} B"),
        n if n < 1_048_576.0 => format!("{} KiB", number(n / 1024.0)),
        n if n < 1_073_741_824.0 => format!("{} MiB", number(n / 1_048_576.0)),
        n => format!("{} GiB", number(n / 1_073_741_824.0)),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use ndarray::Array2;

    #[test]
    fn details_lie_where_the_light_is() {
        let mut truth = Array2::<f32>::zeros((96, 96));
        truth[[50, 46]] = 1.0;
        truth[[5, 90]] = 3.0;
        let found = details(truth.view());
        assert_eq!(found.len(), 2);
        let holds = |d: &Detail, r: usize, c: usize| {
            (d.row..d.row + d.side).contains(&r) && (d.col..d.col + d.side).contains(&c)
        };
        assert!(holds(&found[0], 50, 46) && holds(&found[1], 5, 90), "{found:?}");
    }

    #[test]
    fn two_files_of_networks_have_two_colours_and_other_methods_keep_theirs() {
        let names =
            ["svfouriernet", "svfouriernet-blob@network.omm", "svfouriernet-blob@two-passes.omm", "central", "wiener"];
        let colours = Colours::of(names);
        assert_eq!(names.map(|name| colours.get(name)), [1, 6, 7, 5, 2]);
        assert_eq!(colours.get("richardson-lucy"), 4);
    }

    #[test]
    fn units_fit() {
        assert_eq!((seconds(0.0123).as_str(), seconds(2.5).as_str()), ("12.3 ms", "2.5 s"));
        assert_eq!((bytes(100).as_str(), bytes(2048).as_str(), bytes(3 << 30).as_str()), ("100 B", "2 KiB", "3 GiB"));
    }
}
