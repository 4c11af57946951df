//! The 2-D real transform in strips.
//!
//! Rows, then columns are transformed, a few side by side, in fast scratch. The spectrum, T x (T/2 + 1) pairs of halves
//! (re, im), may lie in slow memory. Both directions are scaled by 1/T (unitary), an exact power of two, after their
//! second pass. Half-transformed rows are rounded to halves too: those of a plane within [-1, 1] stay within [-2 T, 2
//! T], its spectrum within [-T, T], far from the largest half.

use super::complex::Fft;
use super::error::{FftError, check_len};
use super::real::RealFft;
use super::strip;
use crate::num::f16;
use crate::num::pairs::Parts;
use crate::num::simd::{Kernel, Simd, Vector};

/// Rows or columns that are transformed side by side where scratch allows.
const WIDE: usize = match (cfg!(target_arch = "arm"), strip::HELIUM) {
    (false, _) => 8,
    (true, true) => 4,
    (true, false) => 1,
};

/// Source of the rows of a plane.
pub trait RowSource {
    /// Writes the whole row `row` of the plane, T numbers, into `to`.
    fn load(&self, row: usize, to: &mut [f32]);
}

/// Source of the spectrum of an inverse transform.
pub trait ProductSource {
    /// Number of products.
    fn count(&self) -> usize;

    /// A pair of stored spectra; None: zeros. The sum of their products is transformed.
    fn product(&self, index: usize) -> Option<[&[f16]; 2]>;
}

/// Plan of a T x T real transform.
#[derive(Clone, Copy, Debug)]
pub struct Fft2 {
    rows: RealFft,
    cols: Fft,
    scale: f32,
}

impl Fft2 {
    /// Plans a transform of side `len`.
    ///
    /// # Errors
    /// [`FftError::Size`] unless `len` is a power of two from 8 to [`super::MAX_LEN`].
    pub fn new(len: usize) -> Result<Self, FftError> {
        let (rows, cols) = (RealFft::new(len)?, Fft::new(len)?);
        Ok(Self { rows, cols, scale: 1.0 / len as f32 })
    }

    /// Side T.
    #[inline(always)]
    pub const fn len(&self) -> usize {
        self.cols.len()
    }

    /// Always false: no transform is empty.
    pub const fn is_empty(&self) -> bool {
        false
    }

    /// Complex numbers in a row of the spectrum, T/2 + 1.
    #[inline(always)]
    pub const fn width(&self) -> usize {
        self.len() / 2 + 1
    }

    /// Length of `rows` rows of the spectrum, halves.
    #[inline(always)]
    pub const fn spectrum_len(&self, rows: usize) -> usize {
        2 * self.width() * rows
    }

    /// Length of scratch needed at least, numbers. With [`Self::scratch_len_wide`] the transforms use several lanes
    /// where the target has vectors. The result is the same.
    pub const fn scratch_len(&self) -> usize {
        self.scratch_for(1)
    }

    /// Length of scratch beyond which more does not help, numbers.
    pub const fn scratch_len_wide(&self) -> usize {
        self.scratch_for(WIDE)
    }

    /// A strip of complex columns, and room for two more columns or for two rows.
    const fn scratch_for(&self, lanes: usize) -> usize {
        2 * self.len() * lanes + 4 * self.len()
    }

    /// Transforms the plane whose rows `occupied` come from `source`. All other rows are zero. `spectrum` receives T
    /// rows of T/2 + 1 numbers.
    ///
    /// The loops are large and inlined, so there is one copy of them for all sources.
    ///
    /// # Errors
    /// [`FftError::Buffer`] where `spectrum` or `scratch` is too short.
    #[inline(never)]
    pub fn forward(
        &self,
        simd: Simd,
        source: &dyn RowSource,
        occupied: core::ops::Range<usize>,
        spectrum: &mut [f16],
        scratch: &mut [f32],
    ) -> Result<(), FftError> {
        check_len(self.spectrum_len(self.len()), spectrum.len())?;
        check_len(self.scratch_len(), scratch.len())?;
        if WIDE > 1 && scratch.len() >= self.scratch_len_wide() {
            simd.run(Forward::<WIDE> { plan: self, source, occupied, spectrum, scratch });
        } else {
            simd.run(Forward::<1> { plan: self, source, occupied, spectrum, scratch });
        }
        Ok(())
    }

    /// Transforms back, and calls `emit(row, values)` with the T numbers of each row in `rows`. `halfway` has the
    /// length [`Self::spectrum_len`] of these rows. The imaginary parts of columns 0 and T/2 after the column
    /// transforms are ignored, as in every complex-to-real transform.
    ///
    /// As [`Self::forward`] there is one copy of it for all sources.
    ///
    /// # Errors
    /// [`FftError::Buffer`] where `halfway` or `scratch` is too short.
    #[inline(never)]
    pub fn inverse(
        &self,
        simd: Simd,
        source: &dyn ProductSource,
        rows: core::ops::Range<usize>,
        halfway: &mut [f16],
        scratch: &mut [f32],
        emit: &mut dyn FnMut(usize, &[f32]),
    ) -> Result<(), FftError> {
        check_len(rows.end, self.len())?;
        check_len(self.spectrum_len(rows.len()), halfway.len())?;
        check_len(self.scratch_len(), scratch.len())?;
        if WIDE > 1 && scratch.len() >= self.scratch_len_wide() {
            simd.run(Inverse::<WIDE> { plan: self, source, rows, halfway, scratch, emit });
        } else {
            simd.run(Inverse::<1> { plan: self, source, rows, halfway, scratch, emit });
        }
        Ok(())
    }
}

