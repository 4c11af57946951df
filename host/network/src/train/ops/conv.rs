//! 3x3 convolution, stride 1, zero padding 1, on NCHW slices: forward, data gradient, weight gradient.
//!
//! Direct convolution without im2col: a block of `BLOCK` output channels by up to three vectors of pixels stays in
//! registers while the loop runs over the input channels, so each loaded value is used at least four times. Vectors run
//! over the pixels of a row; the instruction set is chosen when the program runs.

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

/// Number of output channels that are computed together.
const BLOCK: usize = 4;
/// Maximum number of vectors of pixels that are computed together.
const WIDE: usize = 3;
/// Widest vector of any instruction set, f32 lanes; rows are padded to a multiple of it.
const LANES: usize = 16;
/// Number of weights of a kernel.
const TAPS: usize = 9;

/// Sizes of one convolution: `x` [batch, inputs, rows, cols] -> `y` [batch, outputs, rows, cols].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Conv3x3 {
    /// Number of images.
    pub batch: usize,
    /// Number of input channels.
    pub inputs: usize,
    /// Number of output channels.
    pub outputs: usize,
    /// Number of rows of an image.
    pub rows: usize,
    /// Number of columns of an image.
    pub cols: usize,
}

/// Gradients of a loss with respect to the inputs of a convolution.
#[derive(Clone, Debug, PartialEq)]
pub struct ConvGradient {
    /// With respect to the input, [batch, inputs, rows, cols].
    pub input: Vec<f32>,
    /// With respect to the weight, [outputs, inputs, 3, 3].
    pub weight: Vec<f32>,
    /// With respect to the bias, one value for each output.
    pub bias: Vec<f32>,
}

impl Conv3x3 {
    /// `y[o, r, c] = bias[o] + sum_{i, u, v} weight[o, i, u, v] x[i, r + u - 1, c + v - 1]`, `weight` [outputs, inputs,
    /// 3, 3].
    pub fn forward(&self, x: &[f32], weight: &[f32], bias: &[f32]) -> Vec<f32> {
        let padded = Padded::new(x, self.batch, self.inputs, self.rows, self.cols);
        correlate(&padded, &pack(weight, self.outputs, self.inputs), self.outputs, Some(bias))
    }

    /// Gradients of a loss whose gradient with respect to the output is `g` [batch, outputs, rows, cols].
    pub fn backward(&self, x: &[f32], weight: &[f32], g: &[f32]) -> ConvGradient {
        let x = Padded::new(x, self.batch, self.inputs, self.rows, self.cols);
        let padded = Padded::new(g, self.batch, self.outputs, self.rows, self.cols);
        let plane = self.rows * self.cols;
        let bias = (0..self.outputs)
            .map(|o| (0..self.batch).map(|b| sum(&g[(b * self.outputs + o) * plane..][..plane])).sum())
            .collect();
        let turned = turn(weight, self.outputs, self.inputs);
        ConvGradient {
            input: correlate(&padded, &pack(&turned, self.inputs, self.outputs), self.inputs, None),
            weight: weight_gradient(&x, &padded),
            bias,
        }
    }
}

/// Images with a border of zeros, each row long enough for whole vectors: [batch, channels, rows + 2, stride].
struct Padded {
    data: Vec<f32>,
    batch: usize,
    channels: usize,
    rows: usize,
    cols: usize,
    stride: usize,
}

impl Padded {
    fn new(x: &[f32], batch: usize, channels: usize, rows: usize, cols: usize) -> Self {
        let stride = cols.next_multiple_of(LANES) + 2;
        let plane = (rows + 2) * stride;
        let mut data = vec![0.0; batch * channels * plane];
        let image = rows * cols;
        for (to, from) in data.chunks_exact_mut(plane).zip(x.chunks_exact(image)) {
            for (r, row) in from.chunks_exact(cols).enumerate() {
                to[(r + 1) * stride + 1..][..cols].copy_from_slice(row);
            }
        }
        Self { data, batch, channels, rows, cols, stride }
    }

    fn plane(&self) -> usize {
        (self.rows + 2) * self.stride
    }

    fn image(&self, batch: usize) -> &[f32] {
        let size = self.channels * self.plane();
        &self.data[batch * size..][..size]
    }
}

