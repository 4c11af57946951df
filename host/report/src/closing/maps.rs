//! Residual maps: measured frame, residual before and after, in standard deviations.

use super::super::ReportError;
use super::super::look::{Look, RESIDUAL_LIMIT, residuals};
use super::super::page::Numbers;
use super::super::picture::picture;
use super::Asked;
use maud::{Markup, html};
use ndarray::{Array2, Array3, ArrayView2, Axis, s};
use ommatidia_closing::Account;

/// Side of the mean that shows structure below the noise of single pixels, pixels.
const SIDE: usize = 5;
/// Longest side of a map, pixels; larger sensors are binned.
const WIDEST: usize = 480;

/// The maps of the frames in the account.
///
/// # Errors
/// A picture cannot be encoded.
pub fn maps(account: &Account, asked: Asked, numbers: &mut Numbers) -> Result<Markup, ReportError> {
    if account.measured_dn.iter().len() == 0 {
        return Ok(html! {});
    }
    // Held-out frames first, then those with the largest improvement; the first is shown large.
    let square = |all: &Array3<f32>, i: usize| rms(all.index_axis(Axis(0), i)).powi(2);
    let rank = |i: &usize| {
        let unseen = account.closing.held_out_frames.contains(&account.frames[*i]);
        (unseen, square(&account.before, *i) - square(&account.after, *i))
    };
    let mut order: Vec<(usize, (bool, f64))> = (0..account.frames.len()).map(|i| (i, rank(&i))).collect();
    order.sort_by(|(_, a), (_, b)| b.0.cmp(&a.0).then(b.1.total_cmp(&a.1)));
    let figures = order
        .into_iter()
        .enumerate()
        .map(|(n, (i, _))| frame(account, asked, i, n == 0, numbers))
        .collect::<Result<Vec<_>, _>>()?;
    Ok(html! { @for f in figures { (f) } })
}

fn frame(account: &Account, asked: Asked, i: usize, first: bool, numbers: &mut Numbers) -> Result<Markup, ReportError> {
    let number = account.frames[i];
    let unseen = account.closing.held_out_frames.contains(&number);
    let measured = account.measured_dn.index_axis(Axis(0), i);
    let (before, after) = (account.before.index_axis(Axis(0), i), account.after.index_axis(Axis(0), i));
    let factor = measured.nrows().max(measured.ncols()).div_ceil(WIDEST);
    let grey = Look::Raw.scale(measured);
    let plain = binned(&measured.to_owned(), factor, 1.0);
    let map = |name: &str, note: String, image: Array2<f32>| -> Result<Markup, ReportError> {
        let alt = format!("{name}, frame {number}");
        Ok(html! { div.plate { p.name { (name) span { (note) } } (picture(image.view(), &residuals(), &alt, &[])?) } })
    };
    let pixels = |r: ArrayView2<'_, f32>| binned(&absent(r), factor, factor as f32);
    let smooth = |r: ArrayView2<'_, f32>| binned(&smoothed(r), factor, factor as f32);
    let scatter = |r: ArrayView2<'_, f32>| format!("rms {:.2}", rms(r));
    let raw = html! { div.plate { p.name { "Measured" span { (measured.nrows()) " × " (measured.ncols()) } }
    (picture(plain.view(), &grey, &format!("Measured frame {number}"), &[])?) } };
    let mut plates = vec![raw];
    match asked {
        Asked::Close => {
            plates.push(map("Residual before", "mean of 5 × 5".into(), smooth(before))?);
            plates.push(map("Residual after", "mean of 5 × 5".into(), smooth(after))?);
            plates.push(map("Before, pixel by pixel", scatter(before), pixels(before))?);
            plates.push(map("After, pixel by pixel", scatter(after), pixels(after))?);
        }
        Asked::Residual => {
            plates.push(map("Residual", "mean of 5 × 5".into(), smooth(before))?);
            plates.push(map("Pixel by pixel", scatter(before), pixels(before))?);
        }
    }
    let bars =
        html! { (grey.bar("DN")) (residuals().bar("σ")) div.scale { i.absent {} "no data (defect, saturated)" } };
    let large = first && asked == Asked::Close;
    if large {
        // The scales and the caption fit below the measured frame.
        plates.insert(3, html! { div.plate.key { (bars) p { (caption(factor)) } } });
    }
    let class = if large { "plates first" } else { "plates" };
    let columns = if asked == Asked::Close { 5 } else { 3 };
    let body = html! {
        div class=(class) style=[(!large).then(|| format!("grid-template-columns:repeat({columns},1fr)"))] {
            @for plate in plates { (plate) }
        }
        @if !large { div.bars { (bars) } }
    };
    let text = match (first, large) {
        (true, false) => caption(factor),
        (true, true) => "Below: the same, pixel by pixel.".into(),
        _ => "As in the preceding figure.".into(),
    };
    let held = if unseen { ", held out of every fit" } else { "" };
    Ok(numbers.figure(&format!("Frame {number}{held}."), &text, body))
}

