//! Between halves in slow memory and lanes in fast scratch: all that a strip of columns or a group of rows needs.
//!
//! A single lane goes through [`pairs`], for which a Cortex-M has instructions; more lanes through loops that
//! become vector code. The values are the same.

use super::complex::{Fft, Lanes};
use crate::num::pairs::{self, Order, Parts};
use crate::num::{f16, narrow, widen};

/// Splits scratch into a strip of `len` complex numbers and the rest.
#[inline(always)]
pub(super) fn split<const L: usize>(scratch: &mut [f32], len: usize) -> (&mut [Lanes<L>], &mut [f32]) {
    let (strip, rest) = scratch.split_at_mut(2 * L * len);
    (strip.as_chunks_mut::<L>().0.as_chunks_mut::<2>().0, rest)
}

/// One lane as (re, im) pairs.
#[inline(always)]
fn single<const L: usize>(data: &mut [Lanes<L>]) -> &mut [[f32; 2]] {
    data.as_flattened_mut().as_flattened_mut().as_chunks_mut::<2>().0
}

/// Columns `first..first + count` of a spectrum whose rows are `row_len` halves, each row in its slot; zeros in idle lanes.
#[inline(always)]
pub(super) fn load<const L: usize>(
    spectrum: &[f16],
    row_len: usize,
    first: usize,
    count: usize,
    fft: Fft,
    strip: &mut [Lanes<L>],
) {
    if L == 1 {
        pairs::gather_pairs(&spectrum[2 * first..], row_len, Order::Reversed, single(strip));
        return;
    }
    for (r, row) in spectrum.chunks_exact(row_len).enumerate().take(fft.len()) {
        strip[fft.slot(r)] = widen_pairs::<L>(&row[2 * first..2 * (first + count)]);
    }
}

/// The reverse of [`load`] for numbers in natural order, scaled.
#[inline(always)]
pub(super) fn store<const L: usize>(
    strip: &mut [Lanes<L>],
    scale: f32,
    parts: Parts,
    spectrum: &mut [f16],
    row_len: usize,
    first: usize,
    count: usize,
) {
    if L == 1 {
        pairs::scatter_pairs(single(strip), scale, parts, &mut spectrum[2 * first..], row_len);
        return;
    }
    for (row, x) in spectrum.chunks_exact_mut(row_len).zip(&*strip) {
        let x = if parts == Parts::InOrder { *x } else { [x[1], x[0]] };
        narrow_pairs(&x, scale, &mut row[2 * first..2 * (first + count)]);
    }
}

/// Numbers 0 to N/2 of a real transform of each lane into up to L rows of halves; number 0 carries the last one too.
#[inline(always)]
pub(super) fn store_rows<const L: usize>(data: &mut [Lanes<L>], scale: f32, rows: &mut [f16], row_len: usize) {
    let [first, last] = data[0];
    for (lane, row) in rows.chunks_exact_mut(row_len).enumerate().take(L) {
        if L == 1 {
            pairs::scatter_pairs(single(data), scale, Parts::InOrder, row, 2);
        } else {
            for (pair, x) in row.as_chunks_mut::<2>().0.iter_mut().zip(&*data) {
                *pair = [narrow(x[0][lane] * scale), narrow(x[1][lane] * scale)];
            }
        }
        row[1] = f16::ZERO;
        row[0] = narrow(first[lane] * scale);
        row[row_len - 2] = narrow(last[lane] * scale);
        row[row_len - 1] = f16::ZERO;
    }
}

