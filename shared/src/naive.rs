//! The operators by their definitions, in f64: the references of the tests. Nothing here calls the code under test.

extern crate std;

use std::vec;
use std::vec::Vec;

use crate::blob::{Passes, Size};
use crate::num::f16;

/// Repeatable numbers in [-1, 1): a linear congruential generator (Numerical Recipes, "quick and dirty").
pub(crate) struct Noise(pub(crate) u32);

impl Noise {
    pub(crate) fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (self.0 >> 8) as f32 / 8_388_608.0 - 1.0
    }

    pub(crate) fn halves(&mut self, len: usize, scale: f32) -> Vec<f16> {
        (0..len).map(|_| f16::from_f32(self.next() * scale)).collect()
    }
}

pub(crate) fn wide(halves: &[f16]) -> Vec<f64> {
    halves.iter().map(|half| half.to_f64()).collect()
}

/// Largest |found - expected| over the largest |expected|.
pub(crate) fn error(found: &[f16], expected: &[f64]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let scale = expected.iter().fold(f64::MIN_POSITIVE, |max, x| max.max(x.abs()));
    found.iter().zip(expected).fold(0.0, |max: f64, (f, e)| {
        let error = (f.to_f64() - e).abs();
        assert!(!error.is_nan(), "found {f}, expected {e}");
        max.max(error)
    }) / scale
}

/// A tensor of (channel, row, col).
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Tensor {
    pub(crate) shape: [usize; 3],
    pub(crate) data: Vec<f64>,
}

impl Tensor {
    pub(crate) fn new(shape: [usize; 3], data: Vec<f64>) -> Self {
        assert_eq!(shape.iter().product::<usize>(), data.len());
        Self { shape, data }
    }

    /// Zero outside.
    pub(crate) fn at(&self, k: usize, r: isize, c: isize) -> f64 {
        let [_, rows, cols] = self.shape;
        let inside = (0..rows as isize).contains(&r) && (0..cols as isize).contains(&c);
        if inside { self.data[(k * rows + r as usize) * cols + c as usize] } else { 0.0 }
    }

    pub(crate) fn build(shape: [usize; 3], mut f: impl FnMut(usize, usize, usize) -> f64) -> Self {
        let [channels, rows, cols] = shape;
        let mut data = Vec::with_capacity(channels * rows * cols);
        for k in 0..channels {
            for r in 0..rows {
                for c in 0..cols {
                    data.push(f(k, r, c));
                }
            }
        }
        Self { shape, data }
    }

    pub(crate) fn map(&self, f: impl Fn(f64) -> f64) -> Self {
        Self { shape: self.shape, data: self.data.iter().map(|&x| f(x)).collect() }
    }

    pub(crate) fn plus(&self, other: &Self) -> Self {
        assert_eq!(self.shape, other.shape);
        Self { shape: self.shape, data: self.data.iter().zip(&other.data).map(|(a, b)| a + b).collect() }
    }
}

pub(crate) fn conv3x3(x: &Tensor, weights: &[f64], bias: &[f64]) -> Tensor {
    let [inputs, rows, cols] = x.shape;
    Tensor::build([bias.len(), rows, cols], |o, r, c| {
        let mut sum = bias[o];
        for i in 0..inputs {
            for (tap, weight) in weights[(o * inputs + i) * 9..][..9].iter().enumerate() {
                let (ky, kx) = (tap as isize / 3, tap as isize % 3);
                sum += weight * x.at(i, r as isize + ky - 1, c as isize + kx - 1);
            }
        }
        sum
    })
}

pub(crate) fn relu(x: f64) -> f64 {
    x.max(0.0)
}

pub(crate) fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

pub(crate) fn unshuffle(x: &Tensor) -> Tensor {
    let [channels, rows, cols] = x.shape;
    Tensor::build([4 * channels, rows / 2, cols / 2], |k, r, c| {
        x.at(k / 4, (2 * r + k % 4 / 2) as isize, (2 * c + k % 2) as isize)
    })
}

pub(crate) fn shuffle(x: &Tensor) -> Tensor {
    let [channels, rows, cols] = x.shape;
    Tensor::build([channels / 4, 2 * rows, 2 * cols], |k, r, c| {
        x.at(4 * k + 2 * (r % 2) + c % 2, (r / 2) as isize, (c / 2) as isize)
    })
}

/// `weights` (outputs, inputs) times `x` plus `bias`.
pub(crate) fn dense(x: &[f64], weights: &[f64], bias: &[f64]) -> Vec<f64> {
    let dot = |row: &[f64]| row.iter().zip(x).map(|(w, x)| w * x).sum::<f64>();
    weights.chunks(x.len()).zip(bias).map(|(row, b)| dot(row) + b).collect()
}

/// Scale of each channel.
pub(crate) fn attention(x: &Tensor, squeeze: [&[f64]; 2], excite: [&[f64]; 2]) -> Vec<f64> {
    let pixels = x.shape[1] * x.shape[2];
    let mean: Vec<f64> = x.data.chunks(pixels).map(|channel| channel.iter().sum::<f64>() / pixels as f64).collect();
    let hidden: Vec<f64> = dense(&mean, squeeze[0], squeeze[1]).into_iter().map(relu).collect();
    dense(&hidden, excite[0], excite[1]).into_iter().map(sigmoid).collect()
}

