//! The bank against spatial convolution in f64, and its tapped form against the dense one.

extern crate std;

use std::vec;
use std::vec::Vec;

use super::*;
use crate::blob::{Bank, Blocks, Size, Tap};
use crate::image::{ChwMut, Region};
use crate::naive::{self, Noise};
use crate::num::{f16, simd::Simd};

/// Roundings to half: spectrum of the filter, of the rows, of the window, half-way back, result; each 2^-12 r.m.s. of
/// its tensor, relative to the largest output.
const TOLERANCE: f64 = 1.5e-3;

struct Frame<'a>(&'a [f32], usize);

impl FrameRows for Frame<'_> {
    fn load(&self, row: usize, first: usize, to: &mut [f32]) {
        to.copy_from_slice(&self.0[row * self.1 + first..][..to.len()]);
    }
}

fn frame(size: Size) -> Vec<f32> {
    let mut noise = Noise(3);
    (0..usize::from(size.rows) * usize::from(size.cols)).map(|_| 0.5 + 0.5 * noise.next()).collect()
}

/// `rfft2(kernel)` as halves, kernel of side n with lags modulo n.
fn spectrum(kernel: &[f64], n: usize) -> Vec<f16> {
    let pairs: Vec<[f64; 2]> = kernel.iter().map(|&k| [k, 0.0]).collect();
    let full = crate::fft::naive::dft2(&pairs, n, false);
    let row = |row: &[[f64; 2]]| row[..n / 2 + 1].to_vec();
    full.chunks(n).flat_map(row).flatten().map(f16::from_f64).collect()
}

fn run(bank: &Bank, spectra: &[f16], frame: &[f32], size: Size, object: Size, wide: bool) -> Vec<f16> {
    run_filters(bank, Filters { halves: spectra, index: &[] }, frame, size, object, wide)
}

fn run_filters(bank: &Bank, filters: Filters<'_>, frame: &[f32], size: Size, object: Size, wide: bool) -> Vec<f16> {
    let plan = FilterBank::new(bank, size, object).unwrap();
    let mut output = vec![f16::NAN; plan.output_len()];
    let mut arena = vec![f16::NAN; plan.arena_len() + 3];
    let len = if wide { plan.scratch_len_wide() } else { plan.scratch_len() };
    let mut scratch = vec![f32::NAN; len + 3];
    let shape = [bank.channels, object.rows as u8, object.cols as u8].map(usize::from);
    let tensor = ChwMut::new(&mut output, shape[0], shape[1], shape[2]).unwrap();
    let simd = if wide { Simd::detect() } else { Simd::PORTABLE };
    let source = Frame(frame, usize::from(size.cols));
    let arena_len = plan.arena_len();
    plan.process(simd, Some(&source), filters, tensor, &mut arena[..arena_len], &mut scratch[..len]).unwrap();
    assert!(arena[arena_len..].iter().all(|x| x.is_nan()) && scratch[len..].iter().all(|x| x.is_nan()));
    output
}

/// The same for a part of the object.
fn run_part(bank: &Bank, filters: Filters<'_>, frame: &[f32], size: Size, object: Size, part: Region) -> Vec<f16> {
    let plan = FilterBank::new(bank, size, object).unwrap().of_part(part).unwrap();
    let (mut output, mut arena) = (vec![f16::NAN; plan.output_len()], vec![f16::NAN; plan.arena_len()]);
    let mut scratch = vec![f32::NAN; plan.scratch_len()];
    let tensor = ChwMut::new(&mut output, bank.channels.into(), part.rows.into(), part.cols.into()).unwrap();
    let source = Frame(frame, usize::from(size.cols));
    plan.process(Simd::detect(), Some(&source), filters, tensor, &mut arena, &mut scratch).unwrap();
    output
}

fn dense_bank(tile: u16, step: u16, channels: u8) -> Bank {
    let taps = (0..channels).map(|channel| Tap { channel, dy: 0, dx: 0 }).collect();
    Bank { tile, step, channels, taps, blocks: None }
}

