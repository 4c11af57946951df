//! Operations on single images.

use ndarray::{Array2, ArrayView2, s};

/// Pearson correlation of two images of one size; 0 where one of them is uniform.
pub(super) fn pcc<'a>(a: impl Iterator<Item = &'a f32>, b: impl Iterator<Item = &'a f32>) -> f64 {
    let (mut n, mut sums) = (0.0, [0.0; 5]);
    for (a, b) in a.zip(b).map(|(&a, &b)| (f64::from(a), f64::from(b))) {
        n += 1.0;
        sums.iter_mut().zip([a, b, a * a, b * b, a * b]).for_each(|(s, v)| *s += v);
    }
    let [a, b, aa, bb, ab] = sums;
    let variance = (aa - a * a / n) * (bb - b * b / n);
    if variance > 0.0 { (ab - a * b / n) / variance.sqrt() } else { 0.0 }
}

/// The image divided by its largest magnitude.
pub(super) fn to_one(image: Array2<f32>) -> Array2<f32> {
    let most = image.iter().fold(0.0f32, |m, v| m.max(v.abs()));
    if most > 0.0 { image / most } else { image }
}

/// The central `side` x `side` pixels of an image, for display: the values of filters further out are close to 0.
pub fn middle(image: ArrayView2<'_, f32>, side: usize) -> ArrayView2<'_, f32> {
    let side = side.min(image.nrows()).min(image.ncols());
    let [top, left] = [image.nrows(), image.ncols()].map(|n| (n - side) / 2);
    image.slice_move(s![top..top + side, left..left + side])
}
