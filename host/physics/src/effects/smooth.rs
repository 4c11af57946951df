//! Blurs shared by several effects.

use ndarray::linalg::general_mat_mul;
use ndarray::parallel::prelude::*;
use ndarray::{Array2, ArrayView2, Axis, Zip, s};
use puruspe::In;
use std::sync::LazyLock;

/// Gaussian blur of standard deviation `sigma_px`, cut off at 4 sigma; the image is dark outside.
pub(super) fn gaussian_blur(image: &Array2<f32>, sigma_px: f64) -> Array2<f32> {
    let taps = gaussian_taps(sigma_px);
    let along_columns = blur_columns(image.view(), &taps);
    // The transpose is a view: a product of matrices reads either order.
    blur_columns(along_columns.t(), &taps).reversed_axes().as_standard_layout().into_owned()
}

/// One half of the symmetric kernel, centre first; the whole kernel sums to 1.
fn gaussian_taps(sigma_px: f64) -> Vec<f32> {
    let reach = (4.0 * sigma_px).ceil() as usize;
    let raw: Vec<f64> = (0..=reach).map(|i| (-0.5 * (i as f64 / sigma_px).powi(2)).exp()).collect();
    let sum = raw[0] + 2.0 * raw[1..].iter().sum::<f64>();
    raw.iter().map(|v| (v / sum) as f32).collect()
}

/// Rows that are blurred by one product.
const BLOCK: std::ops::RangeInclusive<usize> = 32..=256;

