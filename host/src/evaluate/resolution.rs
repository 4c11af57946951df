//! Resolution from bar targets: the finest line pair that a method resolves, by position in the field.

use crate::scene::resolution::{Group, PERIODS_PX, groups, target};
use crate::session::ObjectGrid;
use ndarray::{Array2, ArrayView2, Axis};
use serde::{Deserialize, Serialize};

/// Bars are resolved if each gap between them is darker than this fraction of both its neighbours (Rayleigh's criterion
/// for slits).
const RAYLEIGH: f64 = 0.81;

/// Reading of one group of bars.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Reading {
    /// Position in the field, such as `centre`.
    pub place: String,
    /// Axis across the bars: `rows` or `cols`.
    pub along: String,
    /// Period of the bars (one line pair), object pixels.
    pub period_px: f64,
    /// Contrast, (bars - gaps) / (bars + gaps).
    pub contrast: f64,
    /// Whether all bars are resolved.
    pub resolved: bool,
    /// Profile across the group: mean over the middle half of the bars' length, divided by its maximum; one value a
    /// pixel, from two pixels before the first bar.
    pub profile: Vec<f64>,
}

/// The resolution of one method.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Resolution {
    /// Name of the method.
    pub name: String,
    /// Depth of the targets, um.
    #[serde(default)]
    pub z_um: f64,
    /// Finest line pair that is resolved along both axes at the centre of the field, um; None: no line pair is
    /// resolved.
    pub centre_um: Option<f64>,
    /// Finest line pair that is resolved along both axes at every edge of the field, um.
    pub edges_um: Option<f64>,
    /// Readings of every group of bars.
    pub readings: Vec<Reading>,
}

/// Factor by which resolution may be coarser than in focus within the depth range.
const KEPT: f64 = 1.25;

/// Range of depths over which a method keeps its resolution.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DepthRange {
    /// Name of the method.
    pub name: String,
    /// Lowest and highest depth of the range, um; None: no bars are resolved in focus.
    pub range_um: Option<[f64; 2]>,
}

/// The depth range of the method `name` from its resolutions `found` at several depths, in any order.
///
/// The range contains the measured depth nearest to 0 um. It extends as far as the finest line pairs at centre and
/// edges are at most a quarter coarser than at that depth.
pub fn depth_range(name: &str, found: &[&Resolution]) -> DepthRange {
    let mut found = found.to_vec();
    found.sort_by(|a, b| a.z_um.total_cmp(&b.z_um));
    let focus = (0..found.len()).min_by(|a, b| found[*a].z_um.abs().total_cmp(&found[*b].z_um.abs()));
    let range = focus.and_then(|focus| {
        let (centre, edges) = (found[focus].centre_um?, found[focus].edges_um?);
        let holds = |r: &&&Resolution| {
            r.centre_um.is_some_and(|um| um <= KEPT * centre) && r.edges_um.is_some_and(|um| um <= KEPT * edges)
        };
        let low = found[..=focus].iter().rev().take_while(holds).last()?;
        let high = found[focus..].iter().take_while(holds).last()?;
        Some([low.z_um, high.z_um])
    });
    DepthRange { name: name.into(), range_um: range }
}

/// Number of frames of a target session with this grid at each depth.
pub fn frames(grid: &ObjectGrid) -> usize {
    PERIODS_PX.iter().filter(|p| !groups(grid, **p).is_empty()).count()
}

/// Whether a truth, in any unit, is the target of frame `i`.
pub fn is_target(grid: &ObjectGrid, i: usize, truth: ArrayView2<'_, f32>) -> bool {
    let Some(&period) = PERIODS_PX.get(i) else {
        return false;
    };
    let wanted = target(grid, period);
    let peak = truth.iter().copied().fold(0.0, f32::max) / wanted.iter().copied().fold(f32::MIN_POSITIVE, f32::max);
    peak > 0.0 && truth.iter().zip(&wanted).all(|(t, w)| (t / peak - w).abs() < 1e-3)
}

/// Reads the groups of bars with this period, object pixels, in one reconstructed target, [object rows, object cols].
pub fn read(grid: &ObjectGrid, period: f64, image: ArrayView2<'_, f32>) -> Vec<Reading> {
    groups(grid, period).iter().map(|g| reading(g, image)).collect()
}

fn reading(g: &Group, image: ArrayView2<'_, f32>) -> Reading {
    // The rows of `image` become the axis across the bars.
    let image = if g.axis == 0 { image } else { image.reversed_axes() };
    let (from, across) = (g.start[g.axis], g.start[1 - g.axis]);
    let middle = (across + g.length / 4.0).floor() as usize..(across + 0.75 * g.length).ceil() as usize;
    let (first, last) = ((from - 2.0).max(0.0) as usize, ((from + 2.5 * g.period + 2.0) as usize).min(image.nrows()));
    let part: Array2<f64> = image.slice(ndarray::s![first..last, middle]).mapv(f64::from);
    let profile = part.mean_axis(Axis(1)).unwrap_or_default().to_vec();
    // Pixel i has its centre at position i + 1/2.
    let at = |position: f64| {
        let x = (position - first as f64 - 0.5).max(0.0);
        let (low, rest) = (x.floor() as usize, x.fract());
        let value = |i: usize| profile.get(i).copied().unwrap_or(0.0);
        value(low) * (1.0 - rest) + value(low + 1) * rest
    };
    let bars = [0.25, 1.25, 2.25].map(|k| at(from + k * g.period));
    let gaps = [0.75, 1.75].map(|k| at(from + k * g.period));
    let (bright, dark) = (bars.iter().sum::<f64>() / 3.0, gaps.iter().sum::<f64>() / 2.0);
    let contrast = if bright + dark > 0.0 { (bright - dark) / (bright + dark) } else { 0.0 };
    let resolved = (0..2).all(|i| gaps[i] < RAYLEIGH * bars[i].min(bars[i + 1]));
    let peak = profile.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    Reading {
        place: g.place.into(),
        along: ["rows", "cols"][g.axis].into(),
        period_px: g.period,
        contrast,
        resolved,
        profile: profile.into_iter().map(|v| v / peak).collect(),
    }
}

