//! Wings: light of each focus outside the windows of the calibration.
//!
//! No window holds it, so no prediction and no replicate does. The calibration states how much there may be
//! ([`ommatidia_model::instrument::Quality::outside_window`]); how it falls off with the distance is unknown. So the
//! sensor is divided into square rings round each focus, each twice as far out as the one before, and each holds an
//! unknown share of the light of the focus. The shares are independent, and their standard uncertainties are those of
//! light whose brightness falls as the fourth power of the distance; within a ring it falls like that, too. A halo or
//! glare that small is no effect, but an error of the calibration.
//!
//! Where objects are known, the shares are fitted as nuisances of the session ([`Column::Wing`]), with the stated
//! uncertainty as their prior: an observation "0 +- 1" of each share in units of that uncertainty. Frames outweigh that
//! prior, so each share has a range as well ([`range`]): what no calibration could have missed is not its error, but an
//! effect. Elsewhere the shares are errors of the calibration alone ([`super::replicas`]).
//!
//! Aberrations grow over the field, and their tails do. So the light outside may differ over the sensor as well: along
//! the rows, along the columns, and with the square of the distance from the centre. These three slopes are nuisances
//! of the same kind. Without them, tails that are brighter far from the axis would pass for a vignetting below zero.

use super::state::{Column, State};
use crate::data::{Observations, Shown};
use ndarray::Array2;
use pulp::{Arch, Simd, WithSimd};

/// Number of rings.
const RINGS: i32 = 3;
/// Rings of even brightness that stand for one in which it falls.
const STEPS: usize = 4;
/// Light is not negative; a window that holds a little too much leaves this much less than nothing outside, in standard
/// uncertainties.
const LEAST: f64 = -1.0;
/// A ring may hold this many times the light of the slowest law: the first ring outside the windows, from which that
/// follows, is known from noisy frames, and differs over the field.
const MARGIN: f64 = 1.5;

/// Number of slopes: along the rows, along the columns, and with the square of the distance from the centre.
const SLOPES: usize = 3;
/// Standard uncertainty of a slope: the change of the light outside the windows from the centre to the edge of the
/// sensor, relative to the stated light.
const UNEVEN: f64 = 0.5;
/// Largest slope of either sign, in standard uncertainties: the stated light twice, or none.
const STEEPEST: f64 = 2.0;

/// A ring round the window of a focus: half sides from and to, px, and the standard uncertainty of the share of light
/// in it.
pub(crate) type Ring = (usize, usize, f64);

/// Number of values that are fitted: the light of each ring, then the slopes.
pub(super) fn values(fitted: &[Ring]) -> usize {
    if fitted.is_empty() { 0 } else { fitted.len() + SLOPES }
}

/// The columns of the rings and slopes that are fitted.
pub(super) fn columns(fitted: &[Ring]) -> impl Iterator<Item = Column> {
    (0..values(fitted)).map(Column::Wing)
}

/// The rings whose light is fitted: none where no object is known.
pub(super) fn fitted(seen: &Observations, half: usize, outside: f64) -> Vec<Ring> {
    let known = seen.frames.iter().any(|f| matches!(f.shown, Shown::Object(_)));
    if known { rings(half, outside) } else { Vec::new() }
}

/// Light that a state has in the rings round an image of the lenses, in the unit of the image. None: it has none.
pub(super) fn light(image: &Array2<f32>, rings: &[Ring], state: &State) -> Option<Array2<f32>> {
    let lit = rings.iter().zip(&state.wings).filter(|(_, v)| **v != 0.0);
    let squares: Vec<Square> =
        lit.flat_map(|((inner, outer, share), value)| squares(*inner, *outer, share * value)).collect();
    let light = (!squares.is_empty()).then(|| summed(image, squares));
    let slopes = state.wings.get(rings.len()..).unwrap_or_default();
    if slopes.iter().all(|v| *v == 0.0) {
        return light;
    }
    let mut uneven = stated(image, rings);
    uneven.indexed_iter_mut().for_each(|(at, v)| {
        let shape = slope_shapes(image.dim(), at);
        *v *= slopes.iter().zip(shape).map(|(value, shape)| value * UNEVEN * shape).sum::<f64>() as f32;
    });
    Some(light.map_or_else(|| uneven.clone(), |light| light + &uneven))
}

/// Light in the unit of an image that one standard uncertainty of value `i` ([`columns`]) adds. None: there is no such
/// value. The slopes share the stated light, which is kept for the next of the same image.
pub(super) fn piece(
    image: &Array2<f32>,
    rings: &[Ring],
    i: usize,
    kept: &mut Option<Array2<f32>>,
) -> Option<Array2<f32>> {
    if let Some((inner, outer, share)) = rings.get(i) {
        return Some(spread(image, *inner, *outer) * *share as f32);
    }
    let slope = i.checked_sub(rings.len()).filter(|s| *s < SLOPES && !rings.is_empty())?;
    let mut light = kept.get_or_insert_with(|| stated(image, rings)).clone();
    light.indexed_iter_mut().for_each(|(at, v)| *v *= (UNEVEN * slope_shapes(image.dim(), at)[slope]) as f32);
    Some(light)
}

