//! Fit of the chief rays (Eq. 1 of the paper): one anchor for each lens and one magnification, from the centroids of
//! all foci.
//!
//! The frames are shifted back by their stage positions and summed: all foci of a lens then coincide nearly, while
//! everything else is smeared. The best position of the whole nominal array in this sum, then of each lens near it,
//! starts the fit. A robust linear regression of all centroids (Huber weights; *Robust Statistics*, 1981) gives the
//! result.

use super::centroids::{Centroid, Patches};
use super::{BeadError, BeadScan, Warning};
use crate::psf::ChiefRays;
use ndarray::{Array2, ArrayView2, s};
use ommatidia_physics::linalg::least_squares;
use ommatidia_session::Manifest;

/// Smallest contrast of a focus in the summed frames, robust standard deviations.
const FOCUS_CONTRAST: f64 = 8.0;
/// Smallest span of the stage positions, nominal sensor pixels, from which the magnification is fitted.
const LEAST_SPAN_PX: f64 = 1.0;
/// Iterations of centroids and regression.
const ROUNDS: usize = 3;

/// Fitted chief rays.
#[derive(Clone, Debug)]
pub struct RayFit {
    /// The chief rays.
    pub rays: ChiefRays,
    /// Root-mean-square distance of the centroids from the fit, over both axes, px: distortion and noise.
    pub rms_px: f64,
    /// The dead lenses.
    pub warnings: Vec<Warning>,
}

/// Fits the chief rays of all lenses; calls `step` once for each frame that is read.
///
/// # Errors
/// A frame cannot be read, no lens shows a focus, or the magnification is far from the nominal one.
pub fn fit_chief_rays(scan: &mut BeadScan, manifest: &Manifest, step: &mut dyn FnMut()) -> Result<RayFit, BeadError> {
    let mut sum = Array2::zeros((manifest.sensor.rows, manifest.sensor.cols));
    for n in 0..scan.beads.len() {
        let frame = scan.light_dn(n)?;
        add_moved(&mut sum, &frame, displacement(manifest, scan.beads[n].at_px));
        step();
    }
    let start = first_anchors(&sum, manifest);
    let dead: Vec<bool> = start.iter().map(|(_, contrast)| *contrast < FOCUS_CONTRAST).collect();
    if dead.iter().all(|d| *d) {
        let found = start.iter().fold(0.0f64, |m, (_, c)| m.max(*c));
        let (path, lenses) = (scan.path(0).into(), dead.len());
        return Err(BeadError::NoFocus { path, lenses, expected: FOCUS_CONTRAST, found });
    }
    let anchors = start.iter().map(|(a, _)| *a).collect();
    let mut fit = Fit { anchors, slope: 1.0, rms_px: 0.0 };
    let mut patches = Patches::new(scan.beads.len(), &dead);
    for round in 0..ROUNDS {
        let radius = (manifest.optics.psf_window_px / 2) as isize + if round == 0 { 2 } else { 0 };
        let mut frames: Vec<Vec<Centroid>> = Vec::new();
        for n in 0..scan.beads.len() {
            let displacement = displacement(manifest, scan.beads[n].at_px);
            let at = |anchor: &[f64; 2]| [0, 1].map(|i| anchor[i] + fit.slope * displacement[i]);
            let expected: Vec<[f64; 2]> = fit.anchors.iter().map(at).collect();
            frames.push(patches.centroids(scan, n, (&expected, displacement), radius)?);
            if round == 0 {
                step();
            }
        }
        fit = regress(&frames, fit, &dead, (scan, manifest))?;
    }
    let nominal = manifest.optics.magnification;
    let magnification = nominal * fit.slope;
    if (fit.slope - 1.0).abs() > 0.05 {
        return Err(BeadError::Magnification { path: scan.path(0).into(), expected: nominal, found: magnification });
    }
    let lenses: Vec<usize> = (0..dead.len()).filter(|l| dead[*l]).collect();
    let warnings = if lenses.is_empty() { Vec::new() } else { vec![Warning::DeadLenses { lenses }] };
    Ok(RayFit { rays: ChiefRays { anchors_px: fit.anchors, magnification, dead }, rms_px: fit.rms_px, warnings })
}

/// Number of times that a calibration reads each bead frame, for progress bars.
pub(crate) const PASSES: u64 = 6;

struct Fit {
    anchors: Vec<[f64; 2]>,
    slope: f64,
    rms_px: f64,
}

/// Displacement on the sensor of a bead at an object pixel, by the nominal magnification.
pub(super) fn displacement(m: &Manifest, at_px: [f64; 2]) -> [f64; 2] {
    let scale = m.object.pixel_um * m.optics.magnification / m.sensor.pixel_pitch_um;
    [(at_px[0] - (m.object.rows as f64 - 1.0) / 2.0) * scale, (at_px[1] - (m.object.cols as f64 - 1.0) / 2.0) * scale]
}

