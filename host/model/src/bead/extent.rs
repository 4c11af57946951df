//! The extent of the foci: the nominal window is widened until almost no light falls outside it.
//!
//! Square rings round all foci of a scan, summed, show tails far below the noise of a single frame. Light outside the
//! window would be missing from every prediction, as a halo.

use super::windows::corner;
use super::{BeadError, BeadScan};
use crate::psf::ChiefRays;
use ommatidia_session::Manifest;

/// Largest share of the light of a focus outside its window. Missing tails make predicted scenes too sharp: a share of
/// 2e-4 narrows them by about 0.001 px^2 along each axis, this share by a third of that.
const OUTSIDE: f64 = 5e-5;
/// Smallest significance, in standard errors, of light outside the window.
const SEEN: f64 = 2.0;
/// Largest growth of the half side, as a multiple of the nominal one.
const MOST_GROWTH: usize = 2;
/// Number of outermost rings that give the level of the background.
const LEVEL_RINGS: usize = 2;

/// How far from its chief ray the light of a focus may reach, px.
pub(super) fn reach(manifest: &Manifest) -> usize {
    MOST_GROWTH * (manifest.optics.psf_window_px / 2) + LEVEL_RINGS
}

/// Measures the light of square rings round the foci of a scan. Reads each frame once and calls `step` after each. None
/// where no ring fits between the nominal window and the foci of the neighbouring lenses.
///
/// # Errors
/// A frame cannot be read.
pub fn extent(
    scan: &mut BeadScan,
    manifest: &Manifest,
    rays: &ChiefRays,
    step: &mut dyn FnMut(),
) -> Result<Option<Extent>, BeadError> {
    let nominal = manifest.optics.psf_window_px / 2;
    let mut reach = reach(manifest);
    if manifest.array.lenses() > 1 {
        // Foci of the neighbouring lenses stay outside.
        reach = reach.min((manifest.array.pitch_px as usize).saturating_sub(nominal + 1));
    }
    if reach <= nominal + LEVEL_RINGS {
        return Ok(None);
    }
    let mut rings = Rings { sum: vec![0.0; reach + 1], count: vec![0.0; reach + 1] };
    for n in 0..scan.beads.len() {
        let (mut frame, cut) = scan.cut_light_dn(n)?;
        if let Some(cut) = cut {
            frame.indexed_iter_mut().filter(|((r, c), _)| !cut.holds(*r, *c)).for_each(|(_, v)| *v = f32::NAN);
        }
        let at = scan.beads[n].at_px.map(|v| v.round() as isize);
        for l in (0..rays.anchors_px.len()).filter(|l| !rays.dead[*l]) {
            let corner = corner(manifest, rays, l);
            rings.add(&frame, [corner[0] + at[0], corner[1] + at[1]]);
        }
        step();
    }
    let noise = scan.noise();
    Ok(Some(Extent { rings, nominal, dark_dn2: noise.variance_dn2(noise.black_level_dn) }))
}

/// How far the light of the foci reaches.
pub struct Extent {
    rings: Rings,
    /// Half side of the nominal window, px.
    nominal: usize,
    /// Variance of a dark pixel, DN^2.
    dark_dn2: f64,
}

impl Extent {
    /// Side of the smallest window, px, odd and at least the nominal one, that holds the foci.
    pub fn side_px(&self) -> usize {
        2 * self.rings.half(self.nominal, self.dark_dn2) + 1
    }

    /// Standard uncertainty of the light of a focus outside a window of `side` pixels, as a share of its light inside.
    /// `has_level`: the frames still have a background.
    ///
    /// No window holds what lies outside, and its law is not known. The edge of a round pupil throws light whose
    /// brightness falls as the cube of the distance (the Airy pattern; Goodman, Introduction to Fourier Optics, 4.4.2),
    /// a pupil with soft edges throws less. For the fourth power all rings outside hold `L (h + 1) / 2`, where `L` is
    /// the light of the first of them and `h` the half side of the window. Anything from nothing to that counts as
    /// equally likely, so the standard uncertainty is that over the root of three (JCGM 100:2008, 4.3.7).
    pub fn outside(&self, side: usize, has_level: bool) -> f64 {
        let (half, last) = (side / 2, self.rings.sum.len() - LEVEL_RINGS);
        let level = if has_level { self.rings.level() } else { 0.0 };
        let first = (half + 1).min(self.rings.sum.len() - 1);
        let total: f64 = (0..=half.min(last)).map(|r| self.rings.light(r, level)).sum();
        let sigma = self.rings.variance(first, self.dark_dn2).sqrt();
        let light = self.rings.light(first, level).max(0.0).hypot(sigma);
        if total > 0.0 { light / total * (half + 1) as f64 / 2.0 / 3f64.sqrt() } else { 0.0 }
    }
}

/// Light of square rings round all foci.
struct Rings {
    sum: Vec<f64>,
    count: Vec<f64>,
}