fn caption(factor: usize) -> String {
    let bins = match factor {
        0 | 1 => String::new(),
        f => format!(" The sensor is large: each point is the sum of {f} × {f} pixels divided by {f}."),
    };
    format!(
        "Measured minus predicted in standard deviations of the noise model: red where the frame is brighter than \
         predicted, blue where it is darker; all maps from −{RESIDUAL_LIMIT} to {RESIDUAL_LIMIT}. A single pixel is \
         mostly noise. The mean of 5 × 5 pixels times 5 has the same scatter if the model is right, and shows weaker \
         structure.{bins}"
    )
}

/// Replaces pixels without data by NaN.
fn absent(r: ArrayView2<'_, f32>) -> Array2<f32> {
    r.mapv(|v| if v == 0.0 { f32::NAN } else { v })
}

/// Mean over a square, pixels without data left out, times the square root of their number: variance one for noise.
pub fn smoothed(r: ArrayView2<'_, f32>) -> Array2<f32> {
    let (rows, cols) = r.dim();
    let reach = SIDE / 2;
    Array2::from_shape_fn((rows, cols), |(i, j)| {
        let window = r.slice(s![
            i.saturating_sub(reach)..(i + reach + 1).min(rows),
            j.saturating_sub(reach)..(j + reach + 1).min(cols)
        ]);
        let used = window.iter().filter(|v| **v != 0.0);
        let (sum, n) = used.fold((0.0f32, 0usize), |(s, n), v| (s + v, n + 1));
        // Most of the square must have data.
        if 2 * n >= window.len() { sum / (n as f32).sqrt() } else { f32::NAN }
    })
}

/// Means of squares of `factor` pixels, times `gain`.
fn binned(image: &Array2<f32>, factor: usize, gain: f32) -> Array2<f32> {
    if factor <= 1 {
        return image.clone();
    }
    let (rows, cols) = image.dim();
    Array2::from_shape_fn((rows.div_ceil(factor), cols.div_ceil(factor)), |(i, j)| {
        let span = |k: usize, n: usize| factor * k..(factor * (k + 1)).min(n);
        let cell = image.slice(s![span(i, rows), span(j, cols)]);
        let used = cell.iter().filter(|v| v.is_finite());
        let (sum, n) = used.fold((0.0f32, 0usize), |(s, n), v| (s + v, n + 1));
        if n > 0 { gain * sum / n as f32 } else { f32::NAN }
    })
}

/// Root mean square of the pixels with data.
pub fn rms(r: ArrayView2<'_, f32>) -> f64 {
    let used = r.iter().filter(|v| **v != 0.0 && v.is_finite());
    let (sum, n) = used.fold((0.0, 0usize), |(s, n), v| (s + f64::from(v * v), n + 1));
    (sum / n.max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_keep_the_scatter_of_noise_and_skip_pixels_without_data() {
        let mut r = Array2::<f32>::ones((9, 9));
        assert_eq!(smoothed(r.view())[[4, 4]], 5.0);
        r[[4, 4]] = 0.0;
        assert!((smoothed(r.view())[[4, 4]] - 24f32.sqrt()).abs() < 1e-5);
        r.slice_mut(s![.., ..5]).fill(0.0);
        assert!(smoothed(r.view())[[4, 0]].is_nan() && smoothed(r.view())[[4, 8]] > 3.0);
        assert!((rms(r.view()) - 1.0).abs() < 1e-9 && absent(r.view())[[0, 0]].is_nan());
    }

    #[test]
    fn large_sensors_are_binned() {
        let image = Array2::from_shape_fn((5, 4), |(r, _)| if r == 0 { f32::NAN } else { 2.0 });
        let small = binned(&image, 2, 2.0);
        assert_eq!((small.dim(), small[[0, 0]], small[[2, 1]]), ((3, 2), 4.0, 4.0));
    }
}