/// The resolution of the method `name` at one depth from all its readings there.
pub fn summarise(name: &str, z_um: f64, grid: &ObjectGrid, readings: Vec<Reading>) -> Resolution {
    let finest = |wanted: &dyn Fn(&str) -> bool| {
        let mut finest = None;
        for period in PERIODS_PX.into_iter().rev() {
            let mut of = readings.iter().filter(|r| r.period_px == period && wanted(&r.place)).peekable();
            if of.peek().is_none() {
                continue;
            }
            // A finer pair does not count if a coarser one is not resolved: it would be aliasing.
            if !of.all(|r| r.resolved) {
                break;
            }
            finest = Some(period * grid.pixel_um);
        }
        finest
    };
    let (centre_um, edges_um) = (finest(&|p| p == "centre"), finest(&|p| p != "centre"));
    Resolution { name: name.into(), z_um, centre_um, edges_um, readings }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    const GRID: ObjectGrid = ObjectGrid { rows: 96, cols: 80, pixel_um: 2.0 };

    /// The image blurred with a Gaussian of this standard deviation, pixels.
    fn blurred(image: &Array2<f32>, sigma: f64) -> Array2<f32> {
        let kernel = |d: f64| (-0.5 * (d / sigma).powi(2)).exp();
        let pass = |image: &Array2<f32>| {
            Array2::from_shape_fn((image.ncols(), image.nrows()), |(c, r)| {
                let sum: f64 = (0..image.nrows()).map(|i| f64::from(image[[i, c]]) * kernel(i as f64 - r as f64)).sum();
                (sum / (sigma * std::f64::consts::TAU.sqrt())) as f32
            })
        };
        pass(&pass(image))
    }

    #[test]
    fn a_target_is_resolved_as_it_is() {
        let all = PERIODS_PX.iter().flat_map(|&p| read(&GRID, p, target(&GRID, p).view())).collect();
        let found = summarise("truth", 0.0, &GRID, all);
        assert_eq!((found.centre_um, found.edges_um), (Some(4.0), Some(4.0)));
        assert!(found.readings.iter().filter(|r| r.period_px == 4.0).all(|r| r.contrast > 0.99));
    }

    /// A Gaussian reduces the contrast of a sine of period p to `exp(-2 (pi sigma / p)^2)`; the first harmonic of a
    /// square wave has contrast 4/pi.
    #[test]
    fn blur_reduces_contrast_as_its_transfer_function() {
        let image = blurred(&target(&GRID, 6.0), 1.2);
        let expected = 4.0 / std::f64::consts::PI * (-2.0 * (std::f64::consts::PI * 1.2 / 6.0).powi(2)).exp();
        for r in read(&GRID, 6.0, image.view()) {
            // Three bars are not an infinite grating, so the contrast agrees to 0.1 only.
            assert!((r.contrast - expected).abs() < 0.1, "{} {expected}", r.contrast);
        }
        let coarse = |sigma| {
            let one = |&p: &f64| read(&GRID, p, blurred(&target(&GRID, p), sigma).view());
            summarise("", 0.0, &GRID, PERIODS_PX.iter().flat_map(one).collect()).centre_um.unwrap()
        };
        assert!(coarse(0.5) < coarse(0.9) && coarse(0.9) < coarse(1.3));
    }

    #[test]
    fn the_depth_range_ends_where_bars_are_lost_and_does_not_begin_again() {
        let at = |z_um, centre_um, edges_um| Resolution { z_um, centre_um, edges_um, ..Resolution::default() };
        let mut found = vec![
            at(40.0, Some(8.0), Some(8.0)),
            at(20.0, None, Some(8.0)),
            at(1.0, Some(8.0), Some(10.0)),
            at(-20.0, Some(10.0), Some(12.0)),
            at(-40.0, Some(8.0), Some(13.0)),
        ];
        let range = |found: &[Resolution]| depth_range("", &found.iter().collect::<Vec<_>>()).range_um;
        assert_eq!(range(&found), Some([-20.0, 1.0]));
        found[2].edges_um = None;
        assert_eq!(range(&found), None);
        assert_eq!(range(&[]), None);
    }

    #[test]
    fn a_target_is_known_from_its_frame() {
        assert!(is_target(&GRID, 2, (target(&GRID, 3.0) * 7.0).view()));
        assert!(!is_target(&GRID, 1, target(&GRID, 3.0).view()));
        assert!(!is_target(&GRID, 9, target(&GRID, 3.0).view()));
        assert_eq!(frames(&GRID), 7);
    }
}