/// Centre of the padded plane, circular convolution, centre crop: the paper's layer, spelled out in space.
fn by_definition(kernel: &[f64], n: usize, frame: &[f32], size: Size, object: Size) -> Vec<f64> {
    let (rows, cols) = (usize::from(size.rows), usize::from(size.cols));
    let mut plane = vec![0.0; n * n];
    for (i, &y) in frame.iter().enumerate() {
        plane[((n - rows) / 2 + i / cols) * n + (n - cols) / 2 + i % cols] = f64::from(y);
    }
    let out = naive::circular(kernel, &plane, n);
    let (rows, cols) = (usize::from(object.rows), usize::from(object.cols));
    let at = |i: usize| out[((n - rows) / 2 + i / cols) * n + (n - cols) / 2 + i % cols];
    (0..rows * cols).map(at).collect()
}

/// Foci of a few pixels at the given lags, modulo n.
fn foci(n: usize, lags: &[(i32, i32)], seed: u32) -> Vec<f64> {
    let mut noise = Noise(seed);
    let mut kernel = vec![0.0; n * n];
    for (y, x) in lags {
        for (dy, dx) in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dy, dx))) {
            let wrap = |lag: i32| lag.rem_euclid(n as i32) as usize;
            kernel[wrap(y + dy) * n + wrap(x + dx)] = f64::from(noise.next());
        }
    }
    kernel
}

#[test]
fn a_spectrum_of_ones_crops_the_centre() {
    let (size, object) = (Size { rows: 11, cols: 14 }, Size { rows: 6, cols: 4 });
    let frame = frame(size);
    let plan_len = 16 * 9;
    let ones: Vec<f16> = (0..2 * plan_len).map(|i| if i % 2 == 0 { f16::ONE } else { f16::ZERO }).collect();
    let out = run(&dense_bank(16, 16, 1), &ones, &frame, size, object, true);
    // Frame at ((16 - 11) / 2, (16 - 14) / 2) = (2, 1), object at (5, 6): frame pixel (3, 5) comes first.
    for (i, found) in out.iter().enumerate() {
        let expected = f64::from(frame[(3 + i / 4) * 14 + 5 + i % 4]);
        assert!((found.to_f64() - expected).abs() < TOLERANCE, "{i}: {found} {expected}");
    }
}

#[test]
fn the_dense_layer_is_circular_convolution_on_the_padded_plane() {
    for (n, size, object) in [
        (32, Size { rows: 32, cols: 32 }, Size { rows: 32, cols: 32 }),
        (32, Size { rows: 27, cols: 30 }, Size { rows: 14, cols: 12 }),
        (64, Size { rows: 54, cols: 53 }, Size { rows: 24, cols: 24 }),
    ] {
        let frame = frame(size);
        let mut noise = Noise(5);
        let kernels: Vec<Vec<f64>> =
            (0..2).map(|_| (0..n * n).map(|_| f64::from(noise.next()) / n as f64).collect()).collect();
        let spectra: Vec<f16> = kernels.iter().flat_map(|kernel| spectrum(kernel, n)).collect();
        let expected: Vec<f64> = kernels.iter().flat_map(|k| by_definition(k, n, &frame, size, object)).collect();
        let found = run(&dense_bank(n as u16, n as u16, 2), &spectra, &frame, size, object, true);
        let error = naive::error(&found, &expected);
        assert!(error < TOLERANCE, "{n}: {error:e}");
        // Neither the lanes nor a step that just covers the object change a bit.
        assert_eq!(run(&dense_bank(n as u16, n as u16, 2), &spectra, &frame, size, object, false), found);
        let step = object.rows.max(object.cols);
        assert_eq!(run(&dense_bank(n as u16, step, 2), &spectra, &frame, size, object, true), found);
    }
}

