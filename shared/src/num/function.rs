//! The multiply-accumulate, the maximum, and the one transcendental function of the network: one code for every target.

use super::convert::widen;
use super::f16;

/// Argument beyond which the logistic function is 0 or 1 to within half a unit of the smallest half.
pub(super) const SATURATED: f32 = 18.0;

/// Logistic function `1 / (1 + e^-x)`.
///
/// It uses the approximation of the exponential that `micromath` has, of `|x|` only, where its relative error is 6.8e-4
/// (for `-|x|` it is 2.4e-3). The absolute error of the result is below 1.8e-4 everywhere and its relative error below
/// 8e-4: a third of an ulp of a half near 1. `sigmoid(x) + sigmoid(-x)` is 1 to one rounding. An infinite argument
/// gives 0 or 1. NaN, which cannot occur in a [`crate::pipeline`], gives a number from 0.5 to 1.
#[inline(always)]
pub fn sigmoid(x: f32) -> f32 {
    let magnitude = if x < 0.0 { -x } else { x };
    let magnitude = if magnitude < SATURATED { magnitude } else { SATURATED };
    let tail = 1.0 / (1.0 + exp(magnitude));
    if x < 0.0 { tail } else { 1.0 - tail }
}

/// [`sigmoid`] of each number.
#[inline(always)]
pub fn sigmoid_slice(numbers: &mut [f32]) {
    #[cfg(all(target_arch = "arm", feature = "helium"))]
    let done = super::arm::sigmoid(numbers);
    #[cfg(not(all(target_arch = "arm", feature = "helium")))]
    let done = 0;
    numbers[done..].iter_mut().for_each(|x| *x = sigmoid(*x));
}

/// Whether the exponential of a number is taken for e: 1 and the number before it.
#[inline(always)]
pub(super) const fn exp_is_e(x: f32) -> bool {
    (x - 1.0).abs() < f32::EPSILON
}

/// `e^x` from 0 to `SATURATED`: `2^n` times the first terms of the series of `e^f`, with `x = (n + f / ln 2) ln 2`.
#[inline(always)]
fn exp(x: f32) -> f32 {
    if exp_is_e(x) {
        return core::f32::consts::E;
    }
    let y = x * core::f32::consts::LOG2_E;
    let whole = y as i32;
    let f = (y - whole as f32) * core::f32::consts::LN_2;
    let series = 1.0 + f * (1.0 + f * 0.5 * (1.0 + f / 3.0 * (1.0 + f * 0.25)));
    // The exponent is the whole part: `e^f` lies between 1 and 2.
    f32::from_bits(series.to_bits().wrapping_add_signed(whole << 23))
}

/// `a * b + c` with two roundings: the product is rounded, then the sum.
#[inline(always)]
pub fn mac(a: f32, b: f32, c: f32) -> f32 {
    c + a * b
}

/// Largest value of a slice by `>`, and whether all values are finite. `(-inf, true)` for an empty slice. A zero has no
/// sign; where a value is NaN, the largest one means nothing.
pub fn max_finite(values: &[f16]) -> (f32, bool) {
    #[cfg(all(target_arch = "arm", feature = "helium"))]
    let (done, mut max, mut finite) = match super::arm::extreme_halves(values) {
        Some((done, max, magnitude)) => (done, widen(max), f16::from_bits(magnitude).is_finite()),
        None => (0, f32::NEG_INFINITY, true),
    };
    #[cfg(not(all(target_arch = "arm", feature = "helium")))]
    let (done, mut max, mut finite) = (0, f32::NEG_INFINITY, true);
    for &value in &values[done..] {
        finite &= value.is_finite();
        let value = widen(value);
        max = if value > max { value } else { max };
    }
    (max + 0.0, finite)
}

