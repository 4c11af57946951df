//! Strips of columns or rows: from halves in slow memory to lanes in fast scratch, and back.
//!
//! A single lane uses the Cortex-M routines, and four lanes use those in Helium where the core has it. Other numbers of
//! lanes use loops that the compiler vectorizes. The values are the same. Where a Helium routine cannot guarantee that,
//! it returns false, and the caller goes lane by lane.

use super::complex::{Fft, Lanes, single};
use super::real::RealFft;
#[cfg(all(target_arch = "arm", feature = "fpv4"))]
use crate::num::arm;
#[cfg(all(target_arch = "arm", feature = "fpv4", feature = "helium"))]
use crate::num::arm::helium;
use crate::num::pairs::{self, Parts};
use crate::num::{f16, narrow, widen};

/// Splits scratch into a strip of `len` complex numbers and the rest.
#[inline(always)]
pub(super) fn split<const L: usize>(scratch: &mut [f32], len: usize) -> (&mut [Lanes<L>], &mut [f32]) {
    let (strip, rest) = scratch.split_at_mut(2 * L * len);
    (strip.as_chunks_mut::<L>().0.as_chunks_mut::<2>().0, rest)
}

/// Whether L lanes can hold `count` rows or columns: Helium's loops leave no lane idle.
#[inline(always)]
pub(super) const fn holds<const L: usize>(count: usize) -> bool {
    count == L || (count < L && !HELIUM)
}

/// Whether the core has Helium.
pub(super) const HELIUM: bool = cfg!(all(target_arch = "arm", feature = "fpv4", feature = "helium"));

/// Four lanes in the type of the Helium routines.
#[cfg(all(target_arch = "arm", feature = "fpv4", feature = "helium"))]
#[inline(always)]
fn four<const L: usize>(data: &mut [Lanes<L>]) -> &mut [Lanes<4>] {
    data.as_flattened_mut().as_flattened_mut().as_chunks_mut::<4>().0.as_chunks_mut::<2>().0
}

/// Transforms columns `first..first + count` of a spectrum whose rows are `row_len` halves, and scales them.
#[inline(always)]
pub(super) fn forward_columns<const L: usize>(
    spectrum: &mut [f16],
    row_len: usize,
    (first, count): (usize, usize),
    fft: Fft,
    scale: f32,
    strip: &mut [Lanes<L>],
) -> bool {
    #[cfg(all(target_arch = "arm", feature = "fpv4", feature = "helium"))]
    if L == 4 {
        return helium::forward_columns(&mut spectrum[2 * first..], row_len, scale, four(strip));
    }
    load(spectrum, row_len, first, count, fft, strip);
    fft.process(strip);
    store(strip, Parts::Scaled(scale), spectrum, row_len, first, count);
    true
}

/// Loads columns `first..first + count` of a spectrum, each row to its slot; idle lanes are zero.
#[inline(always)]
fn load<const L: usize>(
    spectrum: &[f16],
    row_len: usize,
    first: usize,
    count: usize,
    fft: Fft,
    strip: &mut [Lanes<L>],
) {
    if L == 1 {
        pairs::gather_pairs(&spectrum[2 * first..], row_len, single(strip));
        return;
    }
    for (r, row) in spectrum.chunks_exact(row_len).enumerate().take(fft.len()) {
        strip[fft.slot(r)] = widen_pairs::<L>(&row[2 * first..2 * (first + count)]);
    }
}

/// Transforms the sum of products of two spectra, columns `first..first + count`, imaginary part first.
///
/// `re = (re + kr xr) - ki xi`, `im = (im + kr xi) + ki xr`; the products are exact. The first is added to -0, which
/// leaves it as it is.
#[inline(always)]
pub(super) fn inverse_columns<'s, const L: usize>(
    products: impl Iterator<Item = [&'s [f16]; 2]>,
    row_len: usize,
    (first, count): (usize, usize),
    fft: Fft,
    strip: &mut [Lanes<L>],
) -> bool {
    #[cfg(all(target_arch = "arm", feature = "fpv4", feature = "helium"))]
    if L == 4 {
        let strip = four(strip);
        let products = &mut products.map(|product| product.map(|spectrum| &spectrum[2 * first..]));
        let begin = [products.next(), products.next()];
        if let [Some(only), None] = begin {
            return helium::transform_product_columns(only, row_len, strip);
        }
        strip.fill([[-0.0; 4]; 2]);
        for product in begin.into_iter().flatten().chain(products) {
            helium::add_product_columns(product, row_len, strip);
        }
        return helium::transform_columns(strip);
    }
    strip.fill([[-0.0; L]; 2]);
    products.for_each(|product| add_product(product, row_len, (first, count), fft, strip));
    fft.process(strip);
    true
}