/// Adds a frame shifted back by whole pixels; saturated pixels (NaN) add nothing.
fn add_moved(sum: &mut Array2<f32>, frame: &Array2<f32>, by: [f64; 2]) {
    let by = by.map(|d| d.round() as isize);
    let span = |n: usize, d: isize| {
        let (low, high) = ((-d).max(0), (n as isize - d).min(n as isize));
        (low < high).then_some(low..high)
    };
    let (rows, cols) = sum.dim();
    let (Some(r), Some(c)) = (span(rows, by[0]), span(cols, by[1])) else {
        return;
    };
    let from = frame.slice(s![r.start + by[0]..r.end + by[0], c.start + by[1]..c.end + by[1]]);
    sum.slice_mut(s![r, c]).zip_mut_with(&from, |t, v| *t += if v.is_finite() { *v } else { 0.0 });
}

/// Position of each lens's focus in the summed frames, and its contrast.
fn first_anchors(sum: &Array2<f32>, m: &Manifest) -> Vec<([f64; 2], f64)> {
    let smooth = box_blur(sum, 1);
    let (level, spread) = level_and_spread(smooth.view());
    let reach = if m.array.lenses() == 1 { f64::INFINITY } else { 0.45 * m.array.pitch_px };
    let centre = [(m.sensor.rows as f64 - 1.0) / 2.0, (m.sensor.cols as f64 - 1.0) / 2.0];
    let nominal: Vec<[f64; 2]> =
        m.array.places_px(&m.sensor).iter().map(|p| [p[0] - centre[0], p[1] - centre[1]]).collect();
    let offset = best_offset(&smooth, &nominal, centre, reach, level + 3.0 * spread);
    nominal
        .iter()
        .map(|n| {
            let at = [centre[0] + offset[0] + n[0], centre[1] + offset[1] + n[1]];
            let radius = if reach.is_finite() { (m.array.pitch_px / 4.0).max(2.0) } else { 2.0 };
            let (peak, value) = peak_near(&smooth, at, radius);
            (peak, (value - level) / spread)
        })
        .collect()
}

/// The whole-pixel offset of the array at which all its foci together are brightest. Each focus counts by the root of
/// its light above the surroundings, so that one bright lens does not outvote the others.
fn best_offset(smooth: &Array2<f32>, nominal: &[[f64; 2]], centre: [f64; 2], reach: f64, floor: f64) -> [f64; 2] {
    let limit = [0, 1].map(|a| reach.min(centre[a]) as isize);
    let score = |dr: isize, dc: isize| {
        let light = nominal.iter().map(|n| {
            let at = [centre[0] + n[0] + dr as f64, centre[1] + n[1] + dc as f64].map(|v| v.round() as isize);
            let inside = at[0] >= 0 && at[1] >= 0;
            let value = if inside { smooth.get([at[0] as usize, at[1] as usize]).copied().unwrap_or(0.0) } else { 0.0 };
            (f64::from(value) - floor).max(0.0).sqrt()
        });
        light.sum::<f64>()
    };
    let mut best = (f64::NEG_INFINITY, [0, 0]);
    for dr in -limit[0]..=limit[0] {
        for dc in -limit[1]..=limit[1] {
            let value = score(dr, dc);
            // Ties go to the smaller offset.
            let nearer = dr * dr + dc * dc < best.1[0] * best.1[0] + best.1[1] * best.1[1];
            if value > best.0 || (value == best.0 && nearer) {
                best = (value, [dr, dc]);
            }
        }
    }
    best.1.map(|v| v as f64)
}

/// Brightest pixel within `radius` of a position, and its value.
fn peak_near(image: &Array2<f32>, at: [f64; 2], radius: f64) -> ([f64; 2], f64) {
    let mut best = (at, f64::NEG_INFINITY);
    let span = |a: usize, n: usize| {
        ((at[a] - radius).ceil().max(0.0) as usize)
            ..((at[a] + radius).floor().max(-1.0) as isize + 1).clamp(0, n as isize) as usize
    };
    for r in span(0, image.nrows()) {
        for c in span(1, image.ncols()) {
            if f64::from(image[[r, c]]) > best.1 {
                best = ([r as f64, c as f64], f64::from(image[[r, c]]));
            }
        }
    }
    best
}

/// Median, and 1.4826 times the median absolute deviation (the standard deviation of a normal distribution).
fn level_and_spread(image: ArrayView2<'_, f32>) -> (f64, f64) {
    let mut values: Vec<f32> = image.iter().copied().collect();
    let median = |values: &mut Vec<f32>| {
        let middle = values.len() / 2;
        f64::from(*values.select_nth_unstable_by(middle, f32::total_cmp).1)
    };
    let level = median(&mut values);
    values.iter_mut().for_each(|v| *v = (*v - level as f32).abs());
    let spread = 1.4826 * median(&mut values);
    // A background of exact zeros has no spread: a thousandth of the peak then makes a focus.
    let top = image.iter().fold(0.0f32, |m, v| m.max(*v));
    (level, spread.max(1e-3 * (f64::from(top) - level)).max(f64::MIN_POSITIVE))
}