/// Splits a kernel of side n into taps of a small transform, each with the lags -S/2 <= l < S/2 about -dy S, -dx S.
fn tapped(kernels: &[Vec<f64>], n: i32, tile: i32, step: i32) -> (Bank, Vec<f16>) {
    let (tile_px, step_px) = (tile as u16, step as u16);
    let mut bank =
        Bank { tile: tile_px, step: step_px, channels: kernels.len() as u8, taps: Default::default(), blocks: None };
    let mut spectra = vec![];
    let reach = n / 2 / step;
    for (channel, kernel) in kernels.iter().enumerate() {
        for (dy, dx) in (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dy, dx))) {
            let mut part = vec![0.0; (tile * tile) as usize];
            for (y, x) in (-step / 2..step / 2).flat_map(|y| (-step / 2..step / 2).map(move |x| (y, x))) {
                let (lag_y, lag_x) = (y - dy * step, x - dx * step);
                if [lag_y, lag_x].iter().all(|lag| (-n / 2..n / 2).contains(lag)) {
                    let from = lag_y.rem_euclid(n) * n + lag_x.rem_euclid(n);
                    part[(y.rem_euclid(tile) * tile + x.rem_euclid(tile)) as usize] = kernel[from as usize];
                }
            }
            if part.iter().any(|&k| k != 0.0) {
                bank.taps.push(Tap { channel: channel as u8, dy: dy as i8, dx: dx as i8 }).unwrap();
                spectra.extend(spectrum(&part, tile as usize));
            }
        }
    }
    (bank, spectra)
}

#[test]
fn the_tapped_form_equals_the_dense_one_for_compact_foci() {
    let (n, size) = (64, Size { rows: 51, cols: 54 });
    // Foci of different channels in different places; none so far out that the dense layer wraps round.
    let lags: [&[(i32, i32)]; 2] = [&[(0, 0), (-15, 4), (7, -12)], &[(3, 14), (-2, -9)]];
    let kernels: Vec<Vec<f64>> = lags.iter().enumerate().map(|(i, lags)| foci(n, lags, 7 + i as u32)).collect();
    let frame = frame(size);
    for object in [Size { rows: 24, cols: 24 }, Size { rows: 20, cols: 26 }, Size { rows: 6, cols: 10 }] {
        let expected: Vec<f64> = kernels.iter().flat_map(|k| by_definition(k, n, &frame, size, object)).collect();
        let spectra: Vec<f16> = kernels.iter().flat_map(|kernel| spectrum(kernel, n)).collect();
        let dense = run(&dense_bank(64, 64, 2), &spectra, &frame, size, object, true);
        assert!(naive::error(&dense, &expected) < TOLERANCE);
        for (tile, step) in [(16, 8), (32, 16), (32, 8)] {
            let (bank, spectra) = tapped(&kernels, n as i32, tile, step);
            let found = run(&bank, &spectra, &frame, size, object, true);
            let error = naive::error(&found, &expected);
            assert!(error < TOLERANCE, "T = {tile}, S = {step}, object {object:?}: {error:e}");
            assert_eq!(run(&bank, &spectra, &frame, size, object, false), found);
        }
    }
}

/// The blocks of kernels of side n that hold anything, times n as the device scales both its transforms, and their
/// index.
fn in_blocks(kernels: &[Vec<f64>], n: usize, side: usize, object: Size) -> (Bank, Vec<f16>, Vec<u16>) {
    let (mut halves, mut starts, mut columns) = (vec![], vec![0], vec![]);
    let lead = [object.rows, object.cols].map(|m| (n - usize::from(m)) / 2);
    for kernel in kernels {
        for row in 0..n / side {
            for column in 0..n / side {
                let lag = |i: usize, axis: usize| (i + n - lead[axis]) % n;
                let at = |i: usize| lag(row * side + i / side, 0) * n + lag(column * side + i % side, 1);
                let block: Vec<f64> = (0..side * side).map(|i| kernel[at(i)] * n as f64).collect();
                if block.iter().any(|&k| k != 0.0) {
                    halves.extend(block.into_iter().map(f16::from_f64));
                    columns.push(column as u16);
                }
            }
            starts.push(columns.len() as u16);
        }
    }
    let blocks = Some(Blocks { side: side as u16, count: columns.len() as u16 });
    let bank = Bank { blocks, ..dense_bank(n as u16, n as u16, kernels.len() as u8) };
    (bank, halves, [starts, columns].concat())
}