/// The stated light outside the windows, in the unit of an image.
fn stated(image: &Array2<f32>, rings: &[Ring]) -> Array2<f32> {
    let all: Vec<Square> = rings.iter().flat_map(|(inner, outer, share)| squares(*inner, *outer, *share)).collect();
    summed(image, all)
}

/// The shapes of the slopes at a pixel: from -1 to 1 along each axis, and from 0 to 1 from the centre to the corners.
fn slope_shapes((rows, cols): (usize, usize), (r, c): (usize, usize)) -> [f64; SLOPES] {
    let along = |i: usize, n: usize| 2.0 * i as f64 / (n as f64 - 1.0).max(1.0) - 1.0;
    let (y, x) = (along(r, rows), along(c, cols));
    [y, x, 0.5 * (y * y + x * x)]
}

/// Rings round the window of a focus.
pub(super) fn rings(half: usize, outside: f64) -> Vec<Ring> {
    if outside <= 0.0 || half == 0 {
        return Vec::new();
    }
    // Of light whose brightness falls as the fourth power of the distance, a quarter lies outside twice the distance.
    let share = |i: i32| outside * 0.75 * 0.25f64.powi(i);
    (0..RINGS).map(|i| (half << i, half << (i + 1), share(i))).collect()
}

/// Least and largest value of the share of ring `i`, or of a slope, in units of its standard uncertainty.
///
/// No optics throws light whose brightness falls more slowly than the cube of the distance (the edge of a pupil, see
/// [`ommatidia_model::bead::Extent::outside`]). By that law all rings hold twice as much as by the fourth power, of
/// which the stated uncertainty is one over the root of three; half of it lies in the first ring, and half as much as
/// in each in the next.
pub(super) fn range(i: usize) -> [f64; 2] {
    if i >= RINGS as usize {
        return [-STEEPEST, STEEPEST];
    }
    let [slowest, stated] = [2.0 * 3f64.sqrt() * 0.5f64.powi(i as i32 + 1), 0.75 * 0.25f64.powi(i as i32)];
    [LEAST, MARGIN * slowest / stated]
}

/// The light of an image spread over square rings round each of its pixels, from outside the half side `inner` to
/// `outer`, px: its brightness falls as the fourth power of the distance, in steps. Light that falls off the image is
/// lost.
pub(super) fn spread(image: &Array2<f32>, inner: usize, outer: usize) -> Array2<f32> {
    summed(image, squares(inner, outer, 1.0))
}

/// A square round each pixel: its half side, px, and the factor on the light in it.
type Square = (usize, f64);

/// A ring with a share of the light of its middle as a sum of squares: each step is a square less the one inside it.
fn squares(inner: usize, outer: usize, share: f64) -> Vec<Square> {
    let area = |half: usize| (2.0 * half as f64 + 1.0).powi(2);
    let half = |i: usize| (inner as f64 * (outer as f64 / inner.max(1) as f64).powf(i as f64 / STEPS as f64)).round();
    let halves: Vec<usize> = (0..=STEPS).map(|i| half(i) as usize).collect();
    // Light outside a distance falls as its square.
    let outside = |half: usize| 1.0 / area(half);
    let all = outside(inner) - outside(outer);
    let steps = halves.windows(2).filter(|pair| pair[0] < pair[1]);
    let brightness = |from, to| share * (outside(from) - outside(to)) / all / (area(to) - area(from));
    steps
        .flat_map(|pair| {
            let by = brightness(pair[0], pair[1]);
            [(pair[1], by), (pair[0], -by)]
        })
        .collect()
}

/// For each pixel the sum of the light in squares round it, each with its factor, by sums over rectangles from the
/// first pixel (Crow, Computer Graphics 18, 207, 1984).
fn summed(image: &Array2<f32>, mut squares: Vec<Square>) -> Array2<f32> {
    // The outer square of a step is the inner one of the next.
    squares.sort_by_key(|(half, _)| *half);
    squares.dedup_by(|next, kept| {
        let same = next.0 == kept.0;
        kept.1 += if same { next.1 } else { 0.0 };
        same
    });
    let pixels: Vec<f32> = image.iter().copied().collect();
    let out = Arch::new().dispatch(Sums { pixels: &pixels, cols: image.ncols(), squares: &squares });
    Array2::from_shape_vec(image.dim(), out).unwrap_or_else(|_| Array2::zeros(image.dim()))
}

/// The work of [`summed`], in code for this processor's vectors: it is done for each column of each fit.
struct Sums<'a> {
    /// Row by row.
    pixels: &'a [f32],
    cols: usize,
    /// From the smallest to the largest.
    squares: &'a [Square],
}

