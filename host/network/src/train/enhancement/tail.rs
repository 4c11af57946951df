//! The last two convolutions as one.
//!
//! ```text
//! features [h, w, W] -> conv 3x3, 4 W outputs -> PixelShuffle 2 -> [2 h, 2 w, W] -> conv 3x3, 1 output -> logits
//! ```
//! All of it is linear, so the four logits of a pixel of the features are 5x5 sums over its neighbours. The second
//! convolution sees zeros outside its image, not what the first one would give there: pixels at an edge have weights of
//! their own. Weights are summed in f64.

use super::super::ops::patch::{Patch, padded};
use pulp::{Arch, Simd, WithSimd};

/// Side of the sums.
const SIDE: usize = 5;
/// Features around a patch that the sums need on each side.
pub const MARGIN: usize = SIDE / 2;
/// Logits of a pixel of the features: two rows of two.
const LOGITS: usize = 4;
/// Pixels whose sums are in registers at the same time.
const PIXELS: usize = 4;

/// Which neighbours exist along an axis: bit 0, there is none before the pixel; bit 1, none after it.
type Edge = usize;

/// The weights of the sums.
pub struct Tail {
    channels: usize,
    /// For each edge of the rows and each of the columns: weights [place of the 5x5, logit, channel], and the constant
    /// part of the logits.
    sums: Vec<(Vec<f32>, [f32; LOGITS])>,
}

impl Tail {
    /// From the weights and bias of both convolutions: [4 W, W, 3, 3] and [1, W, 3, 3].
    pub fn new([up, up_bias]: &[Vec<f32>; 2], [last, last_bias]: &[Vec<f32>; 2]) -> Self {
        let width = last.len() / 9;
        let edges = (0..16).map(|e| joined((e / 4, e % 4), width, (up, up_bias), (last, last_bias))).collect();
        Self { channels: padded(width), sums: edges }
    }

    /// The logits of one row of features, [2, 2 cols], from rows `r..r + 5` of a patch, whose columns begin [`MARGIN`]
    /// before them.
    ///
    /// `top` is the edge of the row; `left` and `right` say whether its first and last pixels are those of the image.
    pub fn row(&self, x: &Patch, r: usize, top: Edge, [left, right]: [bool; 2], logits: [&mut [f32]; 2]) {
        Arch::new().dispatch(Row { tail: self, x, r, top, ends: [left, right], logits });
    }
}

/// The edge of pixel `i` of `n`.
pub fn edge(i: usize, n: usize) -> Edge {
    usize::from(i == 0) + 2 * usize::from(i + 1 == n)
}

/// The weights at one edge.
fn joined(
    (rows, cols): (Edge, Edge),
    width: usize,
    (up, up_bias): (&[f32], &[f32]),
    (last, last_bias): (&[f32], &[f32]),
) -> (Vec<f32>, [f32; LOGITS]) {
    let channels = padded(width);
    let mut sums = vec![0.0f64; SIDE * SIDE * LOGITS * channels];
    let mut constant = [f64::from(last_bias.first().copied().unwrap_or(0.0)); LOGITS];
    // Pixel of the features on which tap `k` of the second convolution falls for logit `d`, and which of its two.
    let falls = |d: usize, k: usize, edge: Edge| {
        let fine = d as isize + k as isize - 1;
        let exists = !(fine < 0 && edge & 1 != 0 || fine > 1 && edge & 2 != 0);
        exists.then(|| (fine.div_euclid(2), fine.rem_euclid(2) as usize))
    };
    for (logit, k) in (0..LOGITS).flat_map(|l| (0..9).map(move |k| (l, k))) {
        let (Some((dy, sy)), Some((dx, sx))) = (falls(logit / 2, k / 3, rows), falls(logit % 2, k % 3, cols)) else {
            continue;
        };
        for channel in 0..width {
            let weight = f64::from(last[channel * 9 + k]);
            let from = 4 * channel + 2 * sy + sx;
            constant[logit] += weight * f64::from(up_bias[from]);
            for (i, kernel) in up[from * width * 9..][..width * 9].chunks_exact(9).enumerate() {
                for (tap, v) in kernel.iter().enumerate() {
                    let y = (dy + 1) as usize + tap / 3;
                    let x = (dx + 1) as usize + tap % 3;
                    sums[((y * SIDE + x) * LOGITS + logit) * channels + i] += weight * f64::from(*v);
                }
            }
        }
    }
    (sums.into_iter().map(|v| v as f32).collect(), constant.map(|v| v as f32))
}

struct Row<'a> {
    tail: &'a Tail,
    x: &'a Patch,
    r: usize,
    top: Edge,
    ends: [bool; 2],
    logits: [&'a mut [f32]; 2],
}

impl WithSimd for Row<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let cols = self.logits[0].len() / 2;
        let mut c = 0;
        while c < cols {
            let edge = usize::from(c == 0 && self.ends[0]) + 2 * usize::from(c + 1 == cols && self.ends[1]);
            let inner = cols - usize::from(self.ends[1]);
            if edge == 0 && c + PIXELS <= inner {
                self.pixels::<S, PIXELS>(simd, c, 0);
                c += PIXELS;
            } else {
                self.pixels::<S, 1>(simd, c, edge);
                c += 1;
            }
        }
    }
}

impl Row<'_> {
    /// The logits of `P` pixels from column `c` on.
    #[inline(always)]
    fn pixels<S: Simd, const P: usize>(&mut self, simd: S, c: usize, edge: Edge) {
        let n = self.tail.channels;
        let (weights, constant) = &self.tail.sums[self.top * 4 + edge];
        let mut sums = [[simd.splat_f32s(0.0); LOGITS]; P];
        for (place, w) in weights.chunks_exact(LOGITS * n).enumerate() {
            let x = &self.x.row(self.r + place / SIDE)[(c + place % SIDE) * n..][..P * n];
            for first in (0..n).step_by(S::F32_LANES) {
                let w: [S::f32s; LOGITS] = std::array::from_fn(|l| S::as_simd_f32s(&w[l * n + first..]).0[0]);
                for (p, sums) in sums.iter_mut().enumerate() {
                    let x = S::as_simd_f32s(&x[p * n + first..]).0[0];
                    for (sum, w) in sums.iter_mut().zip(w) {
                        *sum = simd.mul_add_e_f32s(x, w, *sum);
                    }
                }
            }
        }
        for (p, sums) in sums.iter().enumerate() {
            for (l, sum) in sums.iter().enumerate() {
                self.logits[l / 2][2 * (c + p) + l % 2] = simd.reduce_sum_f32s(*sum) + constant[l];
            }
        }
    }
}