#[test]
fn kernels_in_blocks_equal_their_spectra() {
    let (n, size) = (64, Size { rows: 51, cols: 54 });
    // Round the origin, at the ends of the plane, and none at all.
    let lags: [&[(i32, i32)]; 3] = [&[(0, 0), (-15, 4), (7, -12)], &[(31, -32), (-2, -9)], &[]];
    let kernels: Vec<Vec<f64>> = lags.iter().enumerate().map(|(i, lags)| foci(n, lags, 7 + i as u32)).collect();
    let frame = frame(size);
    for object in [Size { rows: 24, cols: 24 }, Size { rows: 20, cols: 26 }, Size { rows: 6, cols: 50 }] {
        let expected: Vec<f64> = kernels.iter().flat_map(|k| by_definition(k, n, &frame, size, object)).collect();
        for side in [1, 4, 8, 64] {
            let (bank, halves, index) = in_blocks(&kernels, n, side, object);
            let filters = Filters { halves: &halves, index: &index };
            let found = run_filters(&bank, filters, &frame, size, object, true);
            let error = naive::error(&found, &expected);
            assert!(error < TOLERANCE, "B = {side}, object {object:?}: {error:e}");
            assert_eq!(run_filters(&bank, filters, &frame, size, object, false), found);
        }
    }
}

#[test]
fn an_index_out_of_order_is_refused() {
    let (size, object) = (Size { rows: 14, cols: 14 }, Size { rows: 8, cols: 8 });
    let (bank, halves, good) = in_blocks(&[foci(16, &[(0, 0), (5, 5)], 1), foci(16, &[(2, -3)], 2)], 16, 4, object);
    let plan = FilterBank::new(&bank, size, object).unwrap();
    let check = |index: &[u16]| plan.check(Filters { halves: &halves, index });
    assert_eq!(check(&good), Ok(()));
    // Whatever one number of the index becomes: refused, or a network that runs.
    for at in 0..good.len() {
        for value in [0, 1, 3, 4, 15, good[at].wrapping_sub(1), good[at] + 1, u16::MAX] {
            let mut index = good.clone();
            index[at] = value;
            let in_order = |index: &[u16]| {
                let (starts, columns) = index.split_at(9);
                let ends = starts[0] == 0 && starts[8] == columns.len() as u16 && starts.is_sorted();
                let rows = || starts.windows(2).map(|w| &columns[usize::from(w[0])..usize::from(w[1])]);
                ends && rows().all(|row| row.is_sorted_by(|a, b| a < b) && row.iter().all(|c| *c < 4))
            };
            assert_eq!(check(&index).is_ok(), in_order(&index), "{at}: {value}");
            if check(&index).is_ok() {
                run_filters(&bank, Filters { halves: &halves, index: &index }, &[0.5; 14 * 14], size, object, true);
            }
        }
    }
    assert_eq!(check(&good[1..]), Err(FilterError::Index { row: 0 }));
    assert_eq!(check(&[]), Err(FilterError::Index { row: 0 }));
    let short = plan.check(Filters { halves: &halves[1..], index: &good });
    assert_eq!(short, Err(FilterError::Length { expected: halves.len(), found: halves.len() - 1 }));
    let refuse = |bank: &Bank, size| FilterBank::new(bank, size, object).unwrap_err();
    assert_eq!(refuse(&Bank { step: 4, ..bank.clone() }, size), FilterError::Kernels);
    assert_eq!(refuse(&bank, Size { rows: 17, cols: 4 }), FilterError::Kernels);
}

#[test]
fn the_geometry_is_the_documented_one() {
    let (size, object) = (Size { rows: 214, cols: 213 }, Size { rows: 96, cols: 96 });
    let dense = Geometry::new(&dense_bank(256, 256, 1), size, object).unwrap();
    assert_eq!((dense.rows.tiles(), dense.rows.lead(), dense.rows.object_origin()), (1, 80, 59));
    assert_eq!((dense.rows.occupied(0), dense.cols.occupied(0)), (21..235, 21..234));
    let taps = [(-1, 0), (0, 2)].map(|(dy, dx)| Tap { channel: 0, dy, dx });
    let bank = Bank { tile: 64, step: 32, channels: 1, taps: taps.into_iter().collect(), blocks: None };
    let tapped = Geometry::new(&bank, size, object).unwrap();
    assert_eq!((tapped.rows.tiles(), tapped.rows.lead(), tapped.rows.lags()), (3, 16, -16..=16));
    assert_eq!((tapped.rows.windows(1), tapped.cols.windows(1)), (0..=1, 1..=3));
    assert_eq!(tapped.rows.window_origin(-1), 59 - 32 - 16);
    assert_eq!(tapped.cols.window_count(), 5);
    assert_eq!(tapped.rows.occupied(4), 0..214 - (59 + 4 * 32 - 16));
    assert!(tapped.rows.occupied(6).is_empty());
}

