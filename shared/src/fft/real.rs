//! The transform of N real numbers, computed as N/2 complex ones.
//!
//! Source of the identities: Press et al., Numerical Recipes, 3rd ed., section 12.3.2, "FFT of single real function".

use super::complex::{Fft, Lanes, mul};
use super::error::{FftError, MAX_LEN};
use super::twiddle::Roots;

/// Plan of a real transform, 8 to [`MAX_LEN`] long.
///
/// The spectrum has N/2 + 1 numbers. Those at 0 and N/2 are real, and number 0 holds both: (X\[0\], X\[N/2\]).
#[derive(Clone, Copy, Debug)]
pub struct RealFft {
    half: Fft,
}

impl RealFft {
    /// Plans a transform of `len` real numbers.
    ///
    /// # Errors
    /// [`FftError::Size`] unless `len` is a power of two from 8 to [`MAX_LEN`].
    pub const fn new(len: usize) -> Result<Self, FftError> {
        if len > MAX_LEN {
            return Err(FftError::Size { found: len });
        }
        match Fft::new(len / 2) {
            Ok(half) if len.is_power_of_two() => Ok(Self { half }),
            _ => Err(FftError::Size { found: len }),
        }
    }

    /// The complex transform of N/2 numbers. Its [`Fft::slot`] is the index of each pair of input numbers.
    #[inline(always)]
    pub const fn half(&self) -> Fft {
        self.half
    }

    /// Transforms the pairs `(x[2 n], x[2 n + 1])`, each in its slot, to **twice** the spectrum, in natural order.
    #[inline(always)]
    pub fn forward<const L: usize>(&self, data: &mut [Lanes<L>]) {
        self.half.process(data);
        self.untangle(data);
    }

    /// Converts the complex transform of the pairs to twice the spectrum.
    #[inline(always)]
    pub(super) fn untangle<const L: usize>(&self, data: &mut [Lanes<L>]) {
        let half = self.half.len();
        let [re, im] = data[0];
        data[0] = [lane(|l| 2.0 * (re[l] + im[l])), lane(|l| 2.0 * (re[l] - im[l]))];
        let roots = Roots::new(2 * half);
        for k in 1..half / 2 {
            let (z, m) = (data[k], data[half - k]);
            let even: Lanes<L> = [lane(|l| z[0][l] + m[0][l]), lane(|l| z[1][l] - m[1][l])];
            // -i (z - conj m)
            let odd: Lanes<L> = [lane(|l| z[1][l] + m[1][l]), lane(|l| m[0][l] - z[0][l])];
            let odd = mul(odd, roots.at(k));
            data[k] = [lane(|l| even[0][l] + odd[0][l]), lane(|l| even[1][l] + odd[1][l])];
            data[half - k] = [lane(|l| even[0][l] - odd[0][l]), lane(|l| odd[1][l] - even[1][l])];
        }
        let [re, im] = data[half / 2];
        data[half / 2] = [lane(|l| 2.0 * re[l]), lane(|l| -2.0 * im[l])];
    }

    /// Converts numbers `k` and `N/2 - k` of a spectrum, 0 < k < N/4, to the input of [`Self::inverse`] in these
    /// places.
    #[inline(always)]
    pub fn tangle<const L: usize>(&self, k: usize, x: Lanes<L>, m: Lanes<L>) -> [Lanes<L>; 2] {
        let [cos, sin] = Roots::new(2 * self.half.len()).at(k);
        let even: Lanes<L> = [lane(|l| x[0][l] + m[0][l]), lane(|l| x[1][l] - m[1][l])];
        let odd: Lanes<L> = mul([lane(|l| x[0][l] - m[0][l]), lane(|l| x[1][l] + m[1][l])], [cos, -sin]);
        // even + i odd, conj(even - i odd); imaginary part first.
        [
            [lane(|l| even[1][l] + odd[0][l]), lane(|l| even[0][l] - odd[1][l])],
            [lane(|l| odd[0][l] - even[1][l]), lane(|l| even[0][l] + odd[1][l])],
        ]
    }

