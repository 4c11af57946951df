//! Pictures: arrays mapped to colours and embedded in the page as PNG.

use super::colour::{ABSENT_LEVEL, ColourMap};
use super::error::ReportError;
use base64::Engine;
use maud::{Markup, PreEscaped, html};
use ndarray::ArrayView2;

/// How values become colours.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// Value of the darkest colour.
    pub low: f64,
    /// Value of the brightest colour.
    pub high: f64,
    /// How values in between map to colours.
    pub tone: Tone,
    /// The colours.
    pub map: ColourMap,
}

/// How values map to colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tone {
    /// Linearly.
    Linear,
    /// By their square root, which makes faint wings visible.
    SquareRoot,
}

impl Scale {
    /// A linear scale from `low` to `high`.
    pub fn linear(low: f64, high: f64, map: ColourMap) -> Self {
        Self { low, high, tone: Tone::Linear, map }
    }

    fn level(&self, value: f32) -> u8 {
        let t = ((f64::from(value) - self.low) / (self.high - self.low)).clamp(0.0, 1.0);
        let t = match self.tone {
            Tone::Linear => t,
            Tone::SquareRoot => t.sqrt(),
        };
        let levels = f64::from(self.map.levels());
        match t.is_finite() {
            true => (levels * t).round() as u8,
            false if self.map == ColourMap::Diverging => ABSENT_LEVEL,
            // An empty range or a non-finite value is shown dark.
            false => 0,
        }
    }

    /// A colour bar with its ends and its unit.
    pub fn bar(&self, unit: &str) -> Markup {
        let tone = match self.tone {
            Tone::Linear => "",
            Tone::SquareRoot => ", square-root scale",
        };
        html! {
            div.scale role="img" aria-label={ "Colour scale from " (number(self.low)) " to " (number(self.high)) " "
                (unit) } {
                span { (number(self.low).replace('-', "−")) }
                i style={ "background:" (self.map.css()) } {}
                span { (number(self.high)) " " (unit) (tone) }
            }
        }
    }
}

/// A number with three significant figures, without trailing zeros.
pub fn number(value: f64) -> String {
    match value.abs() {
        0.0 => "0".into(),
        a if !(1e-3..1e5).contains(&a) => scientific(value),
        a => {
            let decimals = (2 - a.log10().floor() as i32).clamp(0, 5) as usize;
            let text = format!("{value:.decimals$}");
            if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').into() } else { text }
        }
    }
}

/// A number as a power of ten: `5.8 × 10⁶`, `10⁻⁴`.
fn scientific(value: f64) -> String {
    if !value.is_finite() {
        return value.to_string();
    }
    let text = format!("{value:.1e}");
    let Some((factor, power)) = text.split_once('e') else { return text };
    let power = raised(power.parse().unwrap_or(0));
    match factor.trim_end_matches('0').trim_end_matches('.') {
        "1" => format!("10{power}"),
        "-1" => format!("-10{power}"),
        factor => format!("{factor} × 10{power}"),
    }
}

/// An exponent in small raised digits.
pub fn raised(power: i32) -> String {
    let digit = |c: char| match c {
        '-' => '⁻',
        '1' => '¹',
        '2' => '²',
        '3' => '³',
        c => c.to_digit(10).and_then(|d| char::from_u32(0x2070 + d)).unwrap_or(c),
    };
    power.to_string().chars().map(digit).collect()
}

/// A `data:` URI with the array [rows, cols] as an 8-bit PNG with a palette, one pixel per value.
///
/// # Errors
/// The array has no pixel.
pub fn data_uri(image: ArrayView2<'_, f32>, scale: &Scale) -> Result<String, ReportError> {
    let levels: Vec<u8> = image.iter().map(|&v| scale.level(v)).collect();
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, image.ncols() as u32, image.nrows() as u32);
    encoder.set_color(png::ColorType::Indexed);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_palette(scale.map.palette());
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&levels)?;
    writer.finish()?;
    Ok(format!("data:image/png;base64,{}", base64::engine::general_purpose::STANDARD.encode(bytes)))
}

/// A mark drawn over a picture; lengths are fractions of its width and height.
#[derive(Clone, Debug, PartialEq)]
pub enum Mark {
    /// A scale bar: fraction of the width, and its label.
    Bar(f64, String),
    /// A box round a detail: left, top, width, height; and the letter of the detail.
    Box([f64; 4], &'static str),
    /// A letter in the upper left corner.
    Letter(&'static str),
}

/// A picture with its marks.
///
/// # Errors
/// The array has no pixel.
pub fn picture(image: ArrayView2<'_, f32>, scale: &Scale, alt: &str, marks: &[Mark]) -> Result<Markup, ReportError> {
    let uri = data_uri(image, scale)?;
    Ok(html! {
        div.picture style={ "aspect-ratio:" (image.ncols()) "/" (image.nrows()) } {
            img src=(PreEscaped(uri)) alt=(alt) width=(image.ncols()) height=(image.nrows());
            @for mark in marks { (overlay(mark)) }
        }
    })
}

fn overlay(mark: &Mark) -> Markup {
    let percent = |v: f64| format!("{:.2}%", 100.0 * v);
    html! {
        @match mark {
            Mark::Bar(width, label) => span.bar aria-hidden="true" style={ "width:" (percent(*width)) } { b { (label)
                } },
            Mark::Box([x, y, w, h], letter) => span.box aria-hidden="true" style={
                "left:" (percent(*x)) ";top:" (percent(*y)) ";width:" (percent(*w)) ";height:" (percent(*h))
            } { b { (letter) } },
            Mark::Letter(letter) => span.letter aria-hidden="true" { (letter) },
        }
    }
}

/// A scale bar of a round length, about a fifth of a field of `field_um`.
pub fn scale_bar(field_um: f64) -> Mark {
    let target = field_um / 5.0;
    let decade = 10f64.powf(target.log10().floor());
    let length = [5.0, 2.0, 1.0].into_iter().map(|m| m * decade).find(|l| *l <= target).unwrap_or(decade);
    let label = if length >= 1000.0 { format!("{} mm", length / 1000.0) } else { format!("{length} µm") };
    Mark::Bar(length / field_um, label)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use ndarray::array;

    #[test]
    fn a_picture_decodes_to_its_levels() {
        let scale = Scale::linear(0.0, 2.0, ColourMap::Grey);
        let uri = data_uri(array![[0.0f32, 1.0, 2.0], [-1.0, 3.0, f32::NAN]].view(), &scale).unwrap();
        let bytes = base64::engine::general_purpose::STANDARD.decode(uri.split(',').nth(1).unwrap()).unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        let mut levels = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut levels).unwrap();
        assert_eq!(levels, [0, 128, 255, 0, 255, 0]);
    }

    #[test]
    fn scale_bars_are_round() {
        assert_eq!(scale_bar(268.8), Mark::Bar(50.0 / 268.8, "50 µm".into()));
        assert_eq!(scale_bar(7000.0), Mark::Bar(1000.0 / 7000.0, "1 mm".into()));
    }

    #[test]
    fn numbers_are_short() {
        assert_eq!(
            [0.0, 1.0, 0.0123456, 4095.0, 12.3456, 1e-7, -2.5e6].map(number),
            ["0", "1", "0.0123", "4095", "12.3", "10⁻⁷", "-2.5 × 10⁶"]
        );
    }
}
