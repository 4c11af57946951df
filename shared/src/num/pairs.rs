//! Columns of pairs of halves, such as complex numbers, at a stride from each other.

use super::convert::narrow;
#[cfg(not(all(target_arch = "arm", feature = "fpv4")))]
use super::convert::widen;
use super::f16;

/// How pairs of singles are converted to halves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Parts {
    /// Both numbers times a power of two.
    Scaled(f32),
    /// In exchanged order.
    Exchanged,
}

impl Parts {
    /// Converts one pair.
    #[inline(always)]
    pub fn of(self, [a, b]: [f32; 2]) -> [f16; 2] {
        match self {
            Self::Scaled(scale) => [narrow(a * scale), narrow(b * scale)],
            Self::Exchanged => [narrow(b), narrow(a)],
        }
    }
}

/// Panics unless `halves` hold `len` pairs a stride apart.
#[inline(always)]
pub(super) fn check(halves: usize, stride: usize, len: usize) {
    assert!(stride >= 2 && halves + stride >= len * stride + 2, "{halves} halves are too few");
}

/// The number `i` of `len` with its bits reversed.
#[cfg(not(all(target_arch = "arm", feature = "fpv4")))]
#[inline(always)]
const fn reversed(i: usize, len: usize) -> usize {
    (i as u32).reverse_bits() as usize >> (u32::BITS - len.trailing_zeros())
}

/// Widens the pairs at `from[i * stride..][..2]` to the elements of `to` whose indices are `i` with its bits reversed.
/// `to` has a power of two of elements, 4 at least.
#[inline(always)]
pub fn gather_pairs(from: &[f16], stride: usize, to: &mut [[f32; 2]]) {
    #[cfg(all(target_arch = "arm", feature = "fpv4"))]
    super::arm::gather_pairs(from, stride, to);
    #[cfg(not(all(target_arch = "arm", feature = "fpv4")))]
    {
        let len = to.len();
        assert!(len.is_power_of_two() && len >= 4, "{len} places");
        check(from.len(), stride, len);
        for i in 0..len {
            to[reversed(i, len)] = [widen(from[i * stride]), widen(from[i * stride + 1])];
        }
    }
}

/// Adds the products of the complex numbers (re, im) at `k[i * stride..][..2]` and `x[i * stride..][..2]`, imaginary
/// part first, to the elements of `to` whose indices are `i` with its bits reversed: `re = (re + kr xr) - ki xi`,
/// `im = (im + kr xi) + ki xr`.
#[inline(always)]
pub fn add_products(k: &[f16], x: &[f16], stride: usize, to: &mut [[f32; 2]]) {
    #[cfg(all(target_arch = "arm", feature = "fpv4"))]
    super::arm::add_products(k, x, stride, to);
    #[cfg(not(all(target_arch = "arm", feature = "fpv4")))]
    {
        let len = to.len();
        assert!(len.is_power_of_two() && len >= 2, "{len} places");
        check(k.len(), stride, len);
        check(x.len(), stride, len);
        for i in 0..len {
            let [kr, ki, xr, xi] = [k[i * stride], k[i * stride + 1], x[i * stride], x[i * stride + 1]].map(widen);
            let [im, re] = &mut to[reversed(i, len)];
            *re = (*re + kr * xr) - ki * xi;
            *im = (*im + kr * xi) + ki * xr;
        }
    }
}

/// Narrows the pairs of `from` into `to[i * stride..][..2]`.
#[inline(always)]
pub fn scatter_pairs(from: &[[f32; 2]], parts: Parts, to: &mut [f16], stride: usize) {
    check(to.len(), stride, from.len());
    #[cfg(all(target_arch = "arm", feature = "fpv4"))]
    let done = super::arm::scatter_pairs(from, parts, to, stride);
    #[cfg(not(all(target_arch = "arm", feature = "fpv4")))]
    let done = 0;
    for (i, &pair) in from.iter().enumerate().skip(done) {
        to[i * stride..][..2].copy_from_slice(&parts.of(pair));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_go_to_reversed_places() {
        let halves: [f16; 70] = core::array::from_fn(|i| f16::from_f32(i as f32));
        for stride in [2, 8, 9] {
            let mut pairs = [[-1.0; 2]; 8];
            gather_pairs(&halves, stride, &mut pairs);
            for (place, i) in [(0, 0), (4, 1), (2, 2), (6, 3), (7, 7)] {
                assert_eq!(pairs[place], [(i * stride) as f32, (i * stride + 1) as f32], "stride {stride}: {i}");
            }
        }
    }

    #[test]
    fn products_are_added_imaginary_part_first() {
        let [k, x] = [[1.0, 2.0, 9.0, 3.0, -1.0, 9.0], [4.0, 0.5, 9.0, 2.0, 5.0, 9.0]].map(|x| x.map(f16::from_f32));
        let mut sums = [[10.0, 20.0], [30.0, 40.0]];
        add_products(&k, &x, 3, &mut sums);
        assert_eq!(sums, [[10.0 + 8.5, 20.0 + 3.0], [30.0 + 13.0, 40.0 + 11.0]]);
    }

    #[test]
    fn pairs_come_from_where_they_go() {
        let pairs: [[f32; 2]; 7] = core::array::from_fn(|i| [2.0 * i as f32, 2.0 * i as f32 + 1.0]);
        let double = Parts::Scaled(2.0);
        for (stride, parts, flip) in [(2, double, 0), (5, double, 0), (4, Parts::Exchanged, 1)] {
            let mut halves = [f16::NEG_ONE; 40];
            scatter_pairs(&pairs, parts, &mut halves, stride);
            for (i, half) in halves.iter().enumerate() {
                let (pair, part) = (i / stride, i % stride);
                let expected =
                    if pair < 7 && part < 2 { (2 * pair + (part ^ flip)) as f32 * (2 - flip) as f32 } else { -1.0 };
                assert_eq!(half.to_f32(), expected, "stride {stride}: {i}");
            }
        }
    }
}