fn box_blur(image: &Array2<f32>, radius: usize) -> Array2<f32> {
    let (rows, cols) = image.dim();
    Array2::from_shape_fn((rows, cols), |(r, c)| {
        let part = image.slice(s![
            r.saturating_sub(radius)..(r + radius + 1).min(rows),
            c.saturating_sub(radius)..(c + radius + 1).min(cols)
        ]);
        part.sum() / part.len() as f32
    })
}

/// Huber regression of all centroids on an anchor a lens and one slope.
fn regress(
    frames: &[Vec<Centroid>],
    before: Fit,
    dead: &[bool],
    (scan, m): (&mut BeadScan, &Manifest),
) -> Result<Fit, BeadError> {
    let all: Vec<&Centroid> = frames.iter().flatten().collect();
    if all.is_empty() {
        return Err(no_centroid(scan, &before, dead.len(), m)?);
    }
    let lenses = before.anchors.len();
    // Beads in one place (a scan of depth alone) say nothing about the magnification: it stays what the manifest says.
    let moved = span(all.iter().flat_map(|c| c.displacement)) >= LEAST_SPAN_PX;
    let mut anchors = before.anchors;
    let (mut slope, mut rms_px, mut weights) = (before.slope, 0.0, vec![1.0; 2 * all.len()]);
    for _ in 0..6 {
        // Columns: row anchors, column anchors, slope over the nominal one.
        let mut a = Array2::<f64>::zeros((2 * all.len(), 2 * lenses + 1));
        let mut b = Array2::<f64>::zeros((2 * all.len(), 1));
        for (i, centroid) in all.iter().enumerate() {
            for axis in 0..2 {
                let (row, w) = (2 * i + axis, weights[2 * i + axis]);
                a[[row, axis * lenses + centroid.lens]] = w;
                a[[row, 2 * lenses]] = if moved { w * centroid.displacement[axis] } else { 0.0 };
                b[[row, 0]] = w * (centroid.at[axis] - centroid.displacement[axis]);
            }
        }
        let Ok(x) = least_squares(&a, &b) else { break };
        slope = 1.0 + x[[2 * lenses, 0]];
        for l in (0..lenses).filter(|l| all.iter().any(|c| c.lens == *l)) {
            anchors[l] = [x[[l, 0]], x[[lenses + l, 0]]];
        }
        let misfit: Vec<f64> = (0..2 * all.len())
            .map(|row| {
                let (c, axis) = (all[row / 2], row % 2);
                c.at[axis] - anchors[c.lens][axis] - slope * c.displacement[axis]
            })
            .collect();
        rms_px = (misfit.iter().map(|v| v * v).sum::<f64>() / misfit.len() as f64).sqrt();
        let scale = 1.5 * 1.4826 * median_abs(&misfit).max(1e-6);
        // The root, since rows and right-hand sides are both weighted.
        weights.iter_mut().zip(&misfit).for_each(|(w, v)| *w = (scale / v.abs().max(scale)).sqrt());
    }
    Ok(Fit { anchors, slope, rms_px })
}

/// The reason why no focus of a scan has a centroid: an overexposed frame, or no light.
fn no_centroid(scan: &mut BeadScan, fit: &Fit, lenses: usize, m: &Manifest) -> Result<BeadError, BeadError> {
    let half = (m.optics.psf_window_px / 2) as isize;
    for n in 0..scan.beads.len() {
        let frame = scan.light_dn(n)?;
        let displacement = displacement(m, scan.beads[n].at_px);
        for (lens, anchor) in fit.anchors.iter().enumerate() {
            let low = [0, 1].map(|i| (anchor[i] + fit.slope * displacement[i]).round() as isize - half);
            let inside = |v: isize, n: usize| v.clamp(0, n as isize) as usize;
            let span = |a: usize| inside(low[a], frame.shape()[a])..inside(low[a] + 2 * half + 1, frame.shape()[a]);
            let found = frame.slice(s![span(0), span(1)]).iter().filter(|v| !v.is_finite()).count();
            if found > 0 {
                let (path, frame) = (scan.path(n).into(), scan.beads[n].frame);
                return Ok(BeadError::Saturated { path, frame, lens, allowed: 0, found });
            }
        }
    }
    Ok(BeadError::NoFocus { path: scan.path(0).into(), lenses, expected: FOCUS_CONTRAST, found: 0.0 })
}

fn span(values: impl Iterator<Item = f64>) -> f64 {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
    high - low
}

fn median_abs(values: &[f64]) -> f64 {
    let mut sorted: Vec<f64> = values.iter().map(|v| v.abs()).collect();
    let middle = sorted.len() / 2;
    if sorted.is_empty() { 0.0 } else { *sorted.select_nth_unstable_by(middle, f64::total_cmp).1 }
}
