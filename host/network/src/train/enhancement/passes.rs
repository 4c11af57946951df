//! Passes of layers over the field, in strips of rows that are shared out to the cores, and in patches of them.

use super::super::ops::patch::Patch;
use super::super::ops::winograd::{Kernels, Scratch, convolve, input_side};
use super::tail::{MARGIN, Tail, edge};
use rayon::prelude::*;
use std::ops::Range;

/// Rows of a strip.
const STRIP: usize = 32;
/// Most columns of a patch: with its channels it stays in the second-level cache.
const WIDE: usize = 100;

/// What a layer reads.
pub trait Source: Sync {
    /// Number of channels, a multiple of the group.
    fn channels(&self) -> usize;

    /// Writes pixels of row `r`, [cols, channels].
    fn load(&self, r: usize, cols: Range<usize>, to: &mut [f32]);
}

/// A plane, `base + gate add`, [rows, cols, channels].
pub struct Gated<'a> {
    pub base: &'a Patch,
    /// What is added, and the factor of each channel.
    pub add: Option<(&'a Patch, &'a [f32])>,
}

impl Source for Gated<'_> {
    fn channels(&self) -> usize {
        self.base.channels
    }

    fn load(&self, r: usize, cols: Range<usize>, to: &mut [f32]) {
        let n = self.base.channels;
        let here = cols.start * n..cols.end * n;
        let base = &self.base.row(r)[here.clone()];
        match self.add {
            None => to.copy_from_slice(base),
            Some((add, gate)) => {
                let pixels = to.chunks_exact_mut(n).zip(base.chunks_exact(n)).zip(add.row(r)[here].chunks_exact(n));
                for ((to, base), add) in pixels {
                    to.iter_mut().zip(base).zip(add).zip(gate).for_each(|(((to, b), a), g)| *to = b + a * g);
                }
            }
        }
    }
}

/// Filter outputs x, [C, 2 rows, 2 cols], behind PixelUnshuffle 2, times `scale`: [rows, cols, 4 C].
pub struct Unshuffled<'a> {
    pub x: &'a [f32],
    /// Rows and columns of x.
    pub size: [usize; 2],
    pub scale: f32,
    /// 4 C and the channels that fill the last group.
    pub channels: usize,
}

impl Source for Unshuffled<'_> {
    fn channels(&self) -> usize {
        self.channels
    }

    fn load(&self, r: usize, cols: Range<usize>, to: &mut [f32]) {
        let [rows, width] = self.size;
        to.fill(0.0);
        for (c, image) in self.x.chunks_exact(rows * width).enumerate() {
            for dy in 0..2 {
                let row = &image[(2 * r + dy) * width..][2 * cols.start..2 * cols.end];
                let first = 4 * c + 2 * dy;
                for (to, pair) in to.chunks_exact_mut(self.channels).zip(row.chunks_exact(2)) {
                    to[first] = pair[0] * self.scale;
                    to[first + 1] = pair[1] * self.scale;
                }
            }
        }
    }
}

/// Working memory of a thread.
#[derive(Default)]
struct Work {
    patches: [Patch; 3],
    scratch: Scratch,
}

/// A residual block up to its attention: `r = conv(relu(conv(x)))`. Writes x to `kept` (of the size of r, or empty),
/// and returns the sums of r over the field, one for each channel.
pub fn block(source: &impl Source, [first, second]: &[Kernels; 2], r: &mut Patch, kept: &mut [f32]) -> Vec<f64> {
    let (rows, cols, n) = (r.rows, r.cols, r.channels);
    let strip = STRIP * cols * n;
    let mut kept = kept.chunks_mut(strip);
    let strips: Vec<_> = r.data.chunks_mut(strip).map(|r| (r, kept.next().unwrap_or_default())).collect();
    let one = |Work { patches: [x, t, y], scratch }: &mut Work, (s, (r, kept)): (usize, (&mut [f32], &mut [f32]))| {
        let (from, height) = (s * STRIP, r.len() / (cols * n));
        let mut sums = vec![0.0f64; n];
        for part in parts(cols) {
            let width = part.len();
            // Row and column 0 of x lie two before those of r, and those of t one before.
            let between = [height, width].map(input_side);
            fill(source, [rows, cols], [from, part.start], 2, between, x);
            convolve(x, first, between, t, scratch);
            t.data.iter_mut().for_each(|v| *v = v.max(0.0));
            t.keep(inside(from, height, rows), inside(part.start, width, cols));
            convolve(t, second, [height, width], y, scratch);
            for i in 0..height {
                let here = (i * cols + part.start) * n..(i * cols + part.end) * n;
                let row = &y.row(i)[..width * n];
                r[here.clone()].copy_from_slice(row);
                let mut sum = vec![0.0f32; n];
                row.chunks_exact(n).for_each(|p| sum.iter_mut().zip(p).for_each(|(s, v)| *s += v));
                sums.iter_mut().zip(sum).for_each(|(s, v)| *s += f64::from(v));
                if !kept.is_empty() {
                    kept[here].copy_from_slice(&x.row(i + 2)[2 * n..(2 + width) * n]);
                }
            }
        }
        sums
    };
    let sums: Vec<Vec<f64>> = strips.into_par_iter().enumerate().map_init(Work::default, one).collect();
    let zero = vec![0.0; n];
    sums.into_iter().fold(zero, |all, one| all.iter().zip(one).map(|(a, b)| a + b).collect())
}