/// Calls `self.method::<L>(first, count)` for strips of up to L rows or columns of a range. A strip that L lanes cannot
/// hold, or in which they would change a bit (the method then returns false and does nothing), goes lane by lane.
macro_rules! in_strips {
    ($self:ident.$method:ident, $lanes:ident, $range:expr) => {
        let range = $range;
        for first in range.clone().step_by($lanes) {
            let count = $lanes.min(range.end - first);
            let done = strip::holds::<$lanes>(count) && $self.$method::<$lanes>(first, count);
            // One lane holds every strip of one and changes no bit.
            if const { $lanes > 1 } && !done {
                (first..first + count).for_each(|one| {
                    $self.$method::<1>(one, 1);
                });
            }
        }
    };
}

struct Forward<'a, const L: usize> {
    plan: &'a Fft2,
    source: &'a dyn RowSource,
    occupied: core::ops::Range<usize>,
    spectrum: &'a mut [f16],
    scratch: &'a mut [f32],
}

impl<const L: usize> Kernel for Forward<'_, L> {
    type Output = ();

    #[inline(always)]
    fn run<V: Vector>(mut self) {
        let row_len = self.plan.spectrum_len(1);
        let occupied = self.occupied.clone();
        self.spectrum[..occupied.start * row_len].fill(f16::ZERO);
        self.spectrum[occupied.end * row_len..].fill(f16::ZERO);
        in_strips!(self.rows, L, occupied);
        in_strips!(self.columns, L, 0..self.plan.width());
    }
}

impl<const L: usize> Forward<'_, L> {
    /// Transforms rows `first..first + count`, `N` side by side. Returns false, and does nothing, where that would
    /// change a bit.
    #[inline(always)]
    fn rows<const N: usize>(&mut self, first: usize, count: usize) -> bool {
        let (fft, row_len) = (self.plan.rows, self.plan.spectrum_len(1));
        let scratch = strip::split::<N>(self.scratch, fft.half().len());
        let rows = &mut self.spectrum[first * row_len..(first + count) * row_len];
        let load = |lane, row: &mut [f32]| self.source.load(first + lane, row);
        strip::forward_rows(load, count, fft, scratch, rows)
    }

    /// Columns, as [`Self::rows`].
    #[inline(always)]
    fn columns<const N: usize>(&mut self, first: usize, count: usize) -> bool {
        let (row_len, fft) = (self.plan.spectrum_len(1), self.plan.cols);
        let (data, _) = strip::split::<N>(self.scratch, fft.len());
        // The rows are twice their transforms.
        strip::forward_columns(self.spectrum, row_len, (first, count), fft, 0.5 * self.plan.scale, data)
    }
}

struct Inverse<'a, const L: usize> {
    plan: &'a Fft2,
    source: &'a dyn ProductSource,
    rows: core::ops::Range<usize>,
    halfway: &'a mut [f16],
    scratch: &'a mut [f32],
    emit: &'a mut dyn FnMut(usize, &[f32]),
}

impl<const L: usize> Kernel for Inverse<'_, L> {
    type Output = ();

    #[inline(always)]
    fn run<V: Vector>(mut self) {
        in_strips!(self.columns, L, 0..self.plan.width());
        in_strips!(self.emit_rows, L, self.rows.clone());
    }
}

