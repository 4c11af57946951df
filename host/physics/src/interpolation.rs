//! Weights that interpolate an image between its pixels: one kernel for PSFs that are moved by a fraction of a pixel,
//! for images that effects displace, and for copies of an image such as leaks and ghosts. Linear interpolation would
//! blur them by `f (1 - f)` px^2 along an axis, where f is the fraction of a pixel.
//!
//! ```text
//! out(x) = sum_j in(j) k(j - x),   k(u) = sinc(u) I0(b sqrt(1 - (u/w)^2)) / I0(b)  for |u| < w, 0 beyond
//! ```
//! (Kaiser, IEEE ISCAS, 20, 1974), divided by the sum of the weights, so that no light is lost. Small moves of waves
//! are right within 0.1 % up to 0.3 cycles a pixel, 1.4 % too small at 0.35, and 13 % at 0.4. Such frequencies hold
//! little of the light of most PSFs, and part of that is aliased. The polynomial of Lagrange through 10 pixels loses
//! 1.4 % at 0.25 and 17 % at 0.35: shifts that were fitted with it to PSFs of 0.8 px came out 1.1 % small, and 0.4 %
//! small with this kernel. A sinc without a window loses nothing, and spreads the aliased light of a sharp PSF over the
//! whole image, as rows of alternating sign, into pixels so dark that they are known far better.

use ndarray::{Array2, Axis, Slice};
use puruspe::In;
use std::f64::consts::PI;
use std::sync::LazyLock;

/// Number of pixels that an interpolated value depends on, along each axis.
pub const TAPS: usize = 16;
/// Half the width w of the kernel, px.
const HALF_WIDTH_PX: f64 = 8.0;
/// Shape b of its window.
const SHAPE: f64 = 10.0;
/// Taps before the position.
const BEFORE: usize = TAPS / 2 - 1;

/// The first pixel, and the weights of it and those after it, for the value at `x`, px.
pub fn weights(x: f64) -> (isize, [f64; TAPS]) {
    let floor = x.floor();
    (floor as isize - BEFORE as isize, at(x - floor))
}

/// [`weights`] from a table, to 1e-6.
fn tabulated(x: f64) -> (isize, [f32; TAPS]) {
    let floor = x.floor();
    let fine = (x - floor) * STEPS as f64;
    let step = (fine as usize).min(STEPS - 1);
    let part = (fine - step as f64) as f32;
    let [weights, slopes] = &TABLE[step];
    (floor as isize - BEFORE as isize, std::array::from_fn(|t| weights[t] + part * slopes[t]))
}

/// Number of zeros that a line of pixels for [`Lines::value`] has before and after its pixels.
pub const BESIDE: usize = TAPS;