/// `out = conv(x)`, and `residual` added to it.
pub fn layer(source: &impl Source, kernels: &Kernels, residual: Option<&Patch>, out: &mut Patch) {
    let (rows, cols, n) = (out.rows, out.cols, out.channels);
    let one = |Work { patches: [x, y, _], scratch }: &mut Work, (s, out): (usize, &mut [f32])| {
        let (from, height) = (s * STRIP, out.len() / (cols * n));
        for part in parts(cols) {
            let width = part.len();
            fill(source, [rows, cols], [from, part.start], 1, [height, width], x);
            convolve(x, kernels, [height, width], y, scratch);
            for i in 0..height {
                let out = &mut out[(i * cols + part.start) * n..(i * cols + part.end) * n];
                let row = &y.row(i)[..width * n];
                match residual {
                    None => out.copy_from_slice(row),
                    Some(residual) => {
                        let residual = &residual.row(from + i)[part.start * n..part.end * n];
                        out.iter_mut().zip(row).zip(residual).for_each(|((o, y), x)| *o = y + x);
                    }
                }
            }
        }
    };
    out.data.par_chunks_mut(STRIP * cols * n).enumerate().for_each_init(Work::default, one);
}

/// The logits, [2 rows, 2 cols], of features.
pub fn logits(x: &Patch, tail: &Tail) -> Vec<f32> {
    let (rows, cols) = (x.rows, x.cols);
    let mut out = vec![0.0; 4 * rows * cols];
    let source = Gated { base: x, add: None };
    let one = |Work { patches: [x, ..], .. }: &mut Work, (s, out): (usize, &mut [f32])| {
        let (from, height) = (s * STRIP, out.len() / (4 * cols));
        for part in parts(cols) {
            let margin = 2 * MARGIN - 2;
            fill(&source, [rows, cols], [from, part.start], MARGIN, [height + margin, part.len() + margin], x);
            let ends = [part.start == 0, part.end == cols];
            for (i, pair) in out.chunks_exact_mut(4 * cols).enumerate() {
                let (upper, lower) = pair.split_at_mut(2 * cols);
                let [upper, lower] = [upper, lower].map(|row| &mut row[2 * part.start..2 * part.end]);
                tail.row(x, i, edge(from + i, rows), ends, [upper, lower]);
            }
        }
    };
    out.par_chunks_mut(STRIP * 4 * cols).enumerate().for_each_init(Work::default, one);
    out
}

/// The columns of the patches of a strip, all but the last of the same width, which is a multiple of a tile's.
fn parts(cols: usize) -> impl Iterator<Item = Range<usize>> {
    let width = cols.div_ceil(cols.div_ceil(WIDE)).next_multiple_of(4);
    (0..cols).step_by(width).map(move |first| first..(first + width).min(cols))
}

/// The rows or columns of an intermediate patch, which begins one before `from`, that lie in an image of `n`.
fn inside(from: usize, size: usize, n: usize) -> Range<usize> {
    usize::from(from == 0)..(n + 1 - from).min(size + 2)
}

/// Fills a patch whose first pixel lies `margin` rows and columns before `from`, for `size` outputs of a 3x3
/// convolution; zero outside the image of [rows, cols].
fn fill(
    source: &impl Source,
    [rows, cols]: [usize; 2],
    from: [usize; 2],
    margin: usize,
    size: [usize; 2],
    patch: &mut Patch,
) {
    let n = source.channels();
    patch.resize(input_side(size[0]), input_side(size[1]), n);
    let (height, width) = (patch.rows, patch.cols);
    let first = margin.saturating_sub(from[1]);
    let left = from[1] + first - margin;
    // Whole tiles may go beyond what is asked for, but not beyond the image.
    let last = (first + cols - left).min(width);
    for r in 0..height {
        let row = patch.row_mut(r);
        match (from[0] + r).checked_sub(margin).filter(|r| *r < rows) {
            None => row.fill(0.0),
            Some(r) => {
                row[..first * n].fill(0.0);
                source.load(r, left..left + last - first, &mut row[first * n..last * n]);
                row[last * n..].fill(0.0);
            }
        }
    }
}