impl<const L: usize> Inverse<'_, L> {
    /// Columns, as [`Forward::rows`].
    #[inline(always)]
    fn columns<const N: usize>(&mut self, first: usize, count: usize) -> bool {
        let (row_len, fft) = (self.plan.spectrum_len(1), self.plan.cols);
        let (data, _) = strip::split::<N>(self.scratch, fft.len());
        let products = (0..self.source.count()).filter_map(|index| self.source.product(index));
        let exact = strip::inverse_columns(products, row_len, (first, count), fft, data);
        if exact {
            let rows = &mut data[self.rows.clone()];
            strip::store(rows, Parts::Exchanged, self.halfway, row_len, first, count);
        }
        exact
    }

    /// Rows of the plane, as [`Forward::rows`].
    #[inline(always)]
    fn emit_rows<const N: usize>(&mut self, first: usize, count: usize) -> bool {
        let (row_len, fft) = (self.plan.spectrum_len(1), self.plan.rows);
        let (data, rows) = strip::split::<N>(self.scratch, fft.half().len());
        let from = &self.halfway[(first - self.rows.start) * row_len..][..count * row_len];
        let emit = |lane, row: &[f32]| (self.emit)(first + lane, row);
        strip::inverse_rows(fft, from, row_len, self.plan.scale, data, rows, emit)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::super::naive;
    use super::*;
    use crate::naive::Noise;
    use std::vec;
    use std::vec::Vec;

    struct Rows<'a>(&'a [f32], usize);

    impl RowSource for Rows<'_> {
        fn load(&self, row: usize, to: &mut [f32]) {
            to.copy_from_slice(&self.0[row * self.1..][..self.1]);
        }
    }

    /// A spectrum and as many ones.
    struct Stored<'a>(&'a [f16], Vec<f16>);

    impl ProductSource for Stored<'_> {
        fn count(&self) -> usize {
            1
        }

        fn product(&self, _: usize) -> Option<[&[f16]; 2]> {
            Some([self.0, &self.1])
        }
    }

    /// A plane within [-1, 1], zero in its outer rows.
    fn plane(len: usize) -> Vec<f32> {
        let mut noise = Noise(4);
        let mut plane: Vec<f32> = (0..len * len).map(|_| 0.5 * noise.next() + 0.4).collect();
        plane[..len].fill(0.0);
        plane[(len - 2) * len..].fill(0.0);
        plane
    }

    fn forward(len: usize, plane: &[f32], wide: bool) -> Vec<f16> {
        let fft = Fft2::new(len).unwrap();
        let mut spectrum = vec![f16::NAN; fft.spectrum_len(len)];
        let mut scratch = vec![f32::NAN; if wide { fft.scratch_len_wide() } else { fft.scratch_len() }];
        let simd = if wide { Simd::detect() } else { Simd::PORTABLE };
        fft.forward(simd, &Rows(plane, len), 1..len - 2, &mut spectrum, &mut scratch).unwrap();
        spectrum
    }

    fn inverse(len: usize, spectrum: &[f16], rows: core::ops::Range<usize>, wide: bool) -> Vec<f32> {
        let fft = Fft2::new(len).unwrap();
        let mut halfway = vec![f16::NAN; fft.spectrum_len(rows.len())];
        let mut scratch = vec![f32::NAN; if wide { fft.scratch_len_wide() } else { fft.scratch_len() }];
        let mut out = vec![f32::NAN; rows.len() * len];
        let simd = if wide { Simd::detect() } else { Simd::PORTABLE };
        let ones = (0..spectrum.len()).map(|i| if i % 2 == 0 { f16::ONE } else { f16::ZERO }).collect();
        let source = Stored(spectrum, ones);
        fft.inverse(simd, &source, rows.clone(), &mut halfway, &mut scratch, &mut |row, values| {
            out[(row - rows.start) * len..][..len].copy_from_slice(values);
        })
        .unwrap();
        out
    }

    #[test]
    fn the_spectrum_agrees_with_the_definition() {
        for len in [8, 16, 32, 64] {
            let plane = plane(len);
            let pairs: Vec<[f64; 2]> = plane.iter().map(|&x| [f64::from(x), 0.0]).collect();
            let expected = naive::dft2(&pairs, len, false);
            let (mut error, mut energy) = (0.0, 0.0);
            for (i, found) in forward(len, &plane, true).chunks(2).enumerate() {
                let [re, im] = expected[i / (len / 2 + 1) * len + i % (len / 2 + 1)].map(|x| x / len as f64);
                error += (found[0].to_f64() - re).powi(2) + (found[1].to_f64() - im).powi(2);
                energy += re * re + im * im;
            }
            let relative = f64::sqrt(error / energy);
            assert!(relative < 4e-4, "T = {len}: {relative:e}");
        }
    }

    #[test]
    fn there_and_back_is_the_identity_to_the_precision_of_halves() {
        for len in [8, 64, 128, 512] {
            let plane = plane(len);
            let back = inverse(len, &forward(len, &plane, true), 0..len, true);
            let square: f64 = back.iter().zip(&plane).map(|(b, p)| f64::from(b - p).powi(2)).sum();
            let rms = (square / (len * len) as f64).sqrt();
            assert!(rms < 4e-4, "T = {len}: {rms:e}");
        }
    }

    #[test]
    fn a_full_frame_of_ones_does_not_overflow() {
        for len in [256, 1024] {
            let spectrum = forward(len, &vec![1.0; len * len], true);
            assert!(spectrum.iter().all(|x| x.is_finite() && x.to_f64().abs() <= len as f64));
            let expected = (len - 3) as f64;
            assert!((spectrum[0].to_f64() - expected).abs() <= expected / 2048.0, "DC is the sum over T");
        }
    }

    #[test]
    fn strips_and_partial_rows_do_not_change_a_bit() {
        for len in [8, 32, 128] {
            let plane = plane(len);
            let spectrum = forward(len, &plane, true);
            assert_eq!(forward(len, &plane, false), spectrum);
            let all = inverse(len, &spectrum, 0..len, true);
            let part = inverse(len, &spectrum, 3..len - 1, false);
            assert_eq!(part, all[3 * len..(len - 1) * len]);
        }
    }
}
