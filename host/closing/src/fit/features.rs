//! Features of the noise in the difference of two repeats: what its variance is, and what neighbours, rows and columns
//! have in common.

use super::kurtosis::excess_kurtosis;
use ndarray::{Array2, ArrayView1, s};

/// Number of features of one level of light: variance; correlation along the row, along the column, diagonally; excess
/// kurtosis; variance common to the pixels of a row, of a column. The first five are of pixels without the means of
/// their row and column, as in an analysis of variance (Scheffe, *The Analysis of Variance*, 1959, ch. 4).
pub(crate) const FEATURES: usize = 7;
/// One value for each feature.
pub(crate) type Features = [f64; FEATURES];

/// Index of the excess kurtosis.
pub(super) const TAILS: usize = 4;

/// Features of a standardised difference; their mean is zero for white noise of variance one.
pub(super) fn features(d: &Array2<f32>) -> Features {
    let (of_lines, rest) = lines(d);
    let mut all = likeness(&rest);
    all[TAILS] = excess_kurtosis(&rest);
    [all[5], all[6]] = of_lines;
    all
}

/// [`features`] with zero in the place of the excess kurtosis, which takes most of the time.
pub(super) fn without_tails(d: &Array2<f32>) -> Features {
    let (of_lines, rest) = lines(d);
    let mut all = likeness(&rest);
    [all[5], all[6]] = of_lines;
    all
}

/// The excess kurtosis of [`features`] alone.
pub(super) fn tails(d: &Array2<f32>) -> f64 {
    excess_kurtosis(&lines(d).1)
}

/// Variance common to the pixels of a row, and of a column, and what is left of an image without the means of its rows
/// and columns: the noise that these have in common would make the variance of the pixels and the likeness of
/// neighbours scatter. A flicker of the lamp changes all pixels together and is no noise of the sensor, so the mean is
/// taken off.
pub(super) fn lines(d: &Array2<f32>) -> ([f64; 2], Array2<f32>) {
    let (rows, cols) = d.dim();
    let (mut of_rows, mut of_cols) = (vec![0.0f64; rows], vec![0.0f64; cols]);
    for (of_row, line) in of_rows.iter_mut().zip(d.outer_iter()) {
        of_cols.iter_mut().zip(line).for_each(|(sum, v)| *sum += f64::from(*v));
        *of_row = line.as_slice().map_or_else(|| line.iter().map(|v| f64::from(*v)).sum(), sum);
    }
    let mean = of_rows.iter().sum::<f64>() / (rows * cols).max(1) as f64;
    let shared = |sums: &mut [f64], n: usize| {
        let n = n.max(1) as f64;
        let count = sums.len().max(1) as f64;
        sums.iter_mut().for_each(|s| *s = *s / n - mean);
        sums.iter().map(|s| s * s * n - 1.0).sum::<f64>() / count
    };
    let variances = [shared(&mut of_rows, cols), shared(&mut of_cols, rows)];
    let of_cols: Vec<f32> = of_cols.iter().map(|v| *v as f32).collect();
    let mut rest = d.clone();
    for (mut line, of_row) in rest.outer_iter_mut().zip(&of_rows) {
        let own = (of_row + mean) as f32;
        line.iter_mut().zip(&of_cols).for_each(|(v, of_col)| *v -= own + of_col);
    }
    (variances, rest)
}

/// Variance of the pixels less one, and correlation along the row, along the column and diagonally; the other features
/// are zero.
fn likeness(d: &Array2<f32>) -> Features {
    let (rows, cols) = (d.nrows().max(1) as f64, d.ncols().max(1) as f64);
    let together = |dr: usize, dc: usize| -> f64 {
        if d.nrows() <= dr || d.ncols() <= dc {
            return 0.0;
        }
        let (a, b) = (d.slice(s![..d.nrows() - dr, ..d.ncols() - dc]), d.slice(s![dr.., dc..]));
        let of_line = |(a, b): (ArrayView1<'_, f32>, ArrayView1<'_, f32>)| match (a.as_slice(), b.as_slice()) {
            (Some(a), Some(b)) => products(a, b),
            _ => a.iter().zip(&b).map(|(x, y)| f64::from(x * y)).sum(),
        };
        let sum = a.outer_iter().zip(b.outer_iter()).map(of_line).sum::<f64>();
        // What the means of a row and a column that are taken off make of white noise.
        let of_one = |d: usize, n: f64| if d == 0 { 1.0 - 1.0 / n } else { -1.0 / n };
        (sum - a.len() as f64 * of_one(dr, rows) * of_one(dc, cols)) / (rows * cols)
    };
    [together(0, 0), together(0, 1), together(1, 0), together(1, 1), 0.0, 0.0, 0.0]
}

/// Sums that do not wait for one another: they fill vectors.
const LANES: usize = 8;

/// Sum of the products of two lines.
fn products(a: &[f32], b: &[f32]) -> f64 {
    let ((whole, rest), (of_b, rest_b)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    let mut sums = [0.0f64; LANES];
    for (a, b) in whole.iter().zip(of_b) {
        (0..LANES).for_each(|i| sums[i] += f64::from(a[i] * b[i]));
    }
    let rest: f64 = rest.iter().zip(rest_b).map(|(x, y)| f64::from(x * y)).sum();
    sums.iter().sum::<f64>() + rest
}

/// Sum of a line.
fn sum(a: &[f32]) -> f64 {
    let (whole, rest) = a.as_chunks::<LANES>();
    let mut sums = [0.0f64; LANES];
    for a in whole {
        (0..LANES).for_each(|i| sums[i] += f64::from(a[i]));
    }
    sums.iter().sum::<f64>() + rest.iter().map(|v| f64::from(*v)).sum::<f64>()
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
            let drawn: Vec<Features> = (0..40).map(|seed| features(&noise(seed, of_rows))).collect();
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