    /// Converts number 0, which holds (X\[0\], X\[N/2\]), as [`Self::tangle`] does.
    #[inline(always)]
    pub fn tangle_ends<const L: usize>(&self, first: [f32; L], last: [f32; L]) -> Lanes<L> {
        [lane(|l| first[l] - last[l]), lane(|l| first[l] + last[l])]
    }

    /// Converts number N/4 as [`Self::tangle`] does.
    #[inline(always)]
    pub fn tangle_middle<const L: usize>(&self, x: Lanes<L>) -> Lanes<L> {
        [lane(|l| -2.0 * x[1][l]), lane(|l| 2.0 * x[0][l])]
    }

    /// Transforms the converted numbers, each in its slot, to **N times** the pairs `(x[2 n + 1], x[2 n])`: imaginary
    /// part first.
    #[inline(always)]
    pub fn inverse<const L: usize>(&self, data: &mut [Lanes<L>]) {
        self.half.process(data);
    }
}

#[inline(always)]
fn lane<const L: usize>(f: impl FnMut(usize) -> f32) -> [f32; L] {
    core::array::from_fn(f)
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::super::naive;
    use super::*;
    use std::vec::Vec;

    fn wave(len: usize) -> Vec<f32> {
        (0..len).map(|n| ((n * n * 31 + n * 7) % 101) as f32 / 50.0 - 1.0).collect()
    }

    fn forward(x: &[f32]) -> Vec<[f32; 2]> {
        let fft = RealFft::new(x.len()).unwrap();
        let mut data = std::vec![[[0.0; 1]; 2]; x.len() / 2];
        for (n, pair) in x.chunks(2).enumerate() {
            data[fft.half().slot(n)] = [[pair[0]], [pair[1]]];
        }
        fft.forward(&mut data);
        let mut spectrum: Vec<_> = data.iter().map(|x| [x[0][0] / 2.0, x[1][0] / 2.0]).collect();
        spectrum.push([spectrum[0][1], 0.0]);
        spectrum[0][1] = 0.0;
        spectrum
    }

    #[test]
    fn every_size_agrees_with_the_definition() {
        for log2 in 3..=10 {
            let x = wave(1 << log2);
            let expected = naive::dft(&x.iter().map(|&x| [f64::from(x), 0.0]).collect::<Vec<_>>(), false);
            let scale = expected.iter().map(|x| x[0].hypot(x[1])).fold(0.0, f64::max);
            for (k, found) in forward(&x).iter().enumerate() {
                let error = (f64::from(found[0]) - expected[k][0]).hypot(f64::from(found[1]) - expected[k][1]);
                assert!(error < 5e-7 * scale, "N = {}, k = {k}: {error:e} of {scale}", x.len());
            }
        }
    }

    #[test]
    fn the_inverse_gives_the_input_back_n_times() {
        for len in [8, 16, 256, 1024] {
            let x = wave(len);
            let spectrum = forward(&x);
            let fft = RealFft::new(len).unwrap();
            let slot = |n| fft.half().slot(n);
            let mut data = std::vec![[[0.0; 1]; 2]; len / 2];
            let at = |k: usize| spectrum[k].map(|x| [x]);
            data[slot(0)] = fft.tangle_ends(at(0)[0], at(len / 2)[0]);
            data[slot(len / 4)] = fft.tangle_middle(at(len / 4));
            for k in 1..len / 4 {
                [data[slot(k)], data[slot(len / 2 - k)]] = fft.tangle(k, at(k), at(len / 2 - k));
            }
            fft.inverse(&mut data);
            for (n, found) in data.iter().enumerate() {
                let pair = [found[1][0], found[0][0]].map(|x| x / len as f32);
                assert!((pair[0] - x[2 * n]).abs() < 1e-6 && (pair[1] - x[2 * n + 1]).abs() < 1e-6, "N = {len}, {n}");
            }
        }
    }

    #[test]
    fn other_sizes_are_refused() {
        for len in [0, 4, 9, 12, 2048] {
            assert!(RealFft::new(len).is_err(), "{len}");
        }
    }
}
