//! The calibrated instrument: PSFs by lens and field, their correlation, singular values, and the noise of the sensor.

use super::chart::{Axis, Chart, Line, Marks};
use super::closing::plus_minus;
use super::colour::ColourMap;
use super::error::ReportError;
use super::look::tile_columns;
use super::page::{Numbers, pairs};
use super::picture::{Scale, Tone, number, picture};
use maud::{Markup, html};
use ndarray::{Array2, ArrayView2, Axis as Dim, s};
use ommatidia_model::instrument::Instrument;
use ommatidia_model::psf::LowRankPsf;
use ommatidia_physics::noise::Source;

/// PSFs shown along each side of the field.
const GALLERY: usize = 5;

/// The optics of an instrument.
///
/// # Errors
/// A picture or chart cannot be made.
pub fn optics(instrument: &Instrument, numbers: &mut Numbers) -> Result<Markup, ReportError> {
    if instrument.sensor_only() {
        return Ok(html! { p {
            "No bead scan was measured: the optics is the identity, and only the sensor is modelled."
        } });
    }
    let gallery = gallery(instrument, numbers)?;
    let correlation = correlation(instrument, numbers)?;
    let rank = rank(instrument, numbers)?;
    Ok(html! { (gallery) (correlation) (rank) (quality(instrument, numbers)) })
}

/// How well the model reproduces the bead scan.
fn quality(instrument: &Instrument, numbers: &mut Numbers) -> Markup {
    let q = &instrument.quality;
    let percent = |v: f64| html! { (format!("{:.2} %", 100.0 * v)) };
    let mut rows = vec![
        ("NRMSE on the fitted positions".to_string(), percent(q.approximation_error)),
        ("NRMSE on held-out positions (checkerboard)".into(), percent(q.off_grid_error)),
        ("— with one PSF per lens instead".into(), percent(q.one_psf_error)),
        ("— of the noise of the bead frames alone".into(), percent(q.noise_floor)),
        ("NRMSE on held-out bead frames, noise deducted".into(), percent(q.frame_error)),
        ("Distance of foci from their chief rays, rms".into(), html! { (number(q.chief_ray_rms_px)) " px" }),
        ("Magnification".into(), html! { (number(instrument.geometry.magnification)) }),
    ];
    if let Some(b) = q.background {
        let value = |a: usize| format!("{:.2} ± {:.2} e−", b.mean_e[a], b.sigma_e[a]).replace('-', "−");
        rows.push(("Background of the bead frames, removed".into(), html! { (value(0)) }));
        rows.push(("— change from the first to the last row".into(), html! { (value(1)) }));
        rows.push(("— change from the first to the last column".into(), html! { (value(2)) }));
    }
    let text = "Over all windows, without the black level. The distance of a focus from its chief ray is part of the \
        model: it stays in \
                the window.";
    html! { div style="max-width:640px" { (numbers.table("Calibration.", text, pairs(&rows))) } }
}

/// PSF of a lens at a node of the coefficient grid at the depth nearest to 0 um, Eq. 2: the basis weighted with the
/// coefficients, DN.
fn psf_at(psf: &LowRankPsf, lens: usize, row: usize, col: usize) -> Array2<f32> {
    let window = psf.basis.dim().2;
    let coefficients = psf.coefficients.slice(s![lens, .., psf.depth_nearest(0.0), row, col]);
    let sum = Array2::zeros((window, psf.basis.dim().3));
    coefficients.iter().zip(psf.basis.index_axis(Dim(0), lens).outer_iter()).fold(sum, |sum, (&m, b)| sum + &b * m)
}

fn gallery(instrument: &Instrument, numbers: &mut Numbers) -> Result<Markup, ReportError> {
    let psf = &instrument.psf;
    let (lenses, _, window, _) = psf.basis.dim();
    let (_, _, _, node_rows, node_cols) = psf.coefficients.dim();
    let pick = |n: usize| -> Vec<usize> {
        let shown = GALLERY.min(n);
        (0..shown).map(|i| (i * (n - 1) + (shown - 1) / 2).checked_div(shown - 1).unwrap_or(0)).collect()
    };
    let (rows, cols) = (pick(node_rows), pick(node_cols));
    let tile = window + 1;
    let panels: Vec<Array2<f32>> = (0..lenses)
        .map(|lens| {
            let mut panel = Array2::zeros((rows.len() * tile - 1, cols.len() * tile - 1));
            for (i, &r) in rows.iter().enumerate() {
                for (j, &c) in cols.iter().enumerate() {
                    let place = s![i * tile..i * tile + window, j * tile..j * tile + window];
                    panel.slice_mut(place).assign(&psf_at(psf, lens, r, c));
                }
            }
            panel
        })
        .collect();
    let peak = panels.iter().flatten().fold(0.0f32, |m, &v| m.max(v));
    let scale = Scale { low: 0.0, high: f64::from(peak), tone: Tone::SquareRoot, map: ColourMap::Inferno };
    let show = |(lens, panel): (usize, &Array2<f32>)| {
        let alt = format!("PSFs of lens {lens} at {} by {} field positions", rows.len(), cols.len());
        let dead = if instrument.geometry.dead[lens] { " (dead)" } else { "" };
        Ok::<_, ReportError>(html! {
            div.plate {
                p.name { "Lens " (instrument.manifest.array.lens_name(lens)) (dead) }
                (picture(panel.view(), &scale, &alt, &[])?)
            }
        })
    };
    let panels = panels.iter().enumerate().map(show).collect::<Result<Vec<_>, _>>()?;
    let um = instrument.manifest.sensor.pixel_pitch_um;
    let text = format!(
        "Each panel: one lens (row, column; its number where the lenses form no grid); within it the image of a point \
            source at {} × {} positions across the field, cut out \
         at its chief ray, {window} × {window} pixels ({} µm on the sensor). All panels share one square-root scale, \
         so \
         vignetting is visible.",
        rows.len(),
        cols.len(),
        number(window as f64 * um)
    );
    let body = html! {
        div.lenses style={ "grid-template-columns:repeat(" (tile_columns(&instrument.manifest.array)) ",1fr)" } {
            @for p in panels { (p) }
        }
        (scale.bar("DN for a unit source"))
    };
    Ok(numbers.figure("Point-spread functions by lens and field.", &text, body))
}

