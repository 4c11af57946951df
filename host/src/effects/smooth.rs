//! Blurs shared by several effects.

use ndarray::{Array2, Axis, Zip, s};

/// Gaussian blur of standard deviation `sigma_px`, cut off at 4 sigma; the image is dark outside.
pub(super) fn gaussian_blur(image: &Array2<f32>, sigma_px: f64) -> Array2<f32> {
    let taps = gaussian_taps(sigma_px);
    let across = blur_rows(image, &taps);
    let turned = blur_rows(&across.t().as_standard_layout().into_owned(), &taps);
    turned.t().as_standard_layout().into_owned()
}

/// One half of the symmetric kernel, centre first; the whole kernel sums to 1.
fn gaussian_taps(sigma_px: f64) -> Vec<f32> {
    let reach = (4.0 * sigma_px).ceil() as usize;
    let raw: Vec<f64> = (0..=reach).map(|i| (-0.5 * (i as f64 / sigma_px).powi(2)).exp()).collect();
    let sum = raw[0] + 2.0 * raw[1..].iter().sum::<f64>();
    raw.iter().map(|v| (v / sum) as f32).collect()
}

/// Blurs along the columns of each row.
fn blur_rows(image: &Array2<f32>, taps: &[f32]) -> Array2<f32> {
    let n = image.ncols();
    let mut out = image.mapv(|v| v * taps[0]);
    Zip::from(out.axis_iter_mut(Axis(0))).and(image.axis_iter(Axis(0))).par_for_each(|mut to, from| {
        for (i, tap) in taps.iter().enumerate().skip(1).take_while(|(i, _)| *i < n) {
            to.slice_mut(s![i..]).scaled_add(*tap, &from.slice(s![..n - i]));
            to.slice_mut(s![..n - i]).scaled_add(*tap, &from.slice(s![i..]));
        }
    });
    out
}

/// Diffusion of variance `variance_px2` along each axis in explicit steps. No light leaves the image.
pub(super) fn diffuse(image: &mut Array2<f32>, variance_px2: f64) {
    // A step of variance v moves v/2 to each neighbour; steps along two axes are stable up to v = 1/2.
    let steps = (variance_px2 / 0.25).ceil().max(1.0);
    for _ in 0..steps as usize {
        couple(image, (variance_px2 / steps / 2.0) as f32);
    }
}

/// `v -> v (1 - 4 a) + a (up + down + left + right)`; pixels at the edge keep the share of missing neighbours.
pub(super) fn couple(image: &mut Array2<f32>, a: f32) {
    let from = image.clone();
    let (rows, cols) = image.dim();
    let mut exchange = |to: [std::ops::Range<usize>; 2], of: [std::ops::Range<usize>; 2]| {
        let mut target = image.slice_mut(s![to[0].clone(), to[1].clone()]);
        let (here, there) =
            (from.slice(s![to[0].clone(), to[1].clone()]), from.slice(s![of[0].clone(), of[1].clone()]));
        Zip::from(&mut target).and(&here).and(&there).for_each(|t, h, n| *t += a * (n - h));
    };
    if rows > 1 {
        exchange([1..rows, 0..cols], [0..rows - 1, 0..cols]);
        exchange([0..rows - 1, 0..cols], [1..rows, 0..cols]);
    }
    if cols > 1 {
        exchange([0..rows, 1..cols], [0..rows, 0..cols - 1]);
        exchange([0..rows, 0..cols - 1], [0..rows, 1..cols]);
    }
}

/// Gaussian blur of standard deviation `sigma_px`, normalised by the kernel inside the image, so that an even image
/// stays even up to its edges. [rows, cols] in and out.
pub fn blur_within(image: &Array2<f32>, sigma_px: f64) -> Array2<f32> {
    gaussian_blur(image, sigma_px) / gaussian_blur(&Array2::ones(image.dim()), sigma_px)
}

/// Light of a pixel after a change: light that was not negative is clamped at zero.
///
/// Predicted light can be slightly negative because of errors of the calibrated PSFs. There it is not clamped: clamping
/// would remove part of these errors even at the smallest strength, and tests would then find the effect in any
/// session.
pub(super) fn changed(light: f32, change: f32) -> f32 {
    let after = light + change;
    if light < 0.0 { after } else { after.max(0.0) }
}

/// Blur of variances (row, col, covariance), px^2, in explicit steps of second differences. No light is lost, and light
/// that was not negative stays so.
pub(super) fn second_differences(image: &mut Array2<f32>, [row, col, cov]: [f64; 3]) {
    let steps = ((row.abs() + col.abs() + 2.0 * cov.abs()) / 0.5).ceil().max(1.0);
    let part = |v: f64| (v / steps) as f32;
    let (row, col, cov) = (part(row) / 2.0, part(col) / 2.0, part(cov) / 4.0);
    let (rows, cols) = image.dim();
    for _ in 0..steps as usize {
        let from = image.clone();
        for r in 0..rows {
            // The edge pixels are repeated outside: no light flows over the edge.
            let (up, down) = (from.row(r.saturating_sub(1)), from.row((r + 1).min(rows - 1)));
            let here = from.row(r);
            for c in 0..cols {
                let (left, right) = (c.saturating_sub(1), (c + 1).min(cols - 1));
                let change = row * (up[c] + down[c] - 2.0 * here[c])
                    + col * (here[left] + here[right] - 2.0 * here[c])
                    + cov * (up[left] + down[right] - up[right] - down[left]);
                image[[r, c]] = changed(here[c], change);
            }
        }
    }
}
