//! 3x3 convolution of patches with few multiplications: Winograd's F(4x4, 3x3).
//!
//! A tile of 4 x 4 outputs is `A' ((G g G') . (B' d B)) A` of its 6 x 6 inputs d and the kernel g: 36 multiplications
//! for each pair of channels in place of 144 (A. Lavin, S. Gray, arXiv:1509.09308, section 4.3). Kernels are
//! transformed once, in f64. Vectors run over channels; the products of all tiles of a group at one of the 36 places
//! are a product of matrices, [tiles, inputs] by [inputs, outputs], whose sums stay in registers. In f32 the result
//! differs from the direct sum by a few 1e-6 of the largest output. It does not depend on how an image is cut into
//! patches, as long as their tiles lie on the same grid, or on threads.

use super::patch::{GROUP, Patch, padded};
use pulp::{Arch, Simd, WithSimd};

/// Side of a tile of outputs, and of its inputs.
pub const SIDE: usize = 4;
const INPUT: usize = SIDE + 2;
/// Number of products of a tile for each pair of channels.
const PLACES: usize = INPUT * INPUT;
/// Number of tiles of a group: its transformed values stay in the second-level cache.
const TILES: usize = 24;
/// Number of weights of a kernel.
const TAPS: usize = 9;

/// G, the transform of kernels.
const KERNEL: [[f64; 3]; INPUT] = [
    [0.25, 0.0, 0.0],
    [-1.0 / 6.0, -1.0 / 6.0, -1.0 / 6.0],
    [-1.0 / 6.0, 1.0 / 6.0, -1.0 / 6.0],
    [1.0 / 24.0, 1.0 / 12.0, 1.0 / 6.0],
    [1.0 / 24.0, -1.0 / 12.0, 1.0 / 6.0],
    [0.0, 0.0, 1.0],
];

/// The transformed kernels of a layer.
#[derive(Clone, Debug)]
pub struct Kernels {
    inputs: usize,
    outputs: usize,
    /// [place, input, output].
    data: Vec<f32>,
    /// One value for each output.
    bias: Vec<f32>,
}

impl Kernels {
    /// From weights [outputs, inputs, 3, 3] and the bias of each output.
    pub fn new(weight: &[f32], bias: &[f32]) -> Self {
        let count = weight.len() / (bias.len() * TAPS).max(1);
        let (inputs, outputs) = (padded(count), padded(bias.len()));
        let mut data = vec![0.0; PLACES * inputs * outputs];
        for (o, of_output) in weight.chunks_exact((count * TAPS).max(1)).enumerate() {
            for (i, g) in of_output.chunks_exact(TAPS).enumerate() {
                for (place, (a, b)) in KERNEL.iter().flat_map(|a| KERNEL.iter().map(move |b| (a, b))).enumerate() {
                    let sum: f64 = (0..TAPS).map(|k| a[k / 3] * b[k % 3] * f64::from(g[k])).sum();
                    data[(place * inputs + i) * outputs + o] = sum as f32;
                }
            }
        }
        let mut filled = bias.to_vec();
        filled.resize(outputs, 0.0);
        Self { inputs, outputs, data, bias: filled }
    }

    /// Number of output channels, those that fill the last group counted.
    pub fn outputs(&self) -> usize {
        self.outputs
    }
}

/// Working memory; each thread needs its own.
#[derive(Clone, Debug, Default)]
pub struct Scratch {
    /// Transformed inputs, [place, group of inputs, tile, input of the group].
    inputs: Vec<f32>,
    /// Products, [place, tile, output].
    products: Vec<f32>,
}

/// Rows or columns of the input patch of [`convolve`] for `n` rows or columns of outputs.
pub fn input_side(n: usize) -> usize {
    n.next_multiple_of(SIDE) + 2
}

/// `y[r, c, o] = bias[o] + sum_{i, u, v} w[o, i, u, v] x[r + u, c + v, i]` for `size` outputs, [rows, cols]. `y` gets
/// the size of whole tiles; what lies beyond `size` has no meaning. `x` has [`input_side`] rows and columns or more.
pub fn convolve(x: &Patch, kernels: &Kernels, size: [usize; 2], y: &mut Patch, scratch: &mut Scratch) {
    let [rows, cols] = size.map(|n| n.div_ceil(SIDE));
    y.resize(rows * SIDE, cols * SIDE, kernels.outputs);
    scratch.inputs.resize(PLACES * kernels.inputs * TILES, 0.0);
    scratch.products.resize(PLACES * kernels.outputs * TILES, 0.0);
    Arch::new().dispatch(Layer { x, kernels, tiles: [rows, cols], y, scratch });
}