/// Weights by blocks of output channels, in the order in which the inner loop reads them: [block][input][tap][channel
/// of the block].
struct Packed {
    data: Vec<f32>,
    inputs: usize,
}

fn pack(weight: &[f32], outputs: usize, inputs: usize) -> Packed {
    let blocks = outputs.div_ceil(BLOCK);
    let mut data = vec![0.0; blocks * BLOCK * inputs * TAPS];
    for (o, of_output) in weight.chunks_exact(inputs * TAPS).enumerate() {
        for (k, &w) in of_output.iter().enumerate() {
            data[((o / BLOCK) * inputs * TAPS + k) * BLOCK + o % BLOCK] = w;
        }
    }
    Packed { data, inputs }
}

/// The weights of the adjoint: inputs and outputs exchanged, kernels rotated by 180 degrees.
fn turn(weight: &[f32], outputs: usize, inputs: usize) -> Vec<f32> {
    let mut turned = vec![0.0; weight.len()];
    for o in 0..outputs {
        for i in 0..inputs {
            for k in 0..TAPS {
                turned[(i * outputs + o) * TAPS + TAPS - 1 - k] = weight[(o * inputs + i) * TAPS + k];
            }
        }
    }
    turned
}

/// Sum in f64, since a bias gradient is a sum over whole images.
fn sum(values: &[f32]) -> f32 {
    values.iter().map(|&v| f64::from(v)).sum::<f64>() as f32
}

fn correlate(x: &Padded, weight: &Packed, outputs: usize, bias: Option<&[f32]>) -> Vec<f32> {
    let plane = x.rows * x.cols;
    let mut y = vec![0.0; x.batch * outputs * plane];
    let arch = Arch::new();
    y.par_chunks_mut(outputs * plane).enumerate().for_each(|(b, image)| {
        image.par_chunks_mut(BLOCK * plane).enumerate().for_each(|(block, y)| {
            let weight = &weight.data[block * BLOCK * weight.inputs * TAPS..][..BLOCK * weight.inputs * TAPS];
            let bias = bias.map_or(&[][..], |v| &v[block * BLOCK..]);
            arch.dispatch(Rows { x, image: x.image(b), weight, bias, y });
        });
    });
    y
}

/// All rows of one block of output channels of one image.
struct Rows<'a> {
    x: &'a Padded,
    image: &'a [f32],
    weight: &'a [f32],
    bias: &'a [f32],
    y: &'a mut [f32],
}

impl WithSimd for Rows<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let vectors = self.x.cols.div_ceil(S::F32_LANES);
        for r in 0..self.x.rows {
            let mut v = 0;
            while v < vectors {
                v += match vectors - v {
                    1 => self.block::<S, 1>(simd, r, v),
                    2 => self.block::<S, 2>(simd, r, v),
                    _ => self.block::<S, WIDE>(simd, r, v),
                };
            }
        }
    }
}

impl Rows<'_> {
    /// `V` vectors of pixels of row `r`, from vector `v` on; returns V.
    #[inline(always)]
    fn block<S: Simd, const V: usize>(&mut self, simd: S, r: usize, v: usize) -> usize {
        let plane = self.x.rows * self.x.cols;
        match self.y.len() / plane {
            1 => self.tile::<S, V, 1>(simd, r, v),
            2 => self.tile::<S, V, 2>(simd, r, v),
            _ => self.tile::<S, V, BLOCK>(simd, r, v),
        }
        V
    }

    /// The same for the first `O` channels of the block (all of them where there are fewer).
    #[inline(always)]
    fn tile<S: Simd, const V: usize, const O: usize>(&mut self, simd: S, r: usize, v: usize) {
        let (first, stride, lanes) = (v * S::F32_LANES, self.x.stride, S::F32_LANES);
        let mut acc = [[simd.splat_f32s(0.0); V]; O];
        for (o, a) in acc.iter_mut().enumerate() {
            *a = [simd.splat_f32s(self.bias.get(o).copied().unwrap_or(0.0)); V];
        }
        for (channel, weight) in self.image.chunks_exact(self.x.plane()).zip(self.weight.chunks_exact(TAPS * BLOCK)) {
            for u in 0..3 {
                let row = &channel[(r + u) * stride + first..][..V * lanes + 2];
                for k in 0..3 {
                    let x: [S::f32s; V] = std::array::from_fn(|j| load(simd, &row[j * lanes + k..]));
                    let w = &weight[(u * 3 + k) * BLOCK..][..BLOCK];
                    for (a, &w) in acc.iter_mut().zip(w) {
                        let w = simd.splat_f32s(w);
                        for (a, &x) in a.iter_mut().zip(&x) {
                            *a = simd.mul_add_e_f32s(w, x, *a);
                        }
                    }
                }
            }
        }
        let width = (self.x.cols - first).min(V * lanes);
        let plane = self.x.rows * self.x.cols;
        for (a, y) in acc.iter().zip(self.y.chunks_exact_mut(plane)) {
            let row = &mut y[r * self.x.cols + first..][..width];
            for (a, y) in a.iter().zip(row.chunks_mut(lanes)) {
                simd.partial_store_f32s(y, *a);
            }
        }
    }
}

