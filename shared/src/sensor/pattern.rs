//! The fixed pattern of one sensor.

use crate::blob::{Header, Weights};
use crate::num::{count_from, f16, fused, widen};

/// The fixed pattern of a sensor, borrowed from a network file.
#[derive(Clone, Copy, Debug)]
pub struct FixedPattern<'a> {
    /// Mean signal without light, DN.
    pub black_level_dn: f32,
    /// The highest code, DN. A pixel at or above it is saturated.
    pub saturation_dn: u16,
    /// Columns of the maps, pixels.
    pub cols: usize,
    /// Offset of each pixel relative to the black level, DN, row by row. None: 0.
    pub offset_dn: Option<&'a [f16]>,
    /// Inverse relative gain of each pixel, row by row. None: 1.
    pub inverse_gain: Option<&'a [f16]>,
}

impl<'a> FixedPattern<'a> {
    /// The fixed pattern in a network file.
    pub fn new(header: &Header, weights: &Weights<'a>) -> Self {
        Self {
            black_level_dn: header.sensor.black_level_dn,
            saturation_dn: header.sensor.saturation_dn,
            cols: usize::from(header.frame.cols),
            offset_dn: weights.offset_dn,
            inverse_gain: weights.inverse_gain,
        }
    }

    /// Offset, DN, and inverse gain of a pixel.
    #[inline(always)]
    fn pixel(&self, row: usize, col: usize) -> (f32, f32) {
        let at = row * self.cols + col;
        (self.offset_dn.map_or(0.0, |map| widen(map[at])), self.inverse_gain.map_or(1.0, |map| widen(map[at])))
    }

    /// Corrects columns `first..first + to.len()` of row `row` of a raw frame. `codes` holds the codes of these
    /// columns, and `to` receives the signal, DN.
    #[inline(always)]
    pub fn correct(&self, row: usize, first: usize, codes: &[u16], to: &mut [f32]) {
        self.correct_with(row, first, codes, to, |signal| signal);
    }

    /// [`Self::correct`]; `to` receives what `then` makes of each signal. Returns the number of leading signals that
    /// `then` was not called for: where vectors computed them, the caller can use vectors, too.
    #[inline(always)]
    pub fn correct_with(
        &self,
        row: usize,
        first: usize,
        codes: &[u16],
        to: &mut [f32],
        mut then: impl FnMut(f32) -> f32,
    ) -> usize {
        let of = |code, offset, gain| (f32::from(code) - self.black_level_dn - offset) * gain;
        if let (Some(offset), Some(gain)) = (self.offset_dn, self.inverse_gain) {
            let start = row * self.cols + first;
            let maps = [&offset[start..], &gain[start..]];
            let done = fused::correct_leading(codes, self.black_level_dn, maps, to);
            let [offset, gain] = maps.map(|map| map[done..].iter());
            for ((to, &code), (&offset, &gain)) in to[done..].iter_mut().zip(&codes[done..]).zip(offset.zip(gain)) {
                *to = then(of(code, widen(offset), widen(gain)));
            }
            done
        } else {
            for (col, (to, &code)) in (first..).zip(to.iter_mut().zip(codes)) {
                let (offset, gain) = self.pixel(row, col);
                *to = then(of(code, offset, gain));
            }
            0
        }
    }

    /// Number of codes at or above the saturation code.
    #[inline(always)]
    pub fn saturated(&self, codes: &[u16]) -> u32 {
        count_from(self.saturation_dn, codes)
    }

    /// Inverse of [`Self::correct`]: the codes of the sensor for `signal`, finite, DN. The code of a defective pixel is
    /// that without light.
    pub fn apply(&self, row: usize, first: usize, signal: &[f32], codes: &mut [u16]) {
        for (col, (code, &signal)) in (first..).zip(codes.iter_mut().zip(signal)) {
            let (offset, inverse_gain) = self.pixel(row, col);
            let signal = if inverse_gain == 0.0 { 0.0 } else { signal / inverse_gain };
            // The cast saturates at 0; the highest code is the other bound.
            let rounded = (signal + offset + self.black_level_dn + 0.5) as u32;
            *code = rounded.min(u32::from(self.saturation_dn)) as u16;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn maps() -> ([f16; 6], [f16; 6]) {
        ([0.0, 1.5, -3.0, 2.0, 0.25, 8.0].map(f16::from_f32), [1.0, 0.5, 2.0, 0.0, 1.25, 0.75].map(f16::from_f32))
    }

    #[test]
    fn correction_follows_its_formula() {
        let (offset, gain) = maps();
        let pattern = FixedPattern {
            black_level_dn: 64.0,
            saturation_dn: 4095,
            cols: 3,
            offset_dn: Some(&offset),
            inverse_gain: Some(&gain),
        };
        let mut row = [0.0; 3];
        pattern.correct(0, 0, &[64, 70, 100], &mut row);
        assert_eq!(row, [0.0, 2.25, 78.0]);
        pattern.correct(1, 0, &[4000, 60, 4095], &mut row);
        assert_eq!(row, [0.0, -5.3125, 3017.25], "a defective pixel is dark, a dark one stays negative");
        pattern.correct(1, 1, &[60, 4095], &mut row[..2]);
        assert_eq!(row[..2], [-5.3125, 3017.25], "part of a row");
        assert_eq!(pattern.saturated(&[4094, 4095, 65535]), 2);
    }

    #[test]
    fn correcting_undoes_applying_to_half_a_code() {
        let (offset, gain) = maps();
        let pattern = FixedPattern {
            black_level_dn: 64.25,
            saturation_dn: 4095,
            cols: 3,
            offset_dn: Some(&offset),
            inverse_gain: Some(&gain),
        };
        for signal in [0.0, 3.7, 500.0, 1500.25] {
            for row in 0..2 {
                let (mut codes, mut back) = ([0; 3], [0.0; 3]);
                pattern.apply(row, 0, &[signal; 3], &mut codes);
                pattern.correct(row, 0, &codes, &mut back);
                for col in 0..3 {
                    let gain = pattern.pixel(row, col).1;
                    let expected = if gain == 0.0 { 0.0 } else { signal };
                    assert!((back[col] - expected).abs() <= 0.5 * gain, "({row}, {col}) {signal}: {back:?}");
                }
            }
        }
    }

    #[test]
    fn codes_are_clamped() {
        let pattern =
            FixedPattern { black_level_dn: 64.0, saturation_dn: 4095, cols: 3, offset_dn: None, inverse_gain: None };
        let mut codes = [7; 3];
        pattern.apply(0, 0, &[-100.0, 1e9, 0.4], &mut codes);
        assert_eq!(codes, [0, 4095, 64]);
    }
}