struct Layer<'a> {
    x: &'a Patch,
    kernels: &'a Kernels,
    /// Rows and columns of tiles.
    tiles: [usize; 2],
    y: &'a mut Patch,
    scratch: &'a mut Scratch,
}

impl WithSimd for Layer<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let all = self.tiles[0] * self.tiles[1];
        for first in (0..all).step_by(TILES) {
            let count = TILES.min(all - first);
            for t in 0..count {
                self.load(simd, first + t, t);
            }
            // As many sums as there are registers for, and one for each of two vectors of weights and an input.
            match S::REGISTER_COUNT {
                32 => self.multiply::<S, 12>(simd, count),
                _ => self.multiply::<S, 6>(simd, count),
            }
            for t in 0..count {
                self.store(simd, first + t, t);
            }
        }
    }
}

impl Layer<'_> {
    /// First row and column of a tile.
    #[inline(always)]
    fn corner(&self, tile: usize) -> [usize; 2] {
        [tile / self.tiles[1] * SIDE, tile % self.tiles[1] * SIDE]
    }

    /// `B' d B` of a tile, as tile `t` of the group.
    #[inline(always)]
    fn load<S: Simd>(&mut self, simd: S, tile: usize, t: usize) {
        let ([row, col], n) = (self.corner(tile), self.x.channels);
        let groups = self.kernels.inputs / GROUP;
        for first in (0..self.kernels.inputs).step_by(S::F32_LANES) {
            let mut half = [[simd.splat_f32s(0.0); INPUT]; INPUT];
            for c in 0..INPUT {
                let column: [S::f32s; INPUT] = std::array::from_fn(|r| {
                    load(simd, &self.x.data[((row + r) * self.x.cols + col + c) * n + first..])
                });
                let column = input(simd, column);
                for (half, v) in half.iter_mut().zip(column) {
                    half[c] = v;
                }
            }
            let at = (first / GROUP * TILES + t) * GROUP + first % GROUP;
            for (r, row) in half.into_iter().enumerate() {
                for (c, v) in input(simd, row).into_iter().enumerate() {
                    let place = (r * INPUT + c) * groups * TILES * GROUP;
                    store(simd, &mut self.scratch.inputs[place + at..], v);
                }
            }
        }
    }

    /// The products of `count` tiles at all places, `T` tiles at a time.
    #[inline(always)]
    fn multiply<S: Simd, const T: usize>(&mut self, simd: S, count: usize) {
        let (inputs, outputs) = (self.kernels.inputs, self.kernels.outputs);
        for place in 0..PLACES {
            let x = &self.scratch.inputs[place * inputs * TILES..][..inputs * TILES];
            let w = &self.kernels.data[place * inputs * outputs..][..inputs * outputs];
            let y = &mut self.scratch.products[place * outputs * TILES..][..outputs * TILES];
            for t in (0..count).step_by(T) {
                let mut o = 0;
                while o < outputs {
                    if outputs - o >= 2 * S::F32_LANES {
                        product::<S, T, 2>(simd, [x, w], [t, o], outputs, y);
                        o += 2 * S::F32_LANES;
                    } else {
                        product::<S, T, 1>(simd, [x, w], [t, o], outputs, y);
                        o += S::F32_LANES;
                    }
                }
            }
        }
    }

    /// `A' m A` and the bias, of tile `t` of the group.
    #[inline(always)]
    fn store<S: Simd>(&mut self, simd: S, tile: usize, t: usize) {
        let ([row, col], n) = (self.corner(tile), self.kernels.outputs);
        for first in (0..n).step_by(S::F32_LANES) {
            let mut half = [[simd.splat_f32s(0.0); INPUT]; SIDE];
            for c in 0..INPUT {
                let column: [S::f32s; INPUT] = std::array::from_fn(|r| {
                    load(simd, &self.scratch.products[((r * INPUT + c) * TILES + t) * n + first..])
                });
                for (half, v) in half.iter_mut().zip(output(simd, column)) {
                    half[c] = v;
                }
            }
            let bias = load(simd, &self.kernels.bias[first..]);
            for (r, half) in half.into_iter().enumerate() {
                for (c, v) in output(simd, half).into_iter().enumerate() {
                    let at = ((row + r) * self.y.cols + col + c) * n + first;
                    store(simd, &mut self.y.data[at..], simd.add_f32s(v, bias));
                }
            }
        }
    }
}