/// Stores numbers in natural order to columns of a spectrum.
#[inline(always)]
pub(super) fn store<const L: usize>(
    strip: &mut [Lanes<L>],
    parts: Parts,
    spectrum: &mut [f16],
    row_len: usize,
    first: usize,
    count: usize,
) {
    if L == 1 {
        pairs::scatter_pairs(single(strip), parts, &mut spectrum[2 * first..], row_len);
        return;
    }
    #[cfg(all(target_arch = "arm", feature = "fpv4", feature = "helium"))]
    if L == 4 {
        return helium::scatter_columns(four(strip), parts, &mut spectrum[2 * first..], row_len);
    }
    for (row, x) in spectrum.chunks_exact_mut(row_len).zip(&*strip) {
        narrow_pairs(x, parts, &mut row[2 * first..2 * (first + count)]);
    }
}

/// Writes twice the real transforms of `count` rows to rows of halves. `load` supplies the rows; `data` and `scratch`
/// are scratch.
#[inline(always)]
pub(super) fn forward_rows<const L: usize>(
    mut load: impl FnMut(usize, &mut [f32]),
    count: usize,
    fft: RealFft,
    (data, scratch): (&mut [Lanes<L>], &mut [f32]),
    rows: &mut [f16],
) -> bool {
    let half = fft.half();
    let (len, row_len) = (2 * half.len(), 2 * half.len() + 2);
    #[cfg(all(target_arch = "arm", feature = "fpv4", feature = "helium"))]
    if L == 4 {
        let from = &mut scratch[..4 * len];
        from.chunks_exact_mut(len).enumerate().for_each(|(lane, row)| load(lane, row));
        return helium::forward_rows(from, four(data), rows);
    }
    let row = &mut scratch[..len];
    for lane in 0..L {
        if lane < count {
            load(lane, row);
        } else {
            row.fill(0.0);
        }
        order_row(row, half, lane, data);
    }
    half.process(data);
    untangle_rows(fft, data, rows, row_len);
    true
}

/// Writes the pairs of a row to one lane of `data`, each to its slot.
#[inline(always)]
fn order_row<const L: usize>(row: &[f32], half: Fft, lane: usize, data: &mut [Lanes<L>]) {
    #[cfg(all(target_arch = "arm", feature = "fpv4"))]
    if L == 1 {
        return arm::order_row(row, single(data));
    }
    for (n, pair) in row.as_chunks::<2>().0.iter().enumerate() {
        let slot = &mut data[half.slot(n)];
        slot[0][lane] = pair[0];
        slot[1][lane] = pair[1];
    }
}

/// Converts up to L rows after the complex transform of half their length, and writes them to `rows`.
#[inline(always)]
fn untangle_rows<const L: usize>(fft: RealFft, data: &mut [Lanes<L>], rows: &mut [f16], row_len: usize) {
    #[cfg(all(target_arch = "arm", feature = "fpv4"))]
    if L == 1 {
        let (data, half) = (single(data), fft.half().len());
        let row = &mut rows[..row_len];
        arm::untangle_row(data, row);
        let [[re, im], middle] = [data[0], data[half / 2]];
        store_ends(2.0 * (re + im), 2.0 * (re - im), row);
        row[half] = narrow(2.0 * middle[0]);
        row[half + 1] = narrow(-2.0 * middle[1]);
        return;
    }
    fft.untangle(data);
    let [first, last] = data[0];
    for (lane, row) in rows.chunks_exact_mut(row_len).enumerate().take(L) {
        for (pair, x) in row.as_chunks_mut::<2>().0.iter_mut().zip(&*data) {
            *pair = [narrow(x[0][lane]), narrow(x[1][lane])];
        }
        store_ends(first[lane], last[lane], row);
    }
}