/// The first lanes of a slice that holds at least as many.
#[inline(always)]
fn load<S: Simd>(_simd: S, from: &[f32]) -> S::f32s {
    S::as_simd_f32s(from).0[0]
}

/// Gradient with respect to the weights, [outputs, inputs, 3, 3]: each element is a sum over all pixels of all images.
fn weight_gradient(x: &Padded, g: &Padded) -> Vec<f32> {
    let (inputs, outputs) = (x.channels, g.channels);
    let arch = Arch::new();
    let mut weight = vec![0.0; outputs * inputs * TAPS];
    weight.par_chunks_mut(BLOCK * inputs * TAPS).enumerate().for_each(|(block, out)| {
        let sums: Vec<[[f32; TAPS]; BLOCK]> = (0..inputs)
            .into_par_iter()
            .map(|input| arch.dispatch(Taps { x, g, input, first: block * BLOCK }))
            .collect();
        for (o, out) in out.chunks_exact_mut(inputs * TAPS).enumerate() {
            for (out, sums) in out.chunks_exact_mut(TAPS).zip(&sums) {
                out.copy_from_slice(&sums[o]);
            }
        }
    });
    weight
}

/// Nine sums for one input channel and one block of output channels that starts at `first`.
struct Taps<'a> {
    x: &'a Padded,
    g: &'a Padded,
    input: usize,
    first: usize,
}

impl WithSimd for Taps<'_> {
    type Output = [[f32; TAPS]; BLOCK];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let mut sums = [[0.0; TAPS]; BLOCK];
        for u in 0..3 {
            match self.g.channels - self.first {
                1 => self.row_of_taps::<S, 1>(simd, u, &mut sums),
                2 => self.row_of_taps::<S, 2>(simd, u, &mut sums),
                3 => self.row_of_taps::<S, 3>(simd, u, &mut sums),
                _ => self.row_of_taps::<S, BLOCK>(simd, u, &mut sums),
            }
        }
        sums
    }
}