/// Products of `T` tiles from tile `t` on with `V` vectors of outputs from output `o` on: `x` [group, tile, input of
/// the group], `w` [input, output], `y` [tile, output].
#[inline(always)]
fn product<S: Simd, const T: usize, const V: usize>(
    simd: S,
    [x, w]: [&[f32]; 2],
    [t, o]: [usize; 2],
    outputs: usize,
    y: &mut [f32],
) {
    let lanes = S::F32_LANES;
    let mut sums = [[simd.splat_f32s(0.0); V]; T];
    let groups = x.as_chunks::<GROUP>().0.chunks_exact(TILES).zip(w.chunks_exact(GROUP * outputs));
    for (x, w) in groups {
        let Some(x) = x[t..].first_chunk::<T>() else { return };
        for (i, w) in (0..GROUP).zip(w.chunks_exact(outputs)) {
            let w: [S::f32s; V] = std::array::from_fn(|v| load(simd, &w[o + v * lanes..]));
            for (sums, x) in sums.iter_mut().zip(x) {
                let x = simd.splat_f32s(x[i]);
                for (sum, w) in sums.iter_mut().zip(w) {
                    *sum = simd.mul_add_e_f32s(x, w, *sum);
                }
            }
        }
    }
    for (sums, y) in sums.iter().zip(y[t * outputs..].chunks_exact_mut(outputs)) {
        for (v, sum) in sums.iter().enumerate() {
            store(simd, &mut y[o + v * lanes..], *sum);
        }
    }
}

/// B' along one axis.
#[inline(always)]
fn input<S: Simd>(simd: S, [a, b, c, d, e, f]: [S::f32s; INPUT]) -> [S::f32s; INPUT] {
    let times = |k: f32, v, sum| simd.mul_add_e_f32s(simd.splat_f32s(k), v, sum);
    let (even, odd) = (times(-4.0, c, e), times(-4.0, b, d));
    let (even2, odd2) = (simd.sub_f32s(e, c), simd.sub_f32s(d, b));
    [
        times(4.0, a, times(-5.0, c, e)),
        simd.add_f32s(even, odd),
        simd.sub_f32s(even, odd),
        times(2.0, odd2, even2),
        times(-2.0, odd2, even2),
        times(4.0, b, times(-5.0, d, f)),
    ]
}

/// A' along one axis.
#[inline(always)]
fn output<S: Simd>(simd: S, [a, b, c, d, e, f]: [S::f32s; INPUT]) -> [S::f32s; SIDE] {
    let times = |k: f32, v, sum| simd.mul_add_e_f32s(simd.splat_f32s(k), v, sum);
    let (plus, minus) = (simd.add_f32s(b, c), simd.sub_f32s(b, c));
    let (plus2, minus2) = (simd.add_f32s(d, e), simd.sub_f32s(d, e));
    [
        simd.add_f32s(simd.add_f32s(a, plus), plus2),
        times(2.0, minus2, minus),
        times(4.0, plus2, plus),
        simd.add_f32s(times(8.0, minus2, minus), f),
    ]
}

/// The first lanes of a slice that holds at least as many.
#[inline(always)]
fn load<S: Simd>(_simd: S, from: &[f32]) -> S::f32s {
    S::as_simd_f32s(from).0[0]
}

#[inline(always)]
fn store<S: Simd>(_simd: S, to: &mut [f32], v: S::f32s) {
    S::as_mut_simd_f32s(to).0[0] = v;
}

#[cfg(test)]
mod tests {
    use super::super::conv::Conv3x3;
    use super::*;

    fn values(n: usize, seed: usize) -> Vec<f32> {
        (0..n).map(|i| (((i + seed) * 7919 + seed * 131) % 1009) as f32 / 504.5 - 1.0).collect()
    }

    #[test]
    fn equals_the_direct_sum() {
        for (inputs, outputs, rows, cols) in [(1, 1, 1, 1), (32, 32, 9, 26), (36, 16, 5, 7), (24, 50, 13, 40)] {
            let sizes = Conv3x3 { batch: 1, inputs, outputs, rows, cols };
            let x = values(inputs * rows * cols, 1);
            let (w, bias) = (values(outputs * inputs * 9, 2), values(outputs, 3));
            let want = sizes.forward(&x, &w, &bias);
            let mut patch = Patch::default();
            patch.resize(input_side(rows), input_side(cols), padded(inputs));
            for (i, v) in x.iter().enumerate() {
                let (channel, r, c) = (i / (rows * cols), i / cols % rows, i % cols);
                let at = (c + 1) * patch.channels + channel;
                patch.row_mut(r + 1)[at] = *v;
            }
            let (mut y, mut scratch) = (Patch::default(), Scratch::default());
            convolve(&patch, &Kernels::new(&w, &bias), [rows, cols], &mut y, &mut scratch);
            let top = want.iter().fold(0.0f32, |m, v| m.max(v.abs()));
            for (i, v) in want.iter().enumerate() {
                let (o, r, c) = (i / (rows * cols), i / cols % rows, i % cols);
                let got = y.row(r)[c * y.channels + o];
                assert!((got - v).abs() < 1e-5 * top, "{sizes:?}: {got} {v}");
            }
        }
    }
}
