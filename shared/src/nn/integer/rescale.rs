//! The roundings of integer networks: to the nearest integer, halves up.

use super::feature::Feature;
use crate::num::{f16, widen};

/// Number of leading elements that a routine in Helium has done; 0 on other targets.
macro_rules! done_in_helium {
    ($function:ident($($argument:expr),*)) => {{
        #[cfg(all(target_arch = "arm", feature = "helium"))]
        let done = helium::$function($($argument),*);
        #[cfg(not(all(target_arch = "arm", feature = "helium")))]
        let done = 0;
        done
    }};
}
pub(super) use done_in_helium;

/// `floor(sum * multiplier / 2^32 + 1/2)`. One instruction on a Cortex-M (`SMMULR`), one for four sums in Helium
/// (`VRMULH`).
#[inline(always)]
pub fn rescale(sum: i32, multiplier: i32) -> i32 {
    // |sum| 2^31 + 2^31 is below 2^63.
    ((i64::from(sum) * i64::from(multiplier) + (1 << 31)) >> 32) as i32
}

/// The nearest number that 16 bits hold.
#[inline(always)]
pub fn saturate(x: i32) -> i16 {
    x.clamp(i16::MIN.into(), i16::MAX.into()) as i16
}

/// Fraction bits of a number on its way from a half to an integer.
const FRACTION_BITS: u32 = 15;

/// `2^15 scale`.
#[inline(always)]
pub(super) fn fixed_scale(scale: f32) -> f32 {
    scale * (1 << FRACTION_BITS) as f32
}

/// `saturate(floor(x * scale + 1/2))` of a finite half. `scale` is a power of two from 1 to 2^24.
///
/// The product is exact. It is cut to 15 fraction bits, of which only products below 2^-4 have more: a half has 11
/// significant bits. A product that 32 bits do not hold with them saturates, and the result does, too.
#[inline(always)]
pub fn from_half(x: f16, scale: f32) -> i16 {
    let fixed = (widen(x) * fixed_scale(scale)) as i32;
    saturate(fixed.saturating_add(1 << (FRACTION_BITS - 1)) >> FRACTION_BITS)
}

/// `min(floor(2^15 scale + 1/2), 2^15 - 1)` of the scale of a channel, 0 to 1; the sum is rounded to binary32.
#[inline(always)]
pub fn of_scale(scale: f32) -> i16 {
    saturate((scale * 32768.0 + 0.5) as i32)
}

/// `g = saturate(g + floor(scale t / 2^15 + 1/2))`.
#[cfg_attr(target_arch = "arm", inline(never))]
#[cfg_attr(not(target_arch = "arm"), inline(always))]
pub fn add_scaled<F: Feature>(scale: i16, t: &[F], g: &mut [F]) {
    let done = F::add_scaled_leading(scale, t, g);
    for (g, &t) in g[done..].iter_mut().zip(&t[done..]) {
        *g = F::saturate((*g).into() + ((t.into() * i32::from(scale) + (1 << 14)) >> 15));
    }
}

/// `to = saturate(max(rescale(sum), LEAST))` of each sum.
#[inline(always)]
pub(super) fn rescale_row<F: Feature, const LEAST: i32>(sums: &[i32], multiplier: i32, to: &mut [F]) {
    let done = F::rescale_leading(sums, multiplier, LEAST, to);
    for (to, &sum) in to[done..].iter_mut().zip(&sums[done..]) {
        *to = F::saturate(rescale(sum, multiplier).max(LEAST));
    }
}

/// `to = saturate(to + max(rescale(sum), LEAST))` of each sum.
#[inline(always)]
pub(super) fn accumulate_row<F: Feature, const LEAST: i32>(sums: &[i32], multiplier: i32, to: &mut [F]) {
    let done = F::accumulate_leading(sums, multiplier, LEAST, to);
    for (to, &sum) in to[done..].iter_mut().zip(&sums[done..]) {
        *to = F::saturate((*to).into() + rescale(sum, multiplier).max(LEAST));
    }
}

/// Sum of at most 2^15 numbers.
#[cfg_attr(target_arch = "arm", inline(never))]
#[cfg_attr(not(target_arch = "arm"), inline(always))]
pub(crate) fn sum<F: Feature>(numbers: &[F]) -> i32 {
    let mut first = 0;
    let done = F::sum_leading(numbers, &mut first);
    first + numbers[done..].iter().map(|&x| x.into()).sum::<i32>()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The nearest integer, halves up.
    fn nearest(numerator: i128, denominator: i128) -> i128 {
        (2 * numerator + denominator).div_euclid(2 * denominator)
    }

    proptest! {
        #[test]
        fn rescaling_is_the_nearest_integer(sum: i32, multiplier in 0..=i32::MAX) {
            let expected = nearest(i128::from(sum) * i128::from(multiplier), 1 << 32);
            prop_assert_eq!(i128::from(rescale(sum, multiplier)), expected);
        }

        #[test]
        fn attention_is_the_nearest_integer(t: i16, g: i16, scale in 0.0_f32..=1.0) {
            let k = of_scale(scale);
            prop_assert!((f64::from(k) / 32768.0 - f64::from(scale)).abs() <= 1.0 / 32768.0);
            let mut found = [g];
            add_scaled(k, &[t], &mut found);
            let mut narrow = [g as i8];
            add_scaled(k, &[t as i8], &mut narrow);
            let exact = i128::from(g as i8) + nearest(i128::from(t as i8) * i128::from(k), 1 << 15);
            prop_assert_eq!(i128::from(narrow[0]), exact.clamp(-128, 127));
            let expected = i128::from(g) + nearest(i128::from(t) * i128::from(k), 1 << 15);
            prop_assert_eq!(i128::from(found[0]), expected.clamp(-32768, 32767));
        }
    }

    #[test]
    fn extreme_sums_do_not_overflow() {
        assert_eq!(rescale(i32::MIN, i32::MAX), i32::MIN / 2 + 1);
        assert_eq!(rescale(i32::MAX, i32::MAX), i32::MAX / 2);
        assert_eq!((rescale(1, 1 << 30), rescale(-1, 1 << 30)), (0, 0));
        assert_eq!((rescale(2, 1 << 30), rescale(-2, 1 << 30), rescale(-6, 1 << 30)), (1, 0, -1));
    }

    #[test]
    fn every_half_becomes_the_nearest_integer() {
        for scale_log2 in [0, 1, 9, 14, 24] {
            for bits in 0..=u16::MAX {
                let half = f16::from_bits(bits);
                if half.is_finite() {
                    // Exact: a half is a multiple of 2^-24.
                    let numerator = (half.to_f64() * f64::from(1 << 24)) as i128 * (1 << scale_log2);
                    let expected = nearest(numerator, 1 << 24).clamp(-32768, 32767);
                    let found = from_half(half, (1_u32 << scale_log2) as f32);
                    assert_eq!(i128::from(found), expected, "{half} times 2^{scale_log2}");
                }
            }
        }
    }

    #[test]
    fn scales_have_fifteen_bits() {
        assert_eq!([0.0, 0.5, 1.0].map(of_scale), [0, 16384, 32767]);
    }
}
