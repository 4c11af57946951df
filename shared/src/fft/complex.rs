//! The complex transform: radix 4, decimation in time, in place.

use super::error::{FftError, MAX_LEN};
use super::twiddle::Roots;

/// One complex number in each of L lanes: real parts, imaginary parts.
pub type Lanes<const L: usize> = [[f32; L]; 2];

/// One lane as (re, im) pairs.
#[inline(always)]
pub(super) fn single<const L: usize>(data: &mut [Lanes<L>]) -> &mut [[f32; 2]] {
    data.as_flattened_mut().as_flattened_mut().as_chunks_mut::<2>().0
}

/// Plan of a complex transform, 4 to [`MAX_LEN`] long.
///
/// `X[k] = sum_n x[n] e^(-2 pi i n k / N)`, without scaling. The inverse is the same transform with real and imaginary
/// parts exchanged before and after. Relative error (r.m.s. over the spectrum) below 3e-7 for every size.
#[derive(Clone, Copy, Debug)]
pub struct Fft {
    len: usize,
}

impl Fft {
    /// Plans a transform of `len` numbers.
    ///
    /// # Errors
    /// [`FftError::Size`] unless `len` is a power of two from 4 to [`MAX_LEN`].
    pub const fn new(len: usize) -> Result<Self, FftError> {
        if len.is_power_of_two() && len >= 4 && len <= MAX_LEN {
            Ok(Self { len })
        } else {
            Err(FftError::Size { found: len })
        }
    }

    /// Number N of complex numbers.
    #[inline(always)]
    pub const fn len(&self) -> usize {
        self.len
    }

    /// Always false: no transform is empty.
    pub const fn is_empty(&self) -> bool {
        false
    }

    /// Index at which input number `n` is expected: `n` with its bits reversed.
    #[inline(always)]
    pub const fn slot(&self, n: usize) -> usize {
        (n as u32).reverse_bits() as usize >> (u32::BITS - self.len.trailing_zeros())
    }

    /// Transforms `data` in place: N numbers in the order of [`Self::slot`] to N numbers in natural order. Panics where
    /// there are less.
    #[inline(always)]
    pub fn process<const L: usize>(&self, data: &mut [Lanes<L>]) {
        let data = &mut data[..self.len];
        #[cfg(all(target_arch = "arm", feature = "fpv4"))]
        if L == 1 {
            return crate::num::arm::transform(single(data));
        }
        let mut quarter = if self.len.trailing_zeros().is_multiple_of(2) {
            data.as_chunks_mut::<4>().0.iter_mut().for_each(first_radix4);
            4
        } else {
            data.as_chunks_mut::<8>().0.iter_mut().for_each(first_radix8);
            8
        };
        while quarter < self.len {
            for block in data.chunks_exact_mut(4 * quarter) {
                radix4(block, quarter);
            }
            quarter *= 4;
        }
    }
}

#[inline(always)]
fn add<const L: usize>(a: Lanes<L>, b: Lanes<L>) -> Lanes<L> {
    core::array::from_fn(|i| core::array::from_fn(|l| a[i][l] + b[i][l]))
}

#[inline(always)]
fn sub<const L: usize>(a: Lanes<L>, b: Lanes<L>) -> Lanes<L> {
    core::array::from_fn(|i| core::array::from_fn(|l| a[i][l] - b[i][l]))
}

/// `-i a`.
#[inline(always)]
fn turn<const L: usize>(a: Lanes<L>) -> Lanes<L> {
    [a[1], core::array::from_fn(|l| -a[0][l])]
}

/// `w a`.
#[inline(always)]
pub(super) fn mul<const L: usize>(a: Lanes<L>, w: [f32; 2]) -> Lanes<L> {
    [
        core::array::from_fn(|l| a[0][l] * w[0] - a[1][l] * w[1]),
        core::array::from_fn(|l| a[0][l] * w[1] + a[1][l] * w[0]),
    ]
}

/// The radix-4 butterfly of four numbers in bit-reversed order (0, 2, 1, 3).
#[inline(always)]
fn butterfly<const L: usize>([a0, a1, a2, a3]: [Lanes<L>; 4]) -> [Lanes<L>; 4] {
    let (b0, b1) = (add(a0, a1), sub(a0, a1));
    let (b2, b3) = (add(a2, a3), turn(sub(a2, a3)));
    [add(b0, b2), add(b1, b3), sub(b0, b2), sub(b1, b3)]
}

