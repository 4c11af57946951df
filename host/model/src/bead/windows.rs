//! Cuts the windows round the chief rays: the samples that the low-rank model is fitted to.
//!
//! The model puts object pixel (r, c) of lens l at sensor pixel `corner_l + (r, c)`. A bead at a fractional object
//! position u is cut out round `corner_l + round(u)` and shifted by `round(u) - u` (band-limited interpolation), so
//! that every window shows a source at the centre of an object pixel, whatever the step of the scan. A bead at the
//! centre of an object pixel is not shifted. Distortion and the sub-pixel part of the anchors stay in the windows.

use super::{BeadError, BeadScan, Warning};
use crate::psf::shift::shifted;
use crate::psf::{BeadScale, ChiefRays, LensWindows};
use ndarray::{Array1, Array2, s};
use ommatidia_physics::noise::Source;
use ommatidia_session::{Cut, Manifest};

/// Margin round a window, px, for its shift by a fraction of a pixel.
const MARGIN: usize = 6;
/// Largest number of saturated pixels in one window that are masked; more are an overexposed bead.
const SATURATED_ALLOWED: usize = 2;
/// Shifts below this, px, are rounding errors of the positions in the table, and are ignored.
const SAME_PIXEL: f64 = 1e-3;
/// Least mean variance of a pixel, as a share of that without light: noise of few beads could make it negative.
const LEAST_VARIANCE: f64 = 0.5;

/// How bead windows are cut.
#[derive(Clone, Copy, Debug)]
pub struct BeadCut {
    /// Whether the brightness of the frames is kept.
    pub scale: BeadScale,
    /// Side of the central part of each window, px, that must lie on the sensor; otherwise a warning counts the window
    /// as truncated.
    pub nominal_px: usize,
}

/// Cuts the windows of all lenses out of a scan, reading each frame once. The windows have the side
/// `manifest.optics.psf_window_px`.
///
/// # Errors
/// A frame cannot be read, holds no light in any window, or is overexposed.
pub fn cut_windows(
    scan: &mut BeadScan,
    manifest: &Manifest,
    rays: &ChiefRays,
    BeadCut { scale, nominal_px }: BeadCut,
    step: &mut dyn FnMut(),
) -> Result<(Vec<LensWindows>, Vec<Warning>), BeadError> {
    let side = manifest.optics.psf_window_px;
    let (lenses, beads) = (manifest.array.lenses(), scan.beads.len());
    // Most of the memory of a calibration: one array a lens, never copied.
    let window = |_| LensWindows {
        light_dn: Array2::zeros((beads, side * side)),
        known: None,
        variance_dn2: Array1::zeros(side * side),
    };
    let mut windows: Vec<LensWindows> = (0..lenses).map(window).collect();
    let mut saturated = [0usize; 2];
    let (mut truncated, mut cuts, mut dark_dn2) = (0, 0, 0.0);
    for n in 0..beads {
        let (frame, cut) = scan.cut_light_dn(n)?;
        cuts += usize::from(cut.is_some());
        let (mut saturated_here, mut total) = (0, 0.0);
        for l in (0..lenses).filter(|l| !rays.dead[*l]) {
            let corner = corner(manifest, rays, l);
            let window = Window::cut((&frame, cut.as_ref()), (scan, n), corner, [side, nominal_px.min(side)]);
            if window.saturated > SATURATED_ALLOWED {
                let (path, frame) = (scan.path(n).into(), scan.beads[n].frame);
                let (allowed, found) = (SATURATED_ALLOWED, window.saturated);
                return Err(BeadError::Saturated { path, frame, lens: l, allowed, found });
            }
            saturated_here += window.saturated;
            total += window.total;
            truncated += usize::from(window.truncated);
            windows[l].light_dn.row_mut(n).assign(&window.light.flatten());
            if window.known.iter().any(|k| !k) {
                let all = || Array2::from_elem((beads, side * side), true);
                windows[l].known.get_or_insert_with(all).row_mut(n).assign(&window.known.flatten());
            }
        }
        saturated[0] += saturated_here;
        saturated[1] += usize::from(saturated_here > 0);
        dark_dn2 += to_scale(scan, n, (scale, total), &mut windows)?;
        step();
    }
    for variance in windows.iter_mut().flat_map(|w| &mut w.variance_dn2) {
        *variance = variance.max(LEAST_VARIANCE * dark_dn2);
    }
    let mut warnings = Vec::new();
    if saturated[0] > 0 {
        warnings.push(Warning::SaturatedPixels { pixels: saturated[0], frames: saturated[1] });
    }
    if truncated > 0 {
        warnings.push(Warning::Truncated { windows: truncated });
    }
    if cuts > 0 {
        warnings.push(Warning::CutOut { frames: cuts });
    }
    warnings.extend(dim_lenses(&windows, rays));
    if scan.noise().sources.gain == Source::Nominal {
        for window in &mut windows {
            let mean = window.variance_dn2.mean().unwrap_or(0.0);
            window.variance_dn2.fill(mean);
        }
    }
    Ok((windows, warnings))
}

/// Sensor pixel of object pixel (0, 0) through lens `l`.
pub(crate) fn corner(manifest: &Manifest, rays: &ChiefRays, l: usize) -> [isize; 2] {
    let size = [manifest.object.rows, manifest.object.cols];
    [0, 1].map(|a| (rays.anchors_px[l][a] - (size[a] as f64 - 1.0) / 2.0).round() as isize)
}