/// Interpolates lines of pixels one value after the other. Where it is called in code for a processor's vectors, it
/// uses them.
///
/// ```
/// use ommatidia_physics::interpolation::{BESIDE, Lines};
///
/// let mut line = vec![0.0f32; 40 + 2 * BESIDE];
/// (0..40).for_each(|i| line[BESIDE + i] = i as f32);
/// assert!((Lines::get().value(&line, 19.3) - 19.3).abs() < 1e-3);
/// assert_eq!(Lines::get().value(&line, -20.0), 0.0);
/// ```
#[derive(Clone, Copy)]
pub struct Lines(&'static [[[f32; TAPS]; 2]; STEPS]);

impl Lines {
    /// With the table of the weights, which is made once.
    pub fn get() -> Self {
        Self(&TABLE)
    }

    /// The value at `x`, px from the first of the pixels, of a line of them between [`BESIDE`] zeros; to 1e-6 of the
    /// weights, 0 where `x` is no number. It panics where the line has no such zeros.
    #[inline(always)]
    pub fn value(self, line: &[f32], x: f64) -> f32 {
        const TO_WHOLE: f64 = 1.5 * (1u64 << 52) as f64;
        let last = ((line.len() - TAPS) * STEPS) as f64;
        let fine = ((x + (BESIDE - BEFORE) as f64) * STEPS as f64).max(0.0).min(last);
        // Its lowest bits are the nearest whole number: no instruction rounds on every processor.
        let whole = fine + TO_WHOLE;
        let part = (fine - (whole - TO_WHOLE)) as f32;
        let at = whole.to_bits() as u32 as usize;
        let [weights, slopes] = &self.0[at % STEPS];
        let pixels = &line[at / STEPS..][..TAPS];
        // Sums side by side fill a vector.
        let (mut sums, mut changes) = ([0.0f32; LANES], [0.0f32; LANES]);
        for i in 0..TAPS {
            sums[i % LANES] += weights[i] * pixels[i];
            changes[i % LANES] += slopes[i] * pixels[i];
        }
        (0..LANES).map(|i| sums[i] + part * changes[i]).sum()
    }
}

/// The image with its content displaced by `d` = [row, col] pixels, zero outside: along the columns, then along the
/// rows. It is all zero where the displacement is not finite.
pub fn shifted(image: &Array2<f32>, d: [f64; 2]) -> Array2<f32> {
    if d == [0.0, 0.0] {
        return image.clone();
    }
    let (rows, cols) = image.dim();
    let beyond = |d: f64, n: usize| d.is_nan() || d.abs() > (n + TAPS) as f64;
    if beyond(d[0], rows) || beyond(d[1], cols) {
        return Array2::zeros((rows, cols));
    }
    // `out[i] += w in[i + offset]` along an axis, where both lie inside.
    let along = |from: &Array2<f32>, axis: Axis, n: usize, d: f64| {
        let mut out = Array2::<f32>::zeros((rows, cols));
        let (first, weights) = tabulated(-d);
        for (offset, w) in (first..).zip(weights).filter(|(_, w)| *w != 0.0) {
            let reach = offset.unsigned_abs().min(n);
            let (low, high) = (Slice::from(..n - reach), Slice::from(reach..));
            let (to, of) = if offset < 0 { (high, low) } else { (low, high) };
            out.slice_axis_mut(axis, to).scaled_add(w, &from.slice_axis(axis, of));
        }
        out
    };
    along(&along(image, Axis(0), rows, d[0]), Axis(1), cols, d[1])
}

/// Number of tabulated fractions of a pixel.
const STEPS: usize = 1024;
/// Sums that run side by side.
const LANES: usize = 8;

/// The weights at each of them, and their slopes there, per step.
static TABLE: LazyLock<Box<[[[f32; TAPS]; 2]; STEPS]>> = LazyLock::new(|| {
    let weights = |step: f64| at(step / STEPS as f64);
    let row = |i: usize| {
        let [before, here, after] = [-1.0, 0.0, 1.0].map(|d| weights(i as f64 + d));
        [here.map(|w| w as f32), std::array::from_fn(|t| (0.5 * (after[t] - before[t])) as f32)]
    };
    let mut table = Box::new([[[0.0; TAPS]; 2]; STEPS]);
    table.iter_mut().enumerate().for_each(|(i, to)| *to = row(i));
    table
});

/// Weights of the pixels -7 to 8 for the value at `fraction`, 0 to 1 px.
fn at(fraction: f64) -> [f64; TAPS] {
    let pixel = |t: usize| t as f64 - BEFORE as f64;
    let mut weights: [f64; TAPS] = std::array::from_fn(|t| kernel(pixel(t) - fraction));
    let sum: f64 = weights.iter().sum();
    weights.iter_mut().for_each(|w| *w /= sum);
    weights
}

fn kernel(x: f64) -> f64 {
    let inside = 1.0 - (x / HALF_WIDTH_PX).powi(2);
    if inside <= 0.0 { 0.0 } else { sinc(x) * In(0, SHAPE * inside.sqrt()) / In(0, SHAPE) }
}

fn sinc(x: f64) -> f64 {
    if x.fract() == 0.0 { f64::from(u8::from(x == 0.0)) } else { (PI * x).sin() / (PI * x) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_pixels_are_copied_and_light_stays_where_it_is_put() {
        for x in [-3.0, 0.0, 5.0] {
            let (first, w) = weights(x);
            let copied = w.iter().enumerate().all(|(t, w)| *w == f64::from(u8::from(first + t as isize == x as isize)));
            assert!(copied, "{x}: {w:?}");
        }
        for x in [-0.999, -0.5, 0.01, 0.04, 0.25, 0.4999, 0.5001, 0.75, 12.3] {
            let (first, w) = weights(x);
            let moment = |power: i32| w.iter().zip(first..).map(|(w, j)| w * (j as f64).powi(power)).sum::<f64>();
            assert!((moment(0) - 1.0).abs() < 1e-12 && (moment(1) - x).abs() < 2e-4, "{x}: {}", moment(1));
        }
    }

    /// The response to a wave, against the moved wave: a fit of a small shift has the error of the small move.
    #[test]
    fn small_moves_of_waves_are_right() {
        let d = 0.01;
        for (frequency, most) in [(0.02, 1e-3), (0.1, 1e-3), (0.2, 1e-3), (0.3, 1e-3), (0.35, 0.015)] {
            let (first, w) = weights(-d);
            let phase = |j: isize| 2.0 * PI * frequency * j as f64;
            let moved = -w.iter().zip(first..).map(|(w, j)| w * phase(j).sin()).sum::<f64>() / (2.0 * PI * frequency);
            assert!((moved / d - 1.0).abs() < most, "{frequency}: {moved}");
        }
    }

    /// Linear interpolation would widen a focus of variance 1.5 px^2 by 0.25 px^2.
    #[test]
    fn a_displaced_focus_keeps_its_width() {
        let focus = Array2::from_shape_fn((40, 40), |(r, c)| {
            (-((r as f64 - 16.0).powi(2) + (c as f64 - 18.0).powi(2)) / 3.0).exp() as f32
        });
        let moved = shifted(&focus, [5.5, -3.5]);
        let moment = |image: &Array2<f32>, power: i32, centre: f64| {
            let sum: f64 = image.iter().map(|v| f64::from(*v)).sum();
            image.indexed_iter().map(|((r, _), v)| f64::from(*v) * (r as f64 - centre).powi(power)).sum::<f64>() / sum
        };
        assert!((moment(&moved, 1, 0.0) - 21.5).abs() < 1e-3, "{}", moment(&moved, 1, 0.0));
        assert!((moment(&moved, 2, 21.5) - moment(&focus, 2, 16.0)).abs() < 0.01, "{}", moment(&moved, 2, 21.5));
        for far in [[f64::NAN, 0.0], [1e300, 0.0], [0.0, f64::NEG_INFINITY], [0.0, 60.0]] {
            assert!(shifted(&focus, far).iter().all(|v| *v == 0.0), "{far:?}");
        }
    }

    #[test]
    fn the_table_has_the_weights() {
        for x in [-7.3, -0.0004, 0.1234, 0.5, 0.99999, 3.7] {
            let ((a, exact), (b, table)) = (weights(x), tabulated(x));
            assert!(a == b && exact.iter().zip(&table).all(|(e, t)| (e - f64::from(*t)).abs() < 2e-6), "{x}");
        }
    }

    /// In the middle of a line, over both of its ends, and beside it.
    #[test]
    fn the_value_at_a_place_is_the_sum_of_the_weights() {
        let pixels: Vec<f32> = (0..40).map(|i| ((i * i) % 17) as f32).collect();
        let line = [&[0.0; BESIDE][..], &pixels, &[0.0; BESIDE]].concat();
        let value = |x| Lines::get().value(&line, x);
        for x in [-30.0, -9.2, -7.5, -0.4, 0.0, 3.25, 19.0, 20.7, 38.99, 39.0, 46.5, 80.0] {
            let (first, w) = weights(x);
            let pixel = |j: isize| usize::try_from(j).ok().and_then(|j| pixels.get(j)).map_or(0.0, |v| f64::from(*v));
            let want: f64 = w.iter().zip(first..).map(|(w, j)| w * pixel(j)).sum();
            assert!((f64::from(value(x)) - want).abs() < 1e-4, "{x}: {} for {want}", value(x));
        }
        for x in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e300] {
            assert_eq!(value(x), 0.0, "{x}");
        }
    }
}