/// The largest of some numbers and of `max` by `>`. None may be NaN. The sign of a zero is not defined.
#[inline(always)]
pub fn largest(numbers: &[f32], mut max: f32) -> f32 {
    #[cfg(all(target_arch = "arm", feature = "helium"))]
    let done = super::arm::largest(numbers, &mut max);
    #[cfg(not(all(target_arch = "arm", feature = "helium")))]
    let done = 0;
    for &x in &numbers[done..] {
        max = if x > max { x } else { max };
    }
    max
}

/// Number of codes at or above `least`.
#[inline(always)]
pub fn count_from(least: u16, codes: &[u16]) -> u32 {
    #[cfg(all(target_arch = "arm", feature = "helium"))]
    let (done, count) = {
        let mut count = 0;
        (super::arm::count_from(least, codes, &mut count), count)
    };
    #[cfg(not(all(target_arch = "arm", feature = "helium")))]
    let (done, count) = (0, 0);
    count + codes[done..].iter().map(|&code| u32::from(code >= least)).sum::<u32>()
}

#[cfg(test)]
mod tests {
    use super::*;
    use micromath::F32Ext;

    #[test]
    fn extremes_are_those_of_single_steps() {
        for len in [0, 1, 7, 8, 9, 40] {
            let halves: [f16; 40] = core::array::from_fn(|i| f16::from_f32((i as f32 * 7.7) % 5.0 - 6.0));
            let most = halves[..len].iter().fold(f32::NEG_INFINITY, |most, x| most.max(x.to_f32()));
            assert_eq!(max_finite(&halves[..len]), (most, true), "all of them negative");
            let singles = halves.map(widen);
            assert_eq!(largest(&singles[..len], -5.5), most.max(-5.5));
            for at in 0..len {
                let mut halves = halves;
                halves[at] = [f16::INFINITY, f16::NEG_INFINITY, f16::NAN][at % 3];
                assert!(!max_finite(&halves[..len]).1, "{at} of {len}");
            }
            let codes: [u16; 40] = core::array::from_fn(|i| [0, 4094, 4095, 65_535, 32_768][i % 5]);
            let expected = codes[..len].iter().filter(|&&code| code >= 4095).count();
            assert_eq!(count_from(4095, &codes[..len]), expected as u32);
        }
        assert_eq!(max_finite(&[f16::NEG_ZERO; 9]).0.to_bits(), 0, "a zero has no sign");
    }

    #[test]
    fn the_exponential_has_the_bits_of_micromath() {
        let step = if cfg!(debug_assertions) { 997 } else { 101 };
        for bits in (0..=SATURATED.to_bits()).step_by(step).chain(0x3f7f_ff00..0x3f80_0100) {
            let x = f32::from_bits(bits);
            assert_eq!(exp(x).to_bits(), F32Ext::exp(x).to_bits(), "{x:e}");
        }
        assert_eq!(exp(SATURATED).to_bits(), F32Ext::exp(SATURATED).to_bits());
    }

    #[test]
    fn sigmoid_keeps_its_stated_error() {
        let (mut absolute, mut relative) = (0.0_f64, 0.0_f64);
        for i in -3_000_000..=3_000_000 {
            let x = i as f32 * 1e-5;
            let expected = 1.0 / (1.0 + (-f64::from(x)).exp());
            let error = (f64::from(sigmoid(x)) - expected).abs();
            absolute = absolute.max(error);
            if x.abs() < SATURATED {
                relative = relative.max(error / expected);
            }
        }
        assert!(absolute < 1.8e-4, "absolute error {absolute:e}");
        assert!(relative < 8e-4, "relative error {relative:e}");
    }

    #[test]
    fn sigmoid_is_symmetric_and_bounded() {
        assert_eq!(sigmoid(0.0), 0.5);
        assert_eq!(sigmoid(f32::INFINITY), 1.0 - sigmoid(f32::NEG_INFINITY));
        for i in 0..20_000 {
            let x = i as f32 * 1e-3;
            assert!((sigmoid(x) + sigmoid(-x) - 1.0).abs() <= f32::EPSILON, "{x}");
            assert!((0.0..=1.0).contains(&sigmoid(x)));
        }
    }
}
