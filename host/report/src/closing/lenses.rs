//! Residual maps cut out around each lens, which separate errors of one lens from errors common to all.

use super::super::ReportError;
use super::super::look::{residuals, tile_columns};
use super::super::page::Numbers;
use super::super::picture::picture;
use super::Asked;
use super::maps::smoothed;
use maud::{Markup, html};
use ndarray::{Array2, Array3, ArrayView2, s};
use ommatidia_closing::Account;
use ommatidia_model::instrument::Instrument;

/// The maps, one per lens. Empty if the array has one lens, or if instrument and session have different sensors.
///
/// # Errors
/// A picture cannot be encoded.
pub fn maps(
    account: &Account,
    asked: Asked,
    instrument: &Instrument,
    numbers: &mut Numbers,
) -> Result<Markup, ReportError> {
    let anchors = &instrument.geometry.anchors_px;
    let array = &instrument.manifest.array;
    let (frames, rows, cols) = account.before.dim();
    let sensor = &instrument.manifest.sensor;
    if anchors.len() < 2 || frames == 0 || [rows, cols] != [sensor.rows, sensor.cols] || array.pitch_px < 4.0 {
        return Ok(html! {});
    }
    let plate = |name: &str, residual: &Array3<f32>| -> Result<Markup, ReportError> {
        let common = common(residual);
        let smooth = smoothed(common.view());
        let tiles = anchors.iter().enumerate().map(|(l, anchor)| {
            let lens = array.lens_name(l);
            let alt = format!("{name}, lens {lens}");
            let dead = instrument.geometry.dead.get(l).copied().unwrap_or(false);
            let crop = |image: ArrayView2<'_, f32>| cut(image, *anchor, array.pitch_px);
            let label = format!("{lens}{}", if dead { " (dead)" } else { "" });
            Ok::<_, ReportError>(html! {
                div.plate {
                    p.name { (label) span { "rms " (format!("{:.2}", super::maps::rms(crop(common.view()).view()))) } }
                    (picture(crop(smooth.view()).view(), &residuals(), &alt, &[])?)
                }
            })
        });
        let tiles = tiles.collect::<Result<Vec<_>, _>>()?;
        Ok(html! {
            div { p.half { (name) }
                div.tiles style={ "grid-template-columns:repeat(" (tile_columns(array)) ",1fr)" } {
                    @for t in tiles { (t) }
                } }
        })
    };
    let before = plate(if asked == Asked::Close { "Before" } else { "Residual" }, &account.before)?;
    let after = if asked == Asked::Close { Some(plate("After", &account.after)?) } else { None };
    let body = html! { div.halves { (before) @if let Some(a) = after { (a) } } (residuals().bar("σ")) };
    let text = format!(
        "Sections of the sensor around each lens (row, column; its number where the lenses form no grid), one pitch of \
         {:.0} pixels wide. The residuals of the {} above are averaged and multiplied by the square root of their \
         number, then smoothed over 5 × 5 pixels as above. Errors of one lens show in one tile, errors common to the \
         optics in all. rms: of the average, pixel by pixel; 1 for noise.",
        array.pitch_px,
        if frames == 1 { "frame".to_string() } else { format!("{frames} frames") }
    );
    Ok(numbers.figure("Lens by lens.", &text, body))
}

/// Mean of the frames times the square root of their number, which has variance one for noise; 0 where no frame has
/// data.
fn common(residual: &Array3<f32>) -> Array2<f32> {
    let (frames, rows, cols) = residual.dim();
    Array2::from_shape_fn((rows, cols), |(r, c)| {
        let used = (0..frames).map(|f| residual[[f, r, c]]).filter(|v| *v != 0.0);
        let (sum, n) = used.fold((0.0f32, 0usize), |(s, n), v| (s + v, n + 1));
        if n > 0 { sum / (n as f32).sqrt() } else { 0.0 }
    })
}

/// A square of one pitch around an anchor; NaN outside the sensor.
fn cut(image: ArrayView2<'_, f32>, anchor: [f64; 2], pitch: f64) -> Array2<f32> {
    let side = pitch.round().max(1.0) as i64;
    let start = anchor.map(|a| a.round() as i64 - side / 2);
    let mut out = Array2::from_elem((side as usize, side as usize), f32::NAN);
    let (rows, cols) = image.dim();
    let within = |start: i64, n: usize| (start.max(0).min(n as i64), (start + side).max(0).min(n as i64));
    let ([r0, r1], [c0, c1]) = (<[i64; 2]>::from(within(start[0], rows)), <[i64; 2]>::from(within(start[1], cols)));
    let to = |v: i64, s: i64| (v - s) as usize;
    let source = image.slice(s![r0 as usize..r1 as usize, c0 as usize..c1 as usize]);
    if !source.is_empty() {
        let place = s![to(r0, start[0])..to(r1, start[0]), to(c0, start[1])..to(c1, start[1])];
        out.slice_mut(place).assign(&source);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_reach_over_the_edge() {
        let image = Array2::from_shape_fn((10, 10), |(r, c)| (10 * r + c) as f32);
        let tile = cut(image.view(), [0.0, 9.0], 4.0);
        assert_eq!(tile.dim(), (4, 4));
        assert!(tile[[0, 0]].is_nan() && tile[[2, 3]].is_nan());
        assert_eq!((tile[[2, 2]], tile[[3, 0]]), (9.0, 17.0));
        assert!(cut(image.view(), [-50.0, 300.0], 4.0).iter().all(|v| v.is_nan()));
    }
}
