//! Transforms by their definition, in f64: the reference of the tests.

extern crate std;
use std::vec::Vec;

/// `X[k] = sum_n x[n] e^(-+2 pi i n k / N)` of (re, im) pairs.
pub(crate) fn dft(x: &[[f64; 2]], inverse: bool) -> Vec<[f64; 2]> {
    let n = x.len();
    let sign = if inverse { 1.0 } else { -1.0 };
    let sum = |k: usize| {
        x.iter().enumerate().fold([0.0, 0.0], |sum, (j, x)| {
            let angle = sign * std::f64::consts::TAU * ((j * k) % n) as f64 / n as f64;
            let (sin, cos) = angle.sin_cos();
            [sum[0] + x[0] * cos - x[1] * sin, sum[1] + x[0] * sin + x[1] * cos]
        })
    };
    (0..n).map(sum).collect()
}

/// The transform of rows and columns of an n x n plane.
pub(crate) fn dft2(x: &[[f64; 2]], n: usize, inverse: bool) -> Vec<[f64; 2]> {
    let rows: Vec<_> = x.chunks(n).flat_map(|row| dft(row, inverse)).collect();
    let mut out = rows.clone();
    for c in 0..n {
        let column: Vec<_> = (0..n).map(|r| rows[r * n + c]).collect();
        for (r, value) in dft(&column, inverse).into_iter().enumerate() {
            out[r * n + c] = value;
        }
    }
    out
}
