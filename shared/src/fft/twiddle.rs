//! Roots of unity, computed at compile time in f64 and rounded once.

use super::error::MAX_LEN;

/// `e^(-2 pi i k / 1024)`. The table covers the whole circle, so that a masked index needs no check.
static ROOTS: [[f32; 2]; MAX_LEN] = roots();

/// `e^(-2 pi i m k / 1024)` for m = 2, 1, 3: the roots of a butterfly of four numbers in bit-reversed order, side by
/// side. Shorter transforms use the table in larger steps.
#[cfg_attr(not(target_arch = "arm"), allow(dead_code))]
pub(crate) static ROOT_TRIPLES: [[[f32; 2]; 3]; MAX_LEN / 4] = triples();

/// The roots of unity of one transform length.
#[derive(Clone, Copy)]
pub(super) struct Roots {
    stride: usize,
}

impl Roots {
    /// For a power of two `len <= 1024`.
    #[inline(always)]
    pub(super) const fn new(len: usize) -> Self {
        Self { stride: MAX_LEN >> len.trailing_zeros() }
    }

    /// `e^(-2 pi i k / len)`.
    #[inline(always)]
    pub(super) fn at(self, k: usize) -> [f32; 2] {
        ROOTS[(k * self.stride) % MAX_LEN]
    }
}

const fn roots() -> [[f32; 2]; MAX_LEN] {
    let mut roots = [[0.0; 2]; MAX_LEN];
    let mut k = 0;
    while k < roots.len() {
        // Angles up to an eighth of the circle; the rest by symmetry, so that the table is symmetric to the last bit.
        let quarter = MAX_LEN / 4;
        let (turns, rest) = (k / quarter, k % quarter);
        let (cos, sin) = if rest <= quarter / 2 {
            (cosine(angle(rest)), sine(angle(rest)))
        } else {
            (sine(angle(quarter - rest)), cosine(angle(quarter - rest)))
        };
        roots[k] = match turns {
            0 => [cos as f32, -sin as f32],
            1 => [-sin as f32, -cos as f32],
            2 => [-cos as f32, sin as f32],
            _ => [sin as f32, cos as f32],
        };
        k += 1;
    }
    roots
}

const fn triples() -> [[[f32; 2]; 3]; MAX_LEN / 4] {
    let (roots, mut triples) = (roots(), [[[0.0; 2]; 3]; MAX_LEN / 4]);
    let mut k = 0;
    while k < triples.len() {
        triples[k] = [roots[2 * k], roots[k], roots[3 * k]];
        k += 1;
    }
    triples
}

const fn angle(k: usize) -> f64 {
    core::f64::consts::TAU * k as f64 / MAX_LEN as f64
}

/// Taylor series, |x| <= pi / 4: the first term left out is below 1e-18.
const fn sine(x: f64) -> f64 {
    series(x, 1.0, x)
}

const fn cosine(x: f64) -> f64 {
    series(1.0, 0.0, x)
}

/// `first - first x^2 / ((n + 1)(n + 2)) + ...`
const fn series(first: f64, n: f64, x: f64) -> f64 {
    let (mut term, mut sum, mut n) = (first, first, n);
    let mut i = 0;
    while i < 10 {
        term *= -x * x / ((n + 1.0) * (n + 2.0));
        sum += term;
        n += 2.0;
        i += 1;
    }
    sum
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;

    #[test]
    fn roots_are_correctly_rounded() {
        for (k, root) in ROOTS.iter().enumerate() {
            let (sin, cos) = angle(k).sin_cos();
            assert!((f64::from(root[0]) - cos).abs() <= 0.5 * f64::from(f32::EPSILON), "cos {k}");
            assert!((f64::from(root[1]) + sin).abs() <= 0.5 * f64::from(f32::EPSILON), "sin {k}");
        }
        assert_eq!(Roots::new(8).at(2)[1], -1.0);
        assert_eq!(Roots::new(4).at(3)[1], 1.0);
    }

    /// What transforms of up to 256 halves rest on where small numbers are flushed: halves are multiples of 2^-24, and
    /// a product with a root is rounded to 24 bits.
    #[test]
    fn no_transform_of_256_halves_comes_near_the_smallest_single() {
        for len in [16, 32, 64, 128, 256] {
            let mut finest = 2.0_f64.powi(-24);
            let mut pass = len;
            while pass > 4 {
                let parts = (0..pass).flat_map(|k| Roots::new(pass).at(k)).filter(|&part| part != 0.0);
                finest *= f64::from(parts.map(f32::abs).fold(1.0, f32::min)) * 2.0_f64.powi(-24);
                pass /= 4;
            }
            assert!(finest > f64::from(f32::MIN_POSITIVE) * 1e5, "{len}: {finest:e}");
        }
    }

    #[test]
    fn triples_are_those_of_a_butterfly() {
        for (k, triple) in ROOT_TRIPLES.iter().enumerate() {
            let roots = Roots::new(MAX_LEN);
            assert_eq!(*triple, [roots.at(2 * k), roots.at(k), roots.at(3 * k)]);
        }
    }
}
