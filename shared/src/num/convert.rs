//! Conversions between binary16 and binary32, with the same bits on every target.

#[cfg(all(target_arch = "arm", feature = "fpv4"))]
use super::arm as unit;
use super::f16;
#[cfg(not(all(target_arch = "arm", feature = "fpv4")))]
use integer as unit;

/// Widens a half. The result is exact. A NaN becomes a NaN, and the default NaN becomes the quiet NaN `0x7fc0_0000`.
#[inline(always)]
pub fn widen(value: f16) -> f32 {
    unit::widen(value)
}

/// Rounds to the nearest half, ties to even, and to infinity from 65,520 on. A NaN becomes a NaN, and the default NaN
/// becomes `0x7e00`.
#[inline(always)]
pub fn narrow(value: f32) -> f16 {
    unit::narrow(value)
}

/// The largest half, 65,504, as bits.
const MAX_F16: u16 = 0x7bff;

/// A half whose infinity is replaced by the largest half of its sign.
#[inline(always)]
pub(super) fn bounded(value: f16) -> f16 {
    let bits = value.to_bits();
    f16::from_bits(bits - u16::from(bits & 0x7fff == MAX_F16 + 1))
}

/// Widens `from` into the equally long `to`.
#[inline(always)]
pub fn widen_slice(from: &[f16], to: &mut [f32]) {
    debug_assert_eq!(from.len(), to.len());
    unit::widen_slice(from, to);
}

/// Narrows `from` into the equally long `to`.
#[inline(always)]
pub fn narrow_slice(from: &[f32], to: &mut [f16]) {
    debug_assert_eq!(from.len(), to.len());
    unit::narrow_slice(from, to);
}

/// Conversions with integer operations, for targets other than Arm. They have no branches, so that the compiler can
/// vectorize loops.
#[cfg(not(all(target_arch = "arm", feature = "fpv4")))]
mod integer {
    use super::f16;

    const INFINITY_F32: u32 = 0x7f80_0000;
    const SIGN_F32: u32 = 0x8000_0000;
    /// NaN as this crate writes it: quiet, positive, no payload.
    pub(super) const NAN_F16: u16 = 0x7e00;
    /// The smallest positive half, 2^-24.
    const SUBNORMAL_UNIT: f32 = 1.0 / 16_777_216.0;

    /// The exponent is re-biased by one exact multiplication, which also brings subnormal halves to their normal form.
    /// Every NaN becomes the default one.
    #[inline(always)]
    pub(super) fn widen(value: f16) -> f32 {
        let bits = u32::from(value.to_bits());
        let sign = (bits & 0x8000) << 16;
        let magnitude = bits & 0x7fff;
        // An integer below 2^24 times a power of two: exact, and never a subnormal operand (which Helium would flush).
        let subnormal = (magnitude as f32 * SUBNORMAL_UNIT).to_bits();
        let normal = (magnitude << 13) + ((127 - 15) << 23);
        let finite = if magnitude < 0x0400 { subnormal } else { normal };
        let special = if magnitude > 0x7c00 { 0x7fc0_0000 } else { INFINITY_F32 | sign };
        f32::from_bits(if magnitude < 0x7c00 { finite | sign } else { special })
    }

    /// After F. Giesen's `float_to_half_fast3_rtne`: subnormal results round by one float addition, normal ones by an
    /// integer addition below the kept bits. Every NaN becomes the default one.
    #[inline(always)]
    pub(super) fn narrow(value: f32) -> f16 {
        let bits = value.to_bits();
        let magnitude = bits & !SIGN_F32;
        let sign = ((bits & SIGN_F32) >> 16) as u16;
        // 0.5 has an ulp of 2^-24, the unit of the subnormal halves: the addition rounds to it.
        let subnormal = (f32::from_bits(magnitude) + 0.5).to_bits().wrapping_sub(0.5_f32.to_bits());
        let odd = (magnitude >> 13) & 1;
        let normal = magnitude.wrapping_sub((127 - 15) << 23).wrapping_add(0x0fff + odd) >> 13;
        let finite = if magnitude < ((127 - 14) << 23) { subnormal } else { normal };
        let infinite = if magnitude >= ((127 + 16) << 23) { 0x7c00 } else { finite };
        f16::from_bits(if magnitude > INFINITY_F32 { NAN_F16 } else { infinite as u16 | sign })
    }