/// Writes numbers 0 and N/2 of a row, which are real.
#[inline(always)]
fn store_ends(first: f32, last: f32, row: &mut [f16]) {
    if let [re, im, .., last_re, last_im] = row {
        (*re, *im) = (narrow(first), f16::ZERO);
        (*last_re, *last_im) = (narrow(last), f16::ZERO);
    }
}

/// Computes the inverse real transforms of up to L rows of halves, scaled, and calls `emit(lane, row)` with each.
/// `rows` is scratch.
#[inline(always)]
pub(super) fn inverse_rows<const L: usize>(
    fft: RealFft,
    from: &[f16],
    row_len: usize,
    scale: f32,
    data: &mut [Lanes<L>],
    rows: &mut [f32],
    mut emit: impl FnMut(usize, &[f32]),
) -> bool {
    let half = fft.half().len();
    #[cfg(all(target_arch = "arm", feature = "fpv4", feature = "helium"))]
    if L == 4 {
        let rows = &mut rows[..8 * half];
        let exact = helium::inverse_rows(from, four(data), scale, rows);
        if exact {
            rows.chunks_exact(2 * half).enumerate().for_each(|(lane, row)| emit(lane, row));
        }
        return exact;
    }
    tangle_rows(fft, from, row_len, data);
    fft.inverse(data);
    let row = &mut rows[..2 * half];
    for lane in 0..from.len() / row_len {
        scale_row(data, lane, scale, row);
        emit(lane, row);
    }
    true
}

/// Writes the input of [`RealFft::inverse`] to the slots.
#[inline(always)]
fn tangle_rows<const L: usize>(fft: RealFft, rows: &[f16], row_len: usize, data: &mut [Lanes<L>]) {
    let (half, quarter) = (fft.half().len(), fft.half().len() / 2);
    let (slot, at) = (|k| fft.half().slot(k), |k| number::<L>(rows, row_len, k));
    data[slot(0)] = fft.tangle_ends(at(0)[0], at(half)[0]);
    data[slot(quarter)] = fft.tangle_middle(at(quarter));
    #[cfg(all(target_arch = "arm", feature = "fpv4"))]
    if L == 1 {
        return arm::tangle_row(&rows[..row_len], single(data));
    }
    for k in 1..quarter {
        [data[slot(k)], data[slot(half - k)]] = fft.tangle(k, at(k), at(half - k));
    }
}

/// Writes one lane of pairs, imaginary part first, to a row, scaled.
#[inline(always)]
fn scale_row<const L: usize>(data: &mut [Lanes<L>], lane: usize, scale: f32, row: &mut [f32]) {
    #[cfg(all(target_arch = "arm", feature = "fpv4"))]
    if L == 1 {
        return arm::scale_row(single(data), scale, row);
    }
    for (pair, x) in row.as_chunks_mut::<2>().0.iter_mut().zip(&*data) {
        *pair = [x[1][lane] * scale, x[0][lane] * scale];
    }
}

/// Adds the product of two spectra, columns `first..first + count`, to the strip.
#[inline(always)]
fn add_product<const L: usize>(
    [k, x]: [&[f16]; 2],
    row_len: usize,
    (first, count): (usize, usize),
    fft: Fft,
    strip: &mut [Lanes<L>],
) {
    if L == 1 {
        return pairs::add_products(&k[2 * first..], &x[2 * first..], row_len, single(strip));
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

/// Number `k` of each of up to L rows; zeros in idle lanes.
#[inline(always)]
fn number<const L: usize>(rows: &[f16], row_len: usize, k: usize) -> Lanes<L> {
    let mut x = [[0.0; L]; 2];
    for (l, row) in rows.chunks_exact(row_len).enumerate().take(L) {
        x[0][l] = widen(row[2 * k]);
        x[1][l] = widen(row[2 * k + 1]);
    }
    x
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

/// Narrows up to L pairs.
#[inline(always)]
fn narrow_pairs<const L: usize>(x: &Lanes<L>, parts: Parts, pairs: &mut [f16]) {
    let (pairs, _) = pairs.as_chunks_mut::<2>();
    if let Some(pairs) = pairs.first_chunk_mut::<L>() {
        for l in 0..L {
            pairs[l] = parts.of([x[0][l], x[1][l]]);
        }
        return;
    }
    for (l, pair) in pairs.iter_mut().enumerate() {
        *pair = parts.of([x[0][l], x[1][l]]);
    }
}