fn correlation(instrument: &Instrument, numbers: &mut Numbers) -> Result<Markup, ReportError> {
    let d = &instrument.diagnostics;
    if d.pcc.is_empty() {
        return Ok(html! {});
    }
    let map = bead_map(d.positions_px.view(), d.pcc.as_slice().unwrap_or(&[]));
    let object = &instrument.manifest.object;
    let scale = Scale::linear(0.0, 1.0, ColourMap::Viridis);
    let alt = "Map over the field of the correlation of each PSF with the one on the axis";
    let plate = html! {
        div.plate style="max-width:420px" {
            p.name { "a  PCC with the on-axis PSF" span { (map.nrows()) " × " (map.ncols()) " positions" } }
            (picture(map.view(), &scale, alt, &[])?)
            (scale.bar("PCC"))
        }
    };
    let centre = (object.rows as f64 - 1.0) / 2.0;
    let off = |i: usize| (f64::from(d.positions_px[[i, 0]]) - centre).abs();
    let nearest = (0..d.pcc.len()).map(off).fold(f64::INFINITY, f64::min);
    let mut points: Vec<[f64; 2]> = (0..d.pcc.len())
        .filter(|&i| off(i) < nearest + 0.5)
        .map(|i| {
            let x = (f64::from(d.positions_px[[i, 1]]) - (object.cols as f64 - 1.0) / 2.0) * object.pixel_um;
            [x, f64::from(d.pcc[i])]
        })
        .collect();
    points.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let chart = Chart {
        alt: "Correlation along the central line of the field".into(),
        x: Axis::linear("x in the object (µm)"),
        y: Axis::between("PCC", 0.0, 1.0),
        lines: vec![Line { label: "central profile".into(), points, colour: 1, marks: Marks::Dots }],
    };
    let text = "a, Pearson correlation of the PSFs at each position with those on the axis; b, profile along the \
        central line. Where \
                it falls, one PSF does not describe the instrument.";
    let body = html! { div.two { (plate) div.plate { p.name { "b  Central line" } (chart.render()?) } } };
    Ok(numbers.figure("Spatial variance.", text, body))
}

/// Values at scattered positions, on the grid of their distinct rows and columns; 0 where none was measured.
fn bead_map(positions_px: ArrayView2<'_, f32>, values: &[f32]) -> Array2<f32> {
    let distinct = |axis: usize| {
        let mut all: Vec<f32> = positions_px.column(axis).to_vec();
        all.sort_by(f32::total_cmp);
        all.dedup_by(|a, b| (*a - *b).abs() < 0.5);
        all
    };
    let (rows, cols) = (distinct(0), distinct(1));
    let nearest = |all: &[f32], v: f32| {
        (0..all.len()).min_by(|&a, &b| (all[a] - v).abs().total_cmp(&(all[b] - v).abs())).unwrap_or(0)
    };
    let mut map = Array2::zeros((rows.len().max(1), cols.len().max(1)));
    for (position, &value) in positions_px.rows().into_iter().zip(values) {
        map[[nearest(&rows, position[0]), nearest(&cols, position[1])]] = value;
    }
    map
}