/// Adds the product of two spectra, columns `first..first + count`, to the strip, imaginary part first. `scratch`: four numbers a row.
///
/// `re = (re + kr xr) - ki xi`, `im = (im + kr xi) + ki xr`; the products are exact.
#[inline(always)]
pub(crate) fn add_product<const L: usize>(
    [k, x]: [&[f16]; 2],
    row_len: usize,
    first: usize,
    count: usize,
    fft: Fft,
    strip: &mut [Lanes<L>],
    scratch: &mut [f32],
) {
    if L == 1 {
        let (wide, _) = scratch.as_chunks_mut::<2>();
        let (wide_k, wide_x) = wide[..2 * fft.len()].split_at_mut(fft.len());
        pairs::gather_pairs(&k[2 * first..], row_len, Order::Natural, wide_k);
        pairs::gather_pairs(&x[2 * first..], row_len, Order::Natural, wide_x);
        for (r, (k, x)) in wide_k.iter().zip(wide_x).enumerate() {
            add(&mut strip[fft.slot(r)], [[k[0]; L], [k[1]; L]], [[x[0]; L], [x[1]; L]]);
        }
        return;
    }
    let columns = 2 * first..2 * (first + count);
    for (r, (k, x)) in k.chunks_exact(row_len).zip(x.chunks_exact(row_len)).enumerate() {
        add(&mut strip[fft.slot(r)], widen_pairs(&k[columns.clone()]), widen_pairs(&x[columns.clone()]));
    }
}

#[inline(always)]
fn add<const L: usize>([im, re]: &mut Lanes<L>, k: Lanes<L>, x: Lanes<L>) {
    for l in 0..L {
        re[l] = (re[l] + k[0][l] * x[0][l]) - k[1][l] * x[1][l];
        im[l] = (im[l] + k[0][l] * x[1][l]) + k[1][l] * x[0][l];
    }
}

/// Up to L consecutive rows of halves, number by number.
pub(super) struct Rows<'a> {
    rows: &'a [f16],
    row_len: usize,
    /// The only row, widened, if there is a single lane.
    wide: &'a [f32],
}

impl<'a> Rows<'a> {
    /// `scratch`: as many numbers as a row has halves.
    #[inline(always)]
    pub(super) fn new<const L: usize>(rows: &'a [f16], row_len: usize, scratch: &'a mut [f32]) -> Self {
        if L == 1 {
            crate::num::widen_slice(&rows[..row_len], &mut scratch[..row_len]);
        }
        Self { rows, row_len, wide: scratch }
    }

    /// Number `k` of each row; zeros in idle lanes.
    #[inline(always)]
    pub(super) fn at<const L: usize>(&self, k: usize) -> Lanes<L> {
        if L == 1 {
            return [[self.wide[2 * k]; L], [self.wide[2 * k + 1]; L]];
        }
        let mut x = [[0.0; L]; 2];
        for (l, row) in self.rows.chunks_exact(self.row_len).enumerate().take(L) {
            x[0][l] = widen(row[2 * k]);
            x[1][l] = widen(row[2 * k + 1]);
        }
        x
    }
}

/// Widens up to L pairs (re, im); zeros in idle lanes.
#[inline(always)]
fn widen_pairs<const L: usize>(pairs: &[f16]) -> Lanes<L> {
    let (pairs, _) = pairs.as_chunks::<2>();
    if let Some(pairs) = pairs.first_chunk::<L>() {
        return [core::array::from_fn(|l| widen(pairs[l][0])), core::array::from_fn(|l| widen(pairs[l][1]))];
    }
    let mut x = [[0.0; L]; 2];
    for (l, pair) in pairs.iter().enumerate() {
        x[0][l] = widen(pair[0]);
        x[1][l] = widen(pair[1]);
    }
    x
}

/// Scales and narrows up to L pairs.
#[inline(always)]
fn narrow_pairs<const L: usize>(x: &Lanes<L>, scale: f32, pairs: &mut [f16]) {
    let (pairs, _) = pairs.as_chunks_mut::<2>();
    if let Some(pairs) = pairs.first_chunk_mut::<L>() {
        for l in 0..L {
            pairs[l] = [narrow(x[0][l] * scale), narrow(x[1][l] * scale)];
        }
        return;
    }
    for (l, pair) in pairs.iter_mut().enumerate() {
        *pair = [narrow(x[0][l] * scale), narrow(x[1][l] * scale)];
    }
}
