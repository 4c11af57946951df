//! Reconstructions of specimens that nobody knows, with the instrument as it was and as it was closed.

use super::super::ReportError;
use super::super::colour::ColourMap;
use super::super::look::Look;
use super::super::page::Numbers;
use super::super::picture::{Scale, picture, scale_bar};
use super::Asked;
use maud::{Markup, html};
use ndarray::{ArrayView2, Axis};
use ommatidia_closing::{Account, SpecimenMaps};
use ommatidia_model::instrument::Instrument;

/// One row of pictures for each frame with an estimated specimen; empty where there is none. The instrument gives the
/// scale bar, if it is among the inputs.
///
/// # Errors
/// A picture cannot be encoded.
pub fn specimens(
    account: &Account,
    asked: Asked,
    instrument: Option<&Instrument>,
    numbers: &mut Numbers,
) -> Result<Markup, ReportError> {
    let Some(maps) = &account.specimens else { return Ok(html! {}) };
    let bar = instrument.map(|i| scale_bar(i.manifest.object.pixel_um * i.manifest.object.cols as f64));
    let rows = (0..maps.frames.len()).map(|i| row(maps, (asked, i), bar.as_slice())).collect::<Result<Vec<_>, _>>()?;
    let body = html! { @for row in rows { (row) } };
    let text = match asked {
        Asked::Close => {
            "Each specimen is estimated from its own frame with the PSFs of all lenses: with the instrument as it \
             was, and with the effects that were added. Both have one colour scale. The third picture is after minus \
             before, from minus to plus a quarter of that scale. A displacement or a blur common to all \
             lenses would be in both."
        }
        Asked::Residual => {
            "Each specimen is estimated from its own frame with the PSFs of all lenses. A displacement or a blur \
             common to all lenses would be in the estimate."
        }
    };
    Ok(numbers.figure("Specimens as the instrument shows them.", text, body))
}

fn row(
    maps: &SpecimenMaps,
    (asked, i): (Asked, usize),
    bar: &[super::super::picture::Mark],
) -> Result<Markup, ReportError> {
    let number = maps.frames[i];
    let [before, after] = [&maps.before, &maps.after].map(|m| m.index_axis(Axis(0), i));
    let light = Look::Light.scale(after);
    let plate = |name: &str, image: ArrayView2<'_, f32>, scale: &Scale| -> Result<Markup, ReportError> {
        let alt = format!("{name}, frame {number}");
        Ok(html! { div.plate { p.name { (name) span { "frame " (number) } } (picture(image, scale, &alt, bar)?) } })
    };
    let change = &after - &before;
    let most = light.high / 4.0;
    let both = Scale::linear(-most, most, ColourMap::Diverging);
    let plates = match asked {
        Asked::Residual => vec![plate("Specimen", before, &light)?],
        Asked::Close => vec![
            plate("Before", before, &light)?,
            plate("After", after, &light)?,
            plate("Difference", change.view(), &both)?,
        ],
    };
    Ok(html! {
        div.plates style="grid-template-columns:repeat(3,1fr)" { @for plate in plates { (plate) } }
        div.bars { (light.bar("light")) @if asked == Asked::Close { (both.bar("light")) } }
    })
}