impl WithSimd for Sums<'_> {
    type Output = Vec<f32>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Vec<f32> {
        let cols = self.cols.max(1);
        let (rows, wide) = (self.pixels.len() / cols, cols + 1);
        let mut sums = vec![0.0f64; (rows + 1) * wide];
        for (r, pixels) in self.pixels.chunks_exact(cols).enumerate() {
            let (above, here) = sums[r * wide..].split_at_mut(wide);
            let mut row = 0.0;
            for ((sum, above), v) in here[1..].iter_mut().zip(&above[1..]).zip(pixels) {
                row += f64::from(*v);
                *sum = above + row;
            }
        }
        let mut out = vec![0.0f32; self.pixels.len()];
        let (mut band, mut sum) = (vec![0.0f64; wide], vec![0.0f64; cols]);
        for (r, out) in out.chunks_exact_mut(cols).enumerate() {
            sum.fill(0.0);
            for (half, factor) in self.squares {
                // The light of the rows of the square, left of each column.
                let line = |r: usize| &sums[r * wide..][..wide];
                let (below, above) = (line((r + half + 1).min(rows)), line(r.saturating_sub(*half)));
                for ((b, below), above) in band.iter_mut().zip(below).zip(above) {
                    *b = factor * (below - above);
                }
                // Right ends within the image, and beyond it.
                let (inside, beyond) = sum.split_at_mut(cols.saturating_sub(*half));
                for (s, right) in inside.iter_mut().zip(band.get(half + 1..).unwrap_or_default()) {
                    *s += right;
                }
                let whole = band[cols];
                beyond.iter_mut().for_each(|s| *s += whole);
                // Left ends: what lies before the image is dark.
                for (s, left) in sum[(*half).min(cols)..].iter_mut().zip(&band) {
                    *s -= left;
                }
            }
            out.iter_mut().zip(&sum).for_each(|(o, s)| *o = *s as f32);
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_is_spread_over_its_ring_and_no_light_is_lost() {
        let mut image = Array2::zeros((41, 43));
        image[[20, 21]] = 5.0;
        let out = spread(&image, 3, 6);
        for ((r, c), v) in out.indexed_iter() {
            let d = r.abs_diff(20).max(c.abs_diff(21));
            // Elsewhere factors that cancel leave what rounding leaves.
            assert_eq!(v.abs() > 1e-12, d > 3 && d <= 6, "{r} {c} {v}");
        }
        assert!((out.sum() - 5.0).abs() < 1e-4);
        // Squares of 7, 9, 11 and 13 px a side: from 4 px to 6 px the brightness falls nearly by (6 / 4)^4 = 5.06.
        let falls = f64::from(out[[20, 25]] / out[[20, 27]]);
        let expected = (1.0 / 49.0 - 1.0 / 81.0) / 32.0 / ((1.0 / 121.0 - 1.0 / 169.0) / 48.0);
        assert!((falls / expected - 1.0).abs() < 1e-3, "{falls} {expected}");
    }

    #[test]
    fn slopes_move_the_stated_light_over_the_sensor() {
        let (image, rings) = (Array2::from_elem((61, 61), 2.0f32), rings(4, 0.02));
        let light = stated(&image, &rings);
        // Far from the edges, where all of the light of the first ring arrives.
        assert!((f64::from(light[[30, 30]]) / 2.0 - 0.02).abs() < 2e-3, "{}", light[[30, 30]]);
        let by_radius = piece(&image, &rings, 5, &mut None).unwrap();
        assert!(by_radius[[30, 30]].abs() < 1e-9);
        assert!((by_radius[[0, 0]] / light[[0, 0]] - 0.5).abs() < 1e-5);
        let along_rows = piece(&image, &rings, 3, &mut None).unwrap();
        assert!((along_rows[[60, 7]] / light[[60, 7]] - 0.5).abs() < 1e-5);
        assert!(
            piece(&image, &rings, 6, &mut None).is_none()
                && piece(&image, &[], 0, &mut None).is_none()
                && values(&[]) == 0
        );
        assert_eq!(range(5), [-2.0, 2.0]);
    }

    #[test]
    fn a_ring_may_hold_the_light_of_the_slowest_law() {
        // Beyond h, 2 h, 4 h and 8 h, shares of the light by the cube (1, 1/2, 1/4, 1/8) of twice the most by the
        // fourth power (1, 1/4, 1/16, 1/64), which is root three times what is stated.
        let stated = rings(7, 1e-4);
        for (i, (.., share)) in stated.iter().enumerate() {
            let of_cube = 2.0 * 3f64.sqrt() * 1e-4 * (0.5f64.powi(i as i32) - 0.5f64.powi(i as i32 + 1));
            let [least, most] = range(i);
            assert!((most * share / of_cube - 1.5).abs() < 1e-9 && least == -1.0, "{i} {most}");
        }
    }

    #[test]
    fn the_rings_hold_the_light_outside_the_window() {
        let rings = rings(7, 1e-4);
        assert_eq!(rings.iter().map(|r| (r.0, r.1)).collect::<Vec<_>>(), [(7, 14), (14, 28), (28, 56)]);
        // All but what lies beyond eight times the half side.
        let sum: f64 = rings.iter().map(|r| r.2).sum();
        assert!((sum - 1e-4 * (1.0 - 1.0 / 64.0)).abs() < 1e-12);
        assert!(super::rings(7, 0.0).is_empty());
    }
}