#[inline(always)]
fn first_radix4<const L: usize>(data: &mut [Lanes<L>; 4]) {
    *data = butterfly(*data);
}

#[inline(always)]
fn first_radix8<const L: usize>(data: &mut [Lanes<L>; 8]) {
    let [e0, e1, e2, e3, o0, o1, o2, o3] = *data;
    let even = butterfly([e0, e1, e2, e3]);
    let odd = butterfly([o0, o1, o2, o3]);
    let roots = Roots::new(8);
    let odd = [odd[0], mul(odd[1], roots.at(1)), turn(odd[2]), mul(odd[3], roots.at(3))];
    for k in 0..4 {
        data[k] = add(even[k], odd[k]);
        data[k + 4] = sub(even[k], odd[k]);
    }
}

/// Joins four transforms of `quarter` numbers into one.
#[inline(always)]
fn radix4<const L: usize>(block: &mut [Lanes<L>], quarter: usize) {
    let (a0, rest) = block.split_at_mut(quarter);
    let (a1, rest) = rest.split_at_mut(quarter);
    let (a2, a3) = rest.split_at_mut(quarter);
    let roots = Roots::new(4 * quarter);
    let columns = a0.iter_mut().zip(a1).zip(a2).zip(a3);
    for (k, (((a0, a1), a2), a3)) in columns.enumerate() {
        // The roots for k = 0 are 1.
        let turned = if k == 0 {
            [*a0, *a1, *a2, *a3]
        } else {
            [*a0, mul(*a1, roots.at(2 * k)), mul(*a2, roots.at(k)), mul(*a3, roots.at(3 * k))]
        };
        [*a0, *a1, *a2, *a3] = butterfly(turned);
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::super::naive;
    use super::*;
    use std::vec::Vec;

    fn transform<const L: usize>(input: &[[f32; 2]], lane: usize) -> Vec<[f32; 2]> {
        let fft = Fft::new(input.len()).unwrap();
        let mut data = std::vec![[[0.25; L]; 2]; input.len()];
        for (n, x) in input.iter().enumerate() {
            data[fft.slot(n)][0][lane] = x[0];
            data[fft.slot(n)][1][lane] = x[1];
        }
        fft.process(&mut data);
        data.iter().map(|x| [x[0][lane], x[1][lane]]).collect()
    }

    fn noise(len: usize) -> Vec<[f32; 2]> {
        let mut state = 1_u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / 8_388_608.0 - 1.0
        };
        (0..len).map(|_| [next(), next()]).collect()
    }

    #[test]
    fn an_impulse_gives_a_root_of_unity() {
        let mut input = [[0.0; 2]; 16];
        input[1] = [1.0, 0.0];
        for (k, x) in transform::<1>(&input, 0).iter().enumerate() {
            let (sin, cos) = (-std::f64::consts::TAU * k as f64 / 16.0).sin_cos();
            assert!((f64::from(x[0]) - cos).abs() < 1e-7 && (f64::from(x[1]) - sin).abs() < 1e-7, "{k}: {x:?}");
        }
    }

    #[test]
    fn every_size_agrees_with_the_definition() {
        for log2 in 2..=10 {
            let input = noise(1 << log2);
            let wide: Vec<[f64; 2]> = input.iter().map(|x| x.map(f64::from)).collect();
            let expected = naive::dft(&wide, false);
            let found = transform::<1>(&input, 0);
            let square = |x: &[f64; 2]| x[0] * x[0] + x[1] * x[1];
            let error: f64 = found
                .iter()
                .zip(&expected)
                .map(|(f, e)| square(&[f64::from(f[0]) - e[0], f64::from(f[1]) - e[1]]))
                .sum();
            let relative = (error / expected.iter().map(square).sum::<f64>()).sqrt();
            assert!(relative < 3e-7, "N = {}: {relative:e}", 1 << log2);
        }
    }

    #[test]
    fn lanes_do_not_change_a_bit() {
        for len in [8, 64, 128, 1024] {
            let input = noise(len);
            let one = transform::<1>(&input, 0);
            assert_eq!(one, transform::<8>(&input, 5));
            assert_eq!(one, transform::<4>(&input, 3));
        }
    }

    #[test]
    fn other_sizes_are_refused() {
        for len in [0, 1, 2, 3, 12, 2048] {
            assert_eq!(Fft::new(len).unwrap_err(), FftError::Size { found: len });
        }
    }
}