fn rank(instrument: &Instrument, numbers: &mut Numbers) -> Result<Markup, ReportError> {
    let d = &instrument.diagnostics;
    if d.singular_values.is_empty() && d.error_by_rank.is_empty() {
        return Ok(html! {});
    }
    let rank = instrument.psf.basis.dim().1;
    let spectrum = Chart {
        alt: "Singular values of each lens, relative to its largest".into(),
        x: Axis::linear("Index"),
        y: Axis::log10("Singular value (relative)"),
        lines: d
            .singular_values
            .outer_iter()
            .map(|lens| Line {
                label: String::new(),
                points: lens
                    .iter()
                    .take(48)
                    .enumerate()
                    .map(|(i, v)| [i as f64 + 1.0, f64::from(v / lens[0])])
                    .collect(),
                colour: 1,
                marks: Marks::None,
            })
            .collect(),
    };
    let column = |c: usize| -> Vec<[f64; 2]> {
        d.error_by_rank.outer_iter().map(|r| [f64::from(r[0]), 100.0 * f64::from(r[c])]).collect()
    };
    let whole = d.whole_array_error.iter().enumerate().map(|(k, e)| [k as f64 + 1.0, 100.0 * f64::from(*e)]).collect();
    let floor: Vec<[f64; 2]> = column(0).into_iter().map(|p| [p[0], 100.0 * instrument.quality.noise_floor]).collect();
    let error = Chart {
        alt: "Error of the low-rank model against its rank".into(),
        x: Axis::linear("Rank K"),
        y: Axis::log10("NRMSE (%)"),
        lines: vec![
            Line { label: "fitted positions".into(), points: column(1), colour: 1, marks: Marks::Dots },
            Line {
                label: "held-out positions (checkerboard)".into(),
                points: column(2),
                colour: 2,
                marks: Marks::Dots,
            },
            Line { label: "all lenses decomposed together".into(), points: whole, colour: 3, marks: Marks::None },
            Line { label: "noise of the bead frames alone".into(), points: floor, colour: 5, marks: Marks::None },
        ],
    };
    let text = format!(
        "a, singular values of the windows of each lens (one line per lens). b, error of the model against its rank. \
            This \
         instrument has K = {rank}: {:.2} % on the scan, {:.2} % on held-out positions.{}",
        100.0 * instrument.quality.approximation_error,
        100.0 * instrument.quality.off_grid_error,
        match instrument.whole_array_rank() {
            Some(whole) => format!(
                " One decomposition of all lenses together needs {whole} terms for the same error on the \
                    scan."
            ),
            None => String::new(),
        }
    );
    let body = html! {
        div.two {
            div.plate { p.name { "a  Singular values" } (spectrum.render_without_legend()?) }
            div.plate { p.name { "b  Error against rank" } (error.render()?) }
        }
    };
    Ok(numbers.figure("Low-rank model.", &text, body))
}

/// The sensor: noise figures and, where flats were measured, the photon-transfer curve.
///
/// # Errors
/// The chart cannot be drawn.
pub fn noise(instrument: &Instrument, numbers: &mut Numbers) -> Result<Markup, ReportError> {
    let n = &instrument.noise;
    let pm = |value: f64, sigma: f64, unit: &str| {
        html! {
            (plus_minus(value, sigma)) " " (unit)
        }
    };
    let full_well = (n.saturation_dn - n.black_level_dn) / n.gain_dn_per_e;
    let rows = [
        ("Gain".to_string(), pm(n.gain_dn_per_e, n.gain_sigma, "DN/e⁻")),
        ("Read noise".into(), pm(n.read_noise_e, n.read_noise_sigma, "e⁻ rms")),
        ("Black level".into(), pm(n.black_level_dn, 0.0, "DN")),
        ("Saturation".into(), html! { (number(n.saturation_dn)) " DN (" (number(full_well)) " e⁻ above black)" }),
    ];
    let source = [n.sources.black_level, n.sources.gain, n.sources.read_noise];
    let text = match source.iter().all(|s| *s == Source::Measured) {
        true => "Measured from darks and flats; ± one standard error.",
        false => "± one standard error. Figures that the session cannot determine are nominal or inferred.",
    };
    let table = numbers.table("Sensor.", text, pairs(&rows));
    let transfer = &instrument.diagnostics.photon_transfer;
    if transfer.is_empty() {
        return Ok(html! { div style="max-width:640px" { (table) } });
    }
    let column = |c: usize| transfer.outer_iter().map(|r| [f64::from(r[0]), f64::from(r[c])]).collect();
    let chart = Chart {
        alt: "Temporal variance of flats against their mean, with the fitted line".into(),
        x: Axis::linear("Mean above black (DN)"),
        y: Axis::linear("Variance (DN²)"),
        lines: vec![
            Line { label: "fit".into(), points: column(2), colour: 5, marks: Marks::None },
            Line { label: "measured".into(), points: column(1), colour: 1, marks: Marks::Dots },
        ],
    };
    let text = "Temporal variance of the flats against their mean signal. The slope is the gain; the intercept is the \
        variance of read \
                noise and rounding.";
    let figure = numbers.figure("Photon transfer.", text, chart.render()?);
    Ok(html! { div.two { (figure) (table) } })
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn scattered_values_find_their_places() {
        let positions = array![[10.0f32, 0.0], [0.0, 5.0], [10.1, 5.0], [0.0, 0.1]];
        let map = bead_map(positions.view(), &[1.0, 2.0, 3.0, 4.0]);
        assert_eq!(map, array![[4.0, 2.0], [1.0, 3.0]]);
    }
}
