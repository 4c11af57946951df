//! Wings: light of each focus outside the windows of the calibration.
//!
//! No window holds it, so no prediction and no replicate does. The calibration states how much there may be
//! ([`ommatidia_model::instrument::Quality::outside_window`]); how it falls off with the distance is unknown. So the
//! sensor is divided into square rings round each focus, each twice as far out as the one before, and each holds an
//! unknown share of the light of the focus. The shares are independent, and their standard uncertainties are those of
//! light whose brightness falls as the fourth power of the distance. A halo or glare that small is no effect, but an
//! error of the calibration.

use ndarray::Array2;

/// Number of rings.
const RINGS: i32 = 3;

/// Rings round the window of a focus: half sides from and to, px, and the standard uncertainty of the share of light
/// in it.
pub(super) fn rings(half: usize, outside: f64) -> Vec<(usize, usize, f64)> {
    if outside <= 0.0 || half == 0 {
        return Vec::new();
    }
    // Of light whose brightness falls as the fourth power of the distance, a quarter lies outside twice the distance.
    let share = |i: i32| outside * 0.75 * 0.25f64.powi(i);
    (0..RINGS).map(|i| (half << i, half << (i + 1), share(i))).collect()
}

/// The light of an image spread evenly over square rings round each of its pixels, from outside the half side `inner`
/// to `outer`, px. Light that falls off the image is lost.
pub(super) fn spread(image: &Array2<f32>, inner: usize, outer: usize) -> Array2<f32> {
    let (rows, cols) = image.dim();
    let mut sums = Array2::<f64>::zeros((rows + 1, cols + 1));
    for r in 0..rows {
        let mut row = 0.0;
        for c in 0..cols {
            row += f64::from(image[[r, c]]);
            sums[[r + 1, c + 1]] = sums[[r, c + 1]] + row;
        }
    }
    let square = |r: usize, c: usize, half: usize| {
        let (top, left) = (r.saturating_sub(half), c.saturating_sub(half));
        let (bottom, right) = ((r + half + 1).min(rows), (c + half + 1).min(cols));
        sums[[bottom, right]] - sums[[top, right]] - sums[[bottom, left]] + sums[[top, left]]
    };
    let area = |half: usize| (2.0 * half as f64 + 1.0).powi(2);
    let pixels = area(outer) - area(inner);
    Array2::from_shape_fn((rows, cols), |(r, c)| ((square(r, c, outer) - square(r, c, inner)) / pixels) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_is_spread_over_its_ring_and_no_light_is_lost() {
        let mut image = Array2::zeros((41, 43));
        image[[20, 21]] = 5.0;
        let out = spread(&image, 3, 6);
        for ((r, c), v) in out.indexed_iter() {
            let d = r.abs_diff(20).max(c.abs_diff(21));
            let expected = if d > 3 && d <= 6 { 5.0 / (169.0 - 49.0) } else { 0.0 };
            assert!((v - expected).abs() < 1e-6, "{r} {c} {v}");
        }
        assert!((out.sum() - 5.0).abs() < 1e-4);
    }

    #[test]
    fn the_rings_hold_the_light_outside_the_window() {
        let rings = rings(7, 1e-4);
        assert_eq!(rings.iter().map(|r| (r.0, r.1)).collect::<Vec<_>>(), [(7, 14), (14, 28), (28, 56)]);
        // All but what lies beyond eight times the half side.
        let sum: f64 = rings.iter().map(|r| r.2).sum();
        assert!((sum - 1e-4 * (1.0 - 1.0 / 64.0)).abs() < 1e-12);
        assert!(super::rings(7, 0.0).is_empty());
    }
}
