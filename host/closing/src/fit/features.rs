//! Features of the noise in the difference of two repeats: what its variance is, and what neighbours, rows and columns
//! have in common.

use super::kurtosis::excess_kurtosis;
use ndarray::{Array2, Axis, s};

/// Number of features of one level of light: variance; correlation along the row, along the column, diagonally; excess
/// kurtosis; variance common to the pixels of a row, of a column. The first five are of pixels without the means of
/// their row and column, as in an analysis of variance (Scheffe, *The Analysis of Variance*, 1959, ch. 4).
pub(crate) const FEATURES: usize = 7;
/// One value for each feature.
pub(crate) type Features = [f64; FEATURES];

/// Features of a standardised difference; their mean is zero for white noise of variance one.
pub(super) fn features(mut d: Array2<f32>) -> Features {
    // A flicker of the lamp changes all pixels together and is no noise of the sensor.
    let mean = d.mean().unwrap_or(0.0);
    d.mapv_inplace(|v| v - mean);
    let (rows, cols) = (d.nrows().max(1) as f64, d.ncols().max(1) as f64);
    let shared = |axis: usize| -> f64 {
        let lines = d.axis_iter(Axis(axis));
        let squares: f64 = lines
            .map(|line| {
                let sum: f64 = line.iter().map(|v| f64::from(*v)).sum();
                sum * sum / line.len().max(1) as f64 - 1.0
            })
            .sum();
        squares / d.len_of(Axis(axis)).max(1) as f64
    };
    let (of_rows, of_cols) = (shared(0), shared(1));
    let d = without_lines(&d);
    let tails = excess_kurtosis(&d);
    let together = |dr: usize, dc: usize| -> f64 {
        if d.nrows() <= dr || d.ncols() <= dc {
            return 0.0;
        }
        let (a, b) = (d.slice(s![..d.nrows() - dr, ..d.ncols() - dc]), d.slice(s![dr.., dc..]));
        let product = a.iter().zip(&b).map(|(x, y)| f64::from(x * y)).sum::<f64>();
        // What the means of a row and a column that are taken off make of white noise.
        let of_one = |d: usize, n: f64| if d == 0 { 1.0 - 1.0 / n } else { -1.0 / n };
        (product - a.len() as f64 * of_one(dr, rows) * of_one(dc, cols)) / (rows * cols)
    };
    [together(0, 0), together(0, 1), together(1, 0), together(1, 1), tails, of_rows, of_cols]
}

/// An image whose mean is zero, without the means of its rows and columns: the noise that rows and columns have in
/// common would make the variance of the pixels and the likeness of neighbours scatter.
fn without_lines(d: &Array2<f32>) -> Array2<f32> {
    let mean = |axis: usize| d.mean_axis(Axis(axis)).unwrap_or_default();
    d - &mean(1).insert_axis(Axis(1)) - &mean(0).insert_axis(Axis(0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ommatidia_session::rng::stream;
    use rand_distr::{Distribution, StandardNormal};

    /// White noise of variance one, with offsets of the rows of a standard deviation.
    fn noise(seed: u64, of_rows: f32) -> Array2<f32> {
        let mut rng = stream(seed, "features", 0);
        let mut normal = || -> f32 { StandardNormal.sample(&mut rng) };
        let mut d = Array2::from_shape_simple_fn((120, 150), &mut normal);
        d.rows_mut().into_iter().for_each(|mut row| row += of_rows * normal());
        d
    }

    /// The noise of rows has a feature of its own: the variance of the pixels and the likeness of neighbours scatter as
    /// they do without it.
    #[test]
    fn noise_of_rows_is_no_variance_of_pixels() {
        let scatter = |of_rows: f32| {
            let drawn: Vec<Features> = (0..40).map(|seed| features(noise(seed, of_rows))).collect();
            let mean = |f: usize| drawn.iter().map(|d| d[f]).sum::<f64>() / drawn.len() as f64;
            let square = |f: usize| drawn.iter().map(|d| d[f] * d[f]).sum::<f64>() / drawn.len() as f64;
            ([0, 1, 2, 3, 5, 6].map(mean), [0, 1, 2, 3].map(|f| square(f).sqrt()))
        };
        let pixels = 120.0 * 150.0f64;
        for of_rows in [0.0, 1.5] {
            let (mean, scatter) = scatter(of_rows);
            // 150 pixels a row have 2.25 in common.
            let expected = [0.0, 0.0, 0.0, 0.0, f64::from(of_rows).powi(2) * 150.0, 0.0];
            let errors = [0.004, 0.004, 0.004, 0.004, 0.1 * expected[4] + 0.1, 0.1];
            let off = mean.iter().zip(&expected).zip(&errors).all(|((m, e), most)| (m - e).abs() < *most);
            assert!(off, "{of_rows}: {mean:?}");
            let white = [2.0f64, 1.0, 1.0, 1.0].map(|v| (v / pixels).sqrt());
            let as_white = scatter.iter().zip(&white).all(|(s, w)| (0.6..1.6).contains(&(s / w)));
            assert!(as_white, "{of_rows}: {scatter:?} for {white:?}");
        }
    }
}
