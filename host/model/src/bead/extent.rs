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

/// Side of the smallest window, px, odd and at least the nominal one, that holds the foci of a scan. Reads each frame
/// once and calls `step` after each.
///
/// # Errors
/// A frame cannot be read.
pub fn extent(
    scan: &mut BeadScan,
    manifest: &Manifest,
    rays: &ChiefRays,
    mut step: impl FnMut(),
) -> Result<usize, BeadError> {
    let nominal = manifest.optics.psf_window_px / 2;
    let mut reach = reach(manifest);
    if manifest.array.lenses() > 1 {
        // Foci of the neighbouring lenses stay outside.
        reach = reach.min((manifest.array.pitch_px as usize).saturating_sub(nominal + 1));
    }
    if reach <= nominal + LEVEL_RINGS {
        return Ok(manifest.optics.psf_window_px);
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
    Ok(2 * rings.half(nominal, noise.variance_dn2(noise.black_level_dn)) + 1)
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

    /// The smallest half side, `least` or more, outside of which lies at most [`OUTSIDE`] of the light or no
    /// significant light.
    fn half(&self, least: usize, dark_dn2: f64) -> usize {
        let last = self.sum.len() - LEVEL_RINGS;
        let [sum, count] = [&self.sum, &self.count].map(|v| v[last..].iter().sum::<f64>());
        let level = sum / f64::max(count, 1.0);
        let pixels = |r: usize| if r == 0 { 1.0 } else { 8.0 * r as f64 };
        let seen = |r: &usize| self.count[*r] > 0.0;
        let light = |r: usize| (self.sum[r] / self.count[r] - level) * pixels(r);
        let variance = |r: usize| pixels(r) * pixels(r) * dark_dn2 / self.count[r];
        let total: f64 = (0..last).filter(seen).map(light).sum();
        let outside = |half: usize| (half + 1..last).filter(seen).map(light).sum::<f64>();
        let holds = |half: &usize| {
            let sigma = (half + 1..last).filter(seen).map(variance).sum::<f64>().sqrt();
            outside(*half) <= (OUTSIDE * total).max(SEEN * sigma)
        };
        (least..last - 1).find(holds).unwrap_or(last - 1)
    }
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
}