/// Scales the windows of frame `n` to the reference exposure, or to unit light for a normalised scan, and returns the
/// variance of a pixel without light, as a share of the mean over the scan, DN^2. `total` includes the light in the
/// margins: light that distortion moves out of a window still belongs to the bead.
fn to_scale(
    scan: &BeadScan,
    n: usize,
    (scale, total): (BeadScale, f64),
    windows: &mut [LensWindows],
) -> Result<f64, BeadError> {
    let noise = scan.noise();
    let px = windows.first().map_or(0, |w| w.light_dn.ncols());
    let side = (px as f64).sqrt() + 2.0 * MARGIN as f64;
    let sigma = noise.variance_dn2(noise.black_level_dn).sqrt() * side * (windows.len() as f64).sqrt();
    // Below three standard errors the frame cannot be distinguished from a dark one.
    if total <= 3.0 * sigma {
        return Err(BeadError::Dark { path: scan.path(n).into(), frame: scan.beads[n].frame, found: total, sigma });
    }
    let factor = match scale {
        BeadScale::Physical => scan.beads[n].to_reference,
        BeadScale::PerFrame => 1.0 / total,
    };
    let share = factor * factor / scan.beads.len() as f64;
    let dark_dn2 = noise.variance_dn2(noise.black_level_dn + scan.background_dn(n));
    for window in windows {
        for (v, variance) in window.light_dn.row_mut(n).into_iter().zip(&mut window.variance_dn2) {
            // Noise below the black level counts with its sign: cut off at zero it would make the mean too large.
            *variance += (dark_dn2 + noise.gain_dn_per_e * f64::from(*v)) * share;
            *v = (f64::from(*v) * factor) as f32;
        }
    }
    Ok(dark_dn2 * share)
}

fn dim_lenses(windows: &[LensWindows], rays: &ChiefRays) -> Vec<Warning> {
    let totals: Vec<f64> = windows.iter().map(|w| w.light_dn.iter().map(|v| f64::from(*v)).sum()).collect();
    let mut living: Vec<f64> = totals.iter().zip(&rays.dead).filter(|(_, d)| !**d).map(|(t, _)| *t).collect();
    living.sort_by(f64::total_cmp);
    let median = living.get(living.len() / 2).copied().unwrap_or(0.0);
    let dim = |(lens, total): (usize, &f64)| {
        let share = 100.0 * total / median;
        (!rays.dead[lens] && share < 30.0).then_some(Warning::DimLens { lens, share })
    };
    totals.iter().enumerate().filter_map(dim).collect()
}

/// One window.
struct Window {
    light: Array2<f32>,
    known: Array2<bool>,
    saturated: usize,
    truncated: bool,
    /// Light in the window and its margin, DN above black.
    total: f64,
}

impl Window {
    fn cut(
        (frame, cut): (&Array2<f32>, Option<&Cut>),
        (scan, n): (&BeadScan, usize),
        corner: [isize; 2],
        [side, nominal]: [usize; 2],
    ) -> Self {
        let bead = &scan.beads[n];
        let whole = bead.at_px.map(f64::round);
        let mut back = [whole[0] - bead.at_px[0], whole[1] - bead.at_px[1]];
        if back.iter().all(|d| d.abs() < SAME_PIXEL) {
            back = [0.0, 0.0];
        }
        let margin = MARGIN;
        let reach = (side / 2 + margin) as isize;
        let origin = [0, 1].map(|a| corner[a] + whole[a] as isize - reach);
        let big = side + 2 * margin;
        let pixel = |r: usize, c: usize| {
            let at = [origin[0] + r as isize, origin[1] + c as isize];
            (at[0] >= 0 && at[1] >= 0).then(|| [at[0] as usize, at[1] as usize])
        };
        let on_sensor = Array2::from_shape_fn((big, big), |(r, c)| pixel(r, c).filter(|at| frame.get(*at).is_some()));
        let measured = |at: &[usize; 2]| cut.is_none_or(|cut| cut.holds(at[0], at[1]));
        let raw = on_sensor.mapv(|at| at.filter(measured).map(|at| frame[at]));
        let inner = s![margin..margin + side, margin..margin + side];
        let saturated = raw.slice(inner).iter().flatten().filter(|v| !v.is_finite()).count();
        let (low, high) = ((big - nominal) / 2, (big + nominal) / 2);
        let truncated = on_sensor.slice(s![low..high, low..high]).iter().any(Option::is_none);
        let total = raw.iter().flatten().filter(|v| v.is_finite()).map(|v| f64::from(*v)).sum();
        let light = shifted(raw.mapv(|v| v.filter(|v| v.is_finite()).unwrap_or(0.0)).view(), back, 0);
        let broken = Array2::from_shape_fn((big, big), |at| match on_sensor[at] {
            Some(pixel) => !frame[pixel].is_finite() || !scan.useful(pixel),
            None => true,
        });
        // A shifted pixel depends on its neighbours: it is known where they are. The edge of a cropped frame is left
        // out of this: the crop holds the focus, and next to its edge there is little light.
        let blur = if back == [0.0, 0.0] { 0 } else { 2 };
        let known = Array2::from_shape_fn((side, side), |(r, c)| {
            let (r, c) = (r + margin, c + margin);
            raw[[r, c]].is_some() && !broken.slice(s![r - blur..=r + blur, c - blur..=c + blur]).iter().any(|b| *b)
        });
        Self { light: light.slice(inner).to_owned(), known, saturated, truncated, total }
    }
}
