//! The multiply-accumulate, the maximum, and the one transcendental function of the network: one code for every target.

use super::convert::widen;
use super::f16;

/// Argument beyond which the logistic function is 0 or 1 to within half a unit of the smallest half.
pub(super) const SATURATED: f32 = 18.0;

/// Logistic function `1 / (1 + e^-x)`.
///
/// It uses the approximation of the exponential that `micromath` has, of `|x|` only, where its relative error is 6.8e-4
/// (for `-|x|` it is 2.4e-3). The absolute error of the result is below 1.8e-4 everywhere and its relative error below
/// 8e-4: a third of an ulp of a half near 1. `sigmoid(x) + sigmoid(-x)` is 1 to one rounding. An infinite argument gives 0 or 1. NaN, which cannot
/// occur in a [`crate::pipeline`], gives a number from 0.5 to 1.
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

/// Largest value of a slice by `>`, and whether all values are finite. `(-inf, true)` for an empty slice.
pub fn max_finite(values: &[f16]) -> (f32, bool) {
    let mut finite = true;
    let mut max = f32::NEG_INFINITY;
    for &value in values {
        finite &= value.is_finite();
        let value = widen(value);
        max = if value > max { value } else { max };
    }
    (max, finite)
}

#[cfg(test)]
mod tests {
    use super::*;
    use micromath::F32Ext;

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