/// Blurs along each column: a block of rows is the product of a band matrix, which is the same for all blocks, and of
/// the rows within reach. It does up to three times the work of a sum over the taps, in a fraction of its time.
fn blur_columns(image: ArrayView2<'_, f32>, taps: &[f32]) -> Array2<f32> {
    let (rows, cols) = image.dim();
    let reach = (taps.len() - 1).min(rows.saturating_sub(1));
    let block = reach.clamp(*BLOCK.start(), *BLOCK.end());
    let tap = |(i, j): (usize, usize)| taps.get((i + reach).abs_diff(j)).copied().unwrap_or(0.0);
    let band = Array2::from_shape_fn((block, block + 2 * reach), tap);
    let mut out = Array2::zeros((rows, cols));
    out.axis_chunks_iter_mut(Axis(0), block).into_par_iter().enumerate().for_each(|(n, mut to)| {
        let first = n * block;
        let from = first.saturating_sub(reach)..(first + to.nrows() + reach).min(rows);
        let part = band.slice(s![..to.nrows(), from.start + reach - first..from.end + reach - first]);
        general_mat_mul(1.0, &part, &image.slice(s![from, ..]), 0.0, &mut to);
    });
    out
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

/// Most variance of one step of [`spread`], px^2: its kernel holds what it moves.
const STEP_PX2: f64 = 1.0;
/// Taps of its kernel on either side of the middle.
const REACH: usize = 10;
/// Differences that stand for the second derivative, and the shape of the Kaiser window on them.
const DIFFERENCES: usize = 6;
const WINDOW: f64 = 7.0;
/// Frequencies at which transfer functions are summed.
const FREQUENCIES: usize = 256;

/// Gaussian blur with variances (row, col, covariance), px^2; negative ones sharpen. Light is kept, but for what a
/// covariance carries over an edge. Of an image that is sharper than pixels can show, a hundredth of the light of a
/// pixel may be missing two pixels beside it.
///
/// The transfer function is `exp(-(row L(u) + col L(w)) / 2)` (and the like along the diagonals), where L(u) is u^2 to
/// 1e-3 up to 0.7 of the Nyquist frequency. Second differences of neighbours have `2 - 2 cos u` in place of u^2 and
/// fall short of it by a third at 0.7: the light of a focus of 0.9 px that is blurred by a little differs from theirs
/// by 24 % of the change, and by 3 % from this.
pub(super) fn spread(image: &mut Array2<f32>, [row, col, cov]: [f64; 3]) {
    let steps = ((row.abs() + col.abs() + 2.0 * cov.abs()) / STEP_PX2).ceil().max(1.0);
    // 2 cov u w = cov (u + w)^2 / 2 - cov (u - w)^2 / 2: along one diagonal it spreads, along the other it sharpens.
    let lines = [([1, 0], row), ([0, 1], col), ([1, 1], cov / 2.0), ([1, -1], -cov / 2.0)];
    let lines: Vec<_> =
        lines.into_iter().filter(|(_, v)| *v != 0.0).map(|(way, v)| (way, spread_taps(v / steps))).collect();
    for _ in 0..steps as usize {
        for (way, taps) in &lines {
            *image = along(image, *way, taps);
        }
    }
}

/// The frequencies u, by the midpoint rule from 0 to pi, each with L(u): `2 sum_n c_n (1 - cos n u)`, where c_n is
/// `2 (-1)^(n+1) / n^2` (the band-limited second derivative) under a window, scaled so that L is u^2 at low
/// frequencies.
static SYMBOL: LazyLock<Vec<[f64; 2]>> = LazyLock::new(|| {
    let window = |n: f64| In(0, WINDOW * (1.0 - (n / (DIFFERENCES + 1) as f64).powi(2)).sqrt()) / In(0, WINDOW);
    let weight = |n: usize| (if n % 2 == 1 { 2.0 } else { -2.0 }) / (n * n) as f64 * window(n as f64);
    let scale = (1..=DIFFERENCES).map(|n| weight(n) * (n * n) as f64).sum::<f64>();
    let at = |i: usize| {
        let u = (i as f64 + 0.5) * std::f64::consts::PI / FREQUENCIES as f64;
        let sum: f64 = (1..=DIFFERENCES).map(|n| weight(n) * (1.0 - (n as f64 * u).cos())).sum();
        [u, 2.0 * sum / scale]
    };
    (0..FREQUENCIES).map(at).collect()
});

/// Half of the kernel with the transfer function `exp(-v L(u) / 2)`, the middle first: the whole kernel sums to 1.
fn spread_taps(variance_px2: f64) -> Vec<f32> {
    let transfer: Vec<[f64; 2]> = SYMBOL.iter().map(|[u, l]| [*u, (-0.5 * variance_px2 * l).exp()]).collect();
    let tap = |n: usize| transfer.iter().map(|[u, t]| t * (n as f64 * u).cos()).sum::<f64>();
    let raw: Vec<f64> = (0..=REACH).map(tap).collect();
    let sum = raw[0] + 2.0 * raw[1..].iter().sum::<f64>();
    raw.iter().map(|v| (v / sum) as f32).collect()
}

/// An image under a symmetric kernel along a direction (rows, cols). Outside, the image is mirrored at its edges, so
/// that no light leaves it and an even image stays even.
fn along(image: &Array2<f32>, way: [isize; 2], taps: &[f32]) -> Array2<f32> {
    let (rows, cols) = image.dim();
    let reach = taps.len() - 1;
    if image.is_empty() {
        return image.clone();
    }
    let mirror = |i: usize, n: usize| {
        let j = (i as isize - reach as isize).rem_euclid(2 * n as isize) as usize;
        if j < n { j } else { 2 * n - 1 - j }
    };
    let wide =
        Array2::from_shape_fn((rows + 2 * reach, cols + 2 * reach), |(r, c)| image[[mirror(r, rows), mirror(c, cols)]]);
    let mut out = image.mapv(|v| v * taps[0]);
    for (n, tap) in (1..).zip(&taps[1..]) {
        for side in [-1, 1] {
            let [r, c] = way.map(|w| (reach as isize + side * n * w) as usize);
            out.scaled_add(*tap, &wide.slice(s![r..r + rows, c..c + cols]));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Variances (rows, cols) and covariance of an image's light, px^2.
    fn moments(image: &Array2<f32>) -> [f64; 3] {
        let light = f64::from(image.sum());
        let mean = |of: &dyn Fn(f64, f64) -> f64| -> f64 {
            image.indexed_iter().map(|((r, c), v)| f64::from(*v) * of(r as f64, c as f64)).sum::<f64>() / light
        };
        let [r, c] = [mean(&|r, _| r), mean(&|_, c| c)];
        [mean(&|y, _| (y - r).powi(2)), mean(&|_, x| (x - c).powi(2)), mean(&|y, x| (y - r) * (x - c))]
    }

    fn gaussian(variances: [f64; 3]) -> Array2<f32> {
        let [row, col, cov] = variances;
        let det = row * col - cov * cov;
        Array2::from_shape_fn((61, 57), |(r, c)| {
            let (y, x) = (r as f64 - 30.2, c as f64 - 27.9);
            let square = (col * y * y - 2.0 * cov * y * x + row * x * x) / det;
            ((-0.5 * square).exp() / det.sqrt()) as f32
        })
    }

    /// The sum over the taps, pixel by pixel, for images that are smaller than a block, and larger than several.
    #[test]
    fn a_blur_is_the_sum_over_its_taps() {
        for (rows, cols, sigma_px) in [(1, 9, 3.0), (23, 7, 1.5), (90, 41, 12.0), (130, 70, 2.0)] {
            let image = Array2::from_shape_fn((rows, cols), |(r, c)| ((r * 7 + c * 3) % 11) as f32);
            let taps = gaussian_taps(sigma_px);
            let blurred = gaussian_blur(&image, sigma_px);
            let tap = |d: usize| f64::from(taps.get(d).copied().unwrap_or(0.0));
            for (r, c) in [(0, 0), (rows / 2, cols / 3), (rows - 1, cols - 1)] {
                let sum: f64 = image
                    .indexed_iter()
                    .map(|((y, x), v)| f64::from(*v) * tap(y.abs_diff(r)) * tap(x.abs_diff(c)))
                    .sum();
                assert!((f64::from(blurred[[r, c]]) - sum).abs() < 1e-5, "{rows} {cols}: {} {sum}", blurred[[r, c]]);
            }
        }
    }

    /// The law of blurs, against Gaussians in closed form: weak and strong, along the axes and across, of a focus as
    /// sharp as lenses make them.
    #[test]
    fn a_spread_gaussian_is_the_gaussian_of_the_summed_variances() {
        let focus = [0.81, 1.0, 0.1];
        for by in
            [[0.01, 0.01, 0.0], [0.3, 0.0, 0.0], [1.3, 1.3, 0.0], [4.0, 2.0, 1.5], [9.0, 9.0, -6.0], [-0.2, 0.1, 0.0]]
        {
            let mut image = gaussian(focus);
            let before = image.clone();
            spread(&mut image, by);
            let want = gaussian([0, 1, 2].map(|i| focus[i] + by[i]));
            let norm = |a: &Array2<f32>| a.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
            let (off, change) = (norm(&(&image - &want)), norm(&(&before - &want)));
            // What sharpens raises the frequencies where L falls short.
            let most = if by[0] < 0.0 { 0.1 } else { 0.05 };
            assert!(off < most * change, "{by:?}: {off} of {change}");
            assert!((image.sum() / before.sum() - 1.0).abs() < 1e-4, "{by:?}");
            assert!(by[0] < 0.0 || image.iter().all(|v| *v > -1e-3), "{by:?}");
            let found = moments(&image);
            assert!((0..3).all(|i| (found[i] - focus[i] - by[i]).abs() < 0.02), "{by:?}: {found:?}");
        }
    }

    #[test]
    fn an_even_image_stays_even_and_a_lone_pixel_keeps_its_light() {
        let mut even = Array2::from_elem((5, 6), 64.0f32);
        spread(&mut even, [0.7, 1.9, 0.4]);
        assert!(even.iter().all(|v| (v - 64.0).abs() < 1e-3));
        let mut corner = Array2::zeros((9, 9));
        corner[[0, 0]] = 100.0f32;
        spread(&mut corner, [0.5, 0.5, 0.0]);
        assert!((corner.sum() - 100.0).abs() < 1e-3 && corner[[0, 0]] < 70.0, "{corner}");
        // The neighbour lost no more than a hundredth of it.
        assert!(corner.iter().all(|v| *v > -1.0), "{corner}");
    }
}