    #[inline(always)]
    pub(super) fn widen_slice(from: &[f16], to: &mut [f32]) {
        for (to, &from) in to.iter_mut().zip(from) {
            *to = widen(from);
        }
    }

    #[inline(always)]
    pub(super) fn narrow_slice(from: &[f32], to: &mut [f16]) {
        for (to, &from) in to.iter_mut().zip(from) {
            *to = narrow(from);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::integer::NAN_F16;
    use super::*;
    use proptest::prelude::*;

    /// Value of a half from the definition of the format (IEEE 754-2019, 3.4).
    fn by_definition(bits: u16) -> f64 {
        let sign = if bits & 0x8000 == 0 { 1.0 } else { -1.0 };
        let exponent = i32::from(bits >> 10 & 0x1f);
        let fraction = f64::from(bits & 0x3ff) / 1024.0;
        match exponent {
            0 => sign * fraction * 2f64.powi(-14),
            31 if fraction == 0.0 => sign * f64::INFINITY,
            31 => f64::NAN,
            _ => sign * (1.0 + fraction) * 2f64.powi(exponent - 15),
        }
    }

    #[test]
    fn every_half_widens_to_its_definition_and_comes_back() {
        for bits in 0..=u16::MAX {
            let wide = widen(f16::from_bits(bits));
            let expected = by_definition(bits);
            if expected.is_nan() {
                assert_eq!(wide.to_bits(), 0x7fc0_0000, "{bits:#06x}");
                assert_eq!(narrow(wide).to_bits(), NAN_F16);
                continue;
            }
            assert_eq!(wide.to_bits(), (expected as f32).to_bits(), "{bits:#06x}");
            assert_eq!(wide.to_bits(), f16::from_bits(bits).to_f32().to_bits(), "{bits:#06x}: differs from `half`");
            assert_eq!(narrow(wide).to_bits(), bits, "{bits:#06x} does not come back");
        }
    }

    #[test]
    fn every_tie_rounds_to_even_and_its_neighbours_to_the_nearest() {
        for bits in (0..0x7bff_u16).flat_map(|bits| [bits, bits | 0x8000]) {
            let (low, high) = (by_definition(bits), by_definition(bits + 1));
            let tie = ((low + high) / 2.0) as f32;
            let even = if bits & 1 == 0 { bits } else { bits + 1 };
            assert_eq!(narrow(tie).to_bits(), even, "tie above {bits:#06x}");
            assert_eq!(narrow(f32::from_bits(tie.to_bits() - 1)).to_bits(), bits, "below the tie above {bits:#06x}");
            assert_eq!(narrow(f32::from_bits(tie.to_bits() + 1)).to_bits(), bits + 1, "above it");
        }
    }

    #[test]
    fn overflow_and_nan() {
        assert_eq!(narrow(65_519.996).to_bits(), 0x7bff);
        assert_eq!(narrow(65_520.0).to_bits(), 0x7c00);
        assert_eq!(narrow(f32::MAX).to_bits(), 0x7c00);
        assert_eq!(narrow(f32::NEG_INFINITY).to_bits(), 0xfc00);
        assert_eq!(narrow(f32::from_bits(0xff80_0001)).to_bits(), NAN_F16);
        assert_eq!(narrow(f32::from_bits(1)).to_bits(), 0);
    }

    proptest! {
        #[test]
        fn narrowing_agrees_with_half(bits: u32) {
            let value = f32::from_bits(bits);
            prop_assume!(!value.is_nan());
            prop_assert_eq!(narrow(value).to_bits(), f16::from_f32(value).to_bits());
        }
    }

    #[test]
    fn slices_convert_like_scalars_at_every_length_and_offset() {
        let halves: [f16; 70] = core::array::from_fn(|i| f16::from_bits((i * 947) as u16));
        for start in 0..4 {
            for len in 0..60 {
                let from = &halves[start..start + len];
                let mut wide = [7.0_f32; 64];
                widen_slice(from, &mut wide[..len]);
                assert!(wide[..len].iter().zip(from).all(|(w, &h)| w.to_bits() == widen(h).to_bits()));
                assert!(wide[len..].iter().all(|&w| w == 7.0), "wrote past the end");
                let mut back = [f16::ONE; 64];
                narrow_slice(&wide[..len], &mut back[..len]);
                assert!(back[..len].iter().zip(&wide).all(|(b, &w)| b.to_bits() == narrow(w).to_bits()));
                assert!(back[len..].iter().all(|&b| b == f16::ONE), "wrote past the end");
            }
        }
    }
}