#[test]
fn contradictions_are_refused() {
    let (size, object) = (Size { rows: 8, cols: 8 }, Size { rows: 8, cols: 8 });
    let refuse = |bank: &Bank| FilterBank::new(bank, size, object).unwrap_err();
    let tap = |channel, dy, dx| Tap { channel, dy, dx };
    let bank = |channels, taps: &[Tap]| Bank {
        tile: 16,
        step: 8,
        channels,
        taps: taps.iter().copied().collect(),
        blocks: None,
    };
    assert_eq!(refuse(&dense_bank(16, 17, 1)), FilterError::Step { tile: 16, step: 17 });
    assert_eq!(refuse(&dense_bank(16, 0, 1)), FilterError::Step { tile: 16, step: 0 });
    assert_eq!(refuse(&dense_bank(24, 8, 1)), FilterError::Fft(crate::fft::FftError::Size { found: 24 }));
    assert_eq!(refuse(&bank(1, &[])), FilterError::NoTap { channel: 0 });
    assert_eq!(refuse(&bank(0, &[])), FilterError::NoTap { channel: 0 });
    assert_eq!(refuse(&bank(3, &[tap(0, 0, 0), tap(2, 0, 0)])), FilterError::NoTap { channel: 1 });
    assert_eq!(refuse(&bank(1, &[tap(1, 0, 0)])), FilterError::Channel { channels: 1, found: 1 });
    assert_eq!(refuse(&bank(1, &[tap(0, 0, 1), tap(0, 0, 0)])), FilterError::Order { tap: 1 });
    assert_eq!(refuse(&bank(1, &[tap(0, 0, 0), tap(0, 0, 0)])), FilterError::Order { tap: 1 });
}

#[test]
fn a_part_is_cut_from_the_whole() {
    let (n, size, object) = (64, Size { rows: 51, cols: 54 }, Size { rows: 24, cols: 26 });
    let kernels = [foci(n, &[(0, 0), (-15, 4)], 7), foci(n, &[(3, 14)], 8)];
    let frame = frame(size);
    let spectra = kernels.iter().flat_map(|kernel| spectrum(kernel, n)).collect();
    let banks = [(16, 8), (32, 16), (32, 8)].map(|(tile, step)| {
        let (bank, spectra) = tapped(&kernels, n as i32, tile, step);
        (bank, spectra, vec![])
    });
    let dense = [(dense_bank(64, 64, 2), spectra, vec![]), in_blocks(&kernels, n, 8, object)];
    for (bank, halves, index) in banks.into_iter().chain(dense) {
        let filters = Filters { halves: &halves, index: &index };
        let whole = run_filters(&bank, filters, &frame, size, object, true);
        for [row, col, rows, cols] in [[0, 0, 24, 26], [0, 0, 1, 1], [23, 25, 1, 1], [7, 8, 2, 8], [8, 3, 16, 20]] {
            let part = Region { row, col, rows, cols };
            let found = run_part(&bank, filters, &frame, size, object, part);
            let [rows, cols] = part.ranges();
            let at = |k: usize, r: usize, c: usize| whole[(k * 24 + r) * 26 + c];
            let row = |k, r| cols.clone().map(move |c| at(k, r, c));
            let expected: Vec<f16> =
                (0..2).flat_map(|k| rows.clone().flat_map(move |r| row(k, r).collect::<Vec<_>>())).collect();
            assert_eq!(found, expected, "T = {}, S = {}, {part}", bank.tile, bank.step);
        }
        let outside = Region { row: 23, col: 0, rows: 2, cols: 1 };
        let plan = FilterBank::new(&bank, size, object).unwrap();
        assert_eq!(plan.of_part(outside).unwrap_err(), FilterError::Part { found: outside });
    }
}
