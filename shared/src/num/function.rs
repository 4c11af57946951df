//! The multiply-accumulate, the maximum, and the one transcendental function of the network: one code for every target.

use super::convert::widen;
use super::f16;
use micromath::F32Ext;

/// Argument beyond which the logistic function is 0 or 1 to within half a unit of the smallest half.
const SATURATED: f32 = 18.0;

/// Logistic function `1 / (1 + e^-x)`.
///
/// It uses the exponential of `micromath`, of `|x|` only, where its relative error is 6.8e-4 (for `-|x|` it is 2.4e-3).
/// The absolute error of the result is below 1.8e-4 everywhere and its relative error below 8e-4: a third of an ulp of
/// a half near 1. `sigmoid(x) + sigmoid(-x)` is 1 to one rounding. An infinite argument gives 0 or 1. NaN, which cannot
/// occur in a [`crate::pipeline`], gives a number from 0.5 to 1.
#[inline(always)]
pub fn sigmoid(x: f32) -> f32 {
    let magnitude = if x < 0.0 { -x } else { x };
    let magnitude = if magnitude < SATURATED { magnitude } else { SATURATED };
    let tail = 1.0 / (1.0 + F32Ext::exp(magnitude));
    if x < 0.0 { tail } else { 1.0 - tail }
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