impl Taps<'_> {
    /// The three taps of kernel row `u` for `O` output channels.
    #[inline(always)]
    fn row_of_taps<S: Simd, const O: usize>(&self, simd: S, u: usize, sums: &mut [[f32; TAPS]; BLOCK]) {
        let (lanes, stride, plane) = (S::F32_LANES, self.x.stride, self.x.plane());
        let vectors = self.x.cols.div_ceil(lanes);
        let mut acc = [[simd.splat_f32s(0.0); 3]; O];
        for b in 0..self.x.batch {
            let x = &self.x.image(b)[self.input * plane..][..plane];
            let g: [&[f32]; O] = std::array::from_fn(|o| &self.g.image(b)[(self.first + o) * plane..][..plane]);
            for r in 0..self.x.rows {
                let x = &x[(r + u) * stride..][..vectors * lanes + 2];
                let g: [&[f32]; O] = std::array::from_fn(|o| &g[o][(r + 1) * stride + 1..][..vectors * lanes]);
                for at in (0..vectors * lanes).step_by(lanes) {
                    let shifted: [S::f32s; 3] = std::array::from_fn(|k| load(simd, &x[at + k..]));
                    for (acc, g) in acc.iter_mut().zip(&g) {
                        let g = load(simd, &g[at..]);
                        for (a, &x) in acc.iter_mut().zip(&shifted) {
                            *a = simd.mul_add_e_f32s(g, x, *a);
                        }
                    }
                }
            }
        }
        for (sums, acc) in sums.iter_mut().zip(&acc) {
            for (sum, &a) in sums[u * 3..].iter_mut().zip(acc) {
                *sum = simd.reduce_sum_f32s(a);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pseudo-random numbers in [-1, 1).
    fn noise(n: usize, seed: u64) -> Vec<f32> {
        let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
        std::iter::repeat_with(|| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1u64 << 23) as f32 - 1.0
        })
        .take(n)
        .collect()
    }

    /// The definition of the convolution in f64.
    fn naive(s: Conv3x3, x: &[f32], w: &[f32], bias: &[f32]) -> Vec<f64> {
        let mut y = Vec::new();
        for b in 0..s.batch {
            for (o, &bias) in bias.iter().enumerate().take(s.outputs) {
                for r in 0..s.rows {
                    for c in 0..s.cols {
                        let mut sum = f64::from(bias);
                        for i in 0..s.inputs {
                            for u in 0..3 {
                                for v in 0..3 {
                                    let (rr, cc) = (r + u, c + v);
                                    if rr >= 1 && cc >= 1 && rr <= s.rows && cc <= s.cols {
                                        let x = x[((b * s.inputs + i) * s.rows + rr - 1) * s.cols + cc - 1];
                                        sum += f64::from(x) * f64::from(w[(o * s.inputs + i) * 9 + u * 3 + v]);
                                    }
                                }
                            }
                        }
                        y.push(sum);
                    }
                }
            }
        }
        y
    }

    fn sizes() -> [Conv3x3; 5] {
        let s = |batch, inputs, outputs, rows, cols| Conv3x3 { batch, inputs, outputs, rows, cols };
        [s(1, 1, 1, 1, 1), s(2, 3, 5, 4, 7), s(1, 4, 4, 6, 48), s(3, 2, 6, 5, 33), s(1, 5, 7, 3, 17)]
    }

    #[test]
    fn forward_is_the_definition() {
        for s in sizes() {
            let x = noise(s.batch * s.inputs * s.rows * s.cols, 1);
            let (w, bias) = (noise(s.outputs * s.inputs * 9, 2), noise(s.outputs, 3));
            for (a, b) in s.forward(&x, &w, &bias).iter().zip(naive(s, &x, &w, &bias)) {
                assert!((f64::from(*a) - b).abs() < 1e-5, "{s:?}: {a} {b}");
            }
        }
    }

    /// The operator is linear in x, in w and in the bias, so `<g, conv(x')> = <x', input gradient>` and so on, exactly.
    #[test]
    fn gradients_are_adjoints() {
        for s in sizes() {
            let pixels = s.batch * s.rows * s.cols;
            let (x, g) = (noise(pixels * s.inputs, 4), noise(pixels * s.outputs, 5));
            let w = noise(s.outputs * s.inputs * 9, 6);
            let grad = s.backward(&x, &w, &g);
            let zero = vec![0.0; s.outputs];
            let dot = |y: &[f64]| y.iter().zip(&g).map(|(a, &b)| a * f64::from(b)).sum::<f64>();
            let along = |d: &[f32], p: &[f32]| d.iter().zip(p).map(|(&a, &b)| f64::from(a) * f64::from(b)).sum::<f64>();
            let (dx, dw, db) = (noise(x.len(), 7), noise(w.len(), 8), noise(s.outputs, 9));
            let expected = [
                dot(&naive(s, &dx, &w, &zero)),
                dot(&naive(s, &x, &dw, &zero)),
                dot(&naive(s, &x, &vec![0.0; w.len()], &db)),
            ];
            let found = [along(&grad.input, &dx), along(&grad.weight, &dw), along(&grad.bias, &db)];
            for (e, f) in expected.iter().zip(found) {
                assert!((e - f).abs() < 2e-5 * (1.0 + (pixels as f64)), "{s:?}: {expected:?} {found:?}");
            }
        }
    }
}