/// Hands out parts of a flat list.
pub(crate) struct Cursor<'a>(pub(crate) &'a [f64]);

impl<'a> Cursor<'a> {
    pub(crate) fn take(&mut self, len: usize) -> &'a [f64] {
        let (taken, rest) = self.0.split_at(len);
        self.0 = rest;
        taken
    }
}

fn next_conv(x: &Tensor, outputs: usize, weights: &mut Cursor<'_>) -> Tensor {
    let (w, b) = (weights.take(outputs * x.shape[0] * 9), weights.take(outputs));
    conv3x3(x, w, b)
}

/// `t` and `g + s t`, with s of this tensor or whatever `choose` makes of it.
pub(crate) fn rcab(
    g: &Tensor,
    hidden: usize,
    weights: &mut Cursor<'_>,
    choose: &mut dyn FnMut(Vec<f64>) -> Vec<f64>,
) -> Tensor {
    let width = g.shape[0];
    let inner = next_conv(g, width, weights).map(relu);
    let t = next_conv(&inner, width, weights);
    let squeeze = [weights.take(width * hidden), weights.take(hidden)];
    let excite = [weights.take(width * hidden), weights.take(width)];
    let scale = choose(attention(&t, squeeze, excite));
    g.plus(&Tensor::build(t.shape, |k, r, c| scale[k] * t.at(k, r as isize, c as isize)))
}

/// The enhancement network: groups, blocks, width, width of the bottleneck.
pub(crate) fn rcan(x: &Tensor, shape: [usize; 4], weights: &[f64]) -> Tensor {
    rcan_with(x, shape, weights, &mut |own| own)
}

/// The same where `choose` is shown the scales of each channel attention, block by block, and says which are used.
pub(crate) fn rcan_with(
    x: &Tensor,
    [groups, blocks, width, hidden]: [usize; 4],
    weights: &[f64],
    choose: &mut dyn FnMut(Vec<f64>) -> Vec<f64>,
) -> Tensor {
    let mut weights = Cursor(weights);
    let head = next_conv(&unshuffle(x), width, &mut weights);
    let mut y = head.clone();
    for _ in 0..groups {
        let mut g = y.clone();
        for _ in 0..blocks {
            g = rcab(&g, hidden, &mut weights, choose);
        }
        y = y.plus(&next_conv(&g, width, &mut weights));
    }
    y = head.plus(&next_conv(&y, width, &mut weights));
    let up = shuffle(&next_conv(&y, 4 * width, &mut weights));
    let out = next_conv(&up, 1, &mut weights).map(sigmoid);
    assert!(weights.0.is_empty());
    out
}

/// Circular convolution on an n x n plane: `out[p] = sum_q k[(p - q) mod n] y[q]`.
pub(crate) fn circular(k: &[f64], y: &[f64], n: usize) -> Vec<f64> {
    let mut out = vec![0.0; n * n];
    let occupied = y.iter().enumerate().filter(|(_, y)| **y != 0.0);
    for (q, y) in occupied {
        let (qr, qc) = (q / n, q % n);
        for (i, k) in k.iter().enumerate().filter(|(_, k)| **k != 0.0) {
            out[(i / n + qr) % n * n + (i % n + qc) % n] += k * y;
        }
    }
    out
}

/// The frame of an object `x`: `g[corner - (W - 1) / 2 + p + u] += M[p] x[p] B[u]`. `model` has the basis PSFs times
/// `tile`.
pub(crate) fn predict(
    passes: &Passes,
    (nodes, tile): ([usize; 2], u16),
    [frame, object]: [Size; 2],
    model: &[f64],
    x: &[f64],
) -> Vec<f64> {
    let [rows, cols] = [frame.rows, frame.cols].map(usize::from);
    let [window, step, n] = [passes.window, passes.node_step, object.cols].map(usize::from);
    let maps = nodes[0] * nodes[1];
    let mut light = vec![0.0; rows * cols];
    for (i, term) in model.chunks(maps + window * window).enumerate() {
        let corner = &passes.corners[i / usize::from(passes.terms)];
        let at = |r: usize, c: usize| term[r.min(nodes[0] - 1) * nodes[1] + c.min(nodes[1] - 1)];
        for (p, x) in x.iter().enumerate() {
            let ([i, j], [f, g]) =
                ([p / n / step, p % n / step], [p / n, p % n].map(|r| (r % step) as f64 / step as f64));
            let [above, below] = [i, i + 1].map(|i| (1.0 - g) * at(i, j) + g * at(i, j + 1));
            let weight = (1.0 - f) * above + f * below;
            for u in 0..window * window {
                let place = |corner: i16, at: usize| (isize::from(corner) - (window / 2) as isize) + at as isize;
                let (row, col) = (place(corner.row, p / n + u / window), place(corner.col, p % n + u % window));
                if (0..rows as isize).contains(&row) && (0..cols as isize).contains(&col) {
                    let at = row as usize * cols + col as usize;
                    light[at] += weight * x * term[maps + u] / f64::from(tile);
                }
            }
        }
    }
    light
}