impl Rings {
    fn add(&mut self, frame: &ndarray::Array2<f32>, centre: [isize; 2]) {
        let reach = self.sum.len() as isize - 1;
        for r in -reach..=reach {
            for c in -reach..=reach {
                let at = [centre[0] + r, centre[1] + c];
                if at[0] < 0 || at[1] < 0 {
                    continue;
                }
                if let Some(v) = frame.get([at[0] as usize, at[1] as usize]).filter(|v| v.is_finite()) {
                    let ring = r.abs().max(c.abs()) as usize;
                    self.sum[ring] += f64::from(*v);
                    self.count[ring] += 1.0;
                }
            }
        }
    }

    /// Brightness of the outermost rings, DN a pixel.
    fn level(&self) -> f64 {
        let last = self.sum.len() - LEVEL_RINGS;
        let [sum, count] = [&self.sum, &self.count].map(|v| v[last..].iter().sum::<f64>());
        sum / f64::max(count, 1.0)
    }

    /// Light of ring `r` of one focus above a level, DN; 0 for a ring that no frame shows.
    fn light(&self, r: usize, level: f64) -> f64 {
        if self.count[r] > 0.0 { (self.sum[r] / self.count[r] - level) * pixels(r) } else { 0.0 }
    }

    /// Its variance by the noise of dark pixels, DN^2.
    fn variance(&self, r: usize, dark_dn2: f64) -> f64 {
        if self.count[r] > 0.0 { pixels(r) * pixels(r) * dark_dn2 / self.count[r] } else { 0.0 }
    }

    /// The smallest half side, `least` or more, outside of which lies at most [`OUTSIDE`] of the light or no
    /// significant light.
    fn half(&self, least: usize, dark_dn2: f64) -> usize {
        let last = self.sum.len() - LEVEL_RINGS;
        let level = self.level();
        let total: f64 = (0..last).map(|r| self.light(r, level)).sum();
        let outside = |half: usize| (half + 1..last).map(|r| self.light(r, level)).sum::<f64>();
        let holds = |half: &usize| {
            let sigma = (half + 1..last).map(|r| self.variance(r, dark_dn2)).sum::<f64>().sqrt();
            outside(*half) <= (OUTSIDE * total).max(SEEN * sigma)
        };
        (least..last - 1).find(holds).unwrap_or(last - 1)
    }
}

/// Pixels of a square ring.
fn pixels(r: usize) -> f64 {
    if r == 0 { 1.0 } else { 8.0 * r as f64 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array2;

    fn half(tail: f64, level: f32) -> usize {
        let frame = Array2::from_shape_fn((81, 81), |(r, c)| {
            let d = (r as f64 - 40.0).hypot(c as f64 - 40.0);
            level + 1000.0 * ((-d * d / 6.0).exp() + tail * (-d / 1.5).exp()) as f32
        });
        let mut rings = Rings { sum: vec![0.0; 17], count: vec![0.0; 17] };
        (0..50).for_each(|_| rings.add(&frame, [40, 40]));
        rings.half(7, 0.7)
    }

    #[test]
    fn windows_grow_with_the_tails_of_foci_and_not_with_the_background() {
        assert_eq!(half(0.0, 0.0), 7);
        assert_eq!(half(0.0, 30.0), 7);
        let (some, more) = (half(0.3, 0.0), half(3.0, 0.0));
        assert!(some > 7 && more > some && more <= 14, "{some} {more}");
        assert_eq!(half(0.3, 30.0), some);
    }

    #[test]
    fn light_outside_a_window_is_of_the_size_of_tails() {
        // Brightness b d^-4 outside the core, which holds nearly all of the light, 10,000.
        let of = |b: f64, level: f32| {
            let frame = Array2::from_shape_fn((121, 121), |(r, c)| {
                let d = (r as f64 - 60.0).abs().max((c as f64 - 60.0).abs());
                level + if d == 0.0 { 1e4 } else { (b * d.powi(-4)) as f32 }
            });
            let mut rings = Rings { sum: vec![0.0; 21], count: vec![0.0; 21] };
            (0..50).for_each(|_| rings.add(&frame, [60, 60]));
            Extent { rings, nominal: 7, dark_dn2: 1e-6 }
        };
        let outside = |b: f64| (8..1000).map(|r| pixels(r) * b * (r as f64).powi(-4)).sum::<f64>() / 1e4;
        let found = of(50.0, 0.0).outside(15, false);
        let expected = outside(50.0) / 3f64.sqrt();
        assert!((found / expected - 1.0).abs() < 0.2, "{found} {expected}");
        // A level is no tail. What is taken out with it is less than the first ring holds.
        assert!((of(50.0, 30.0).outside(15, true) / found - 1.0).abs() < 0.1);
        // Without tails the noise of the ring is left: 64 pixels in each of 50 foci, 1e-3 DN each.
        let noise = 64.0 * 1e-3 / (50.0f64 * 64.0).sqrt() / 1e4 * 4.0 / 3f64.sqrt();
        assert!((of(0.0, 0.0).outside(15, false) / noise - 1.0).abs() < 1e-6);
    }
}
