//! Shifted array: every chief ray is displaced by the same amount.
//!
//! `anchor_l -> anchor_l + (row_px, col_px)`.

use super::context::{FrameContext, Ray, RayShift};
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use super::evidence::{Evidence, EvidenceFrame};
use super::smooth::gaussian_blur;
use crate::fft2::{RealFft2, fast_size};
use ndarray::{Array2, s};
use ommatidia_session::Role;
use rustfft::num_complex::Complex32;

/// The effect; its formula is in the documentation of the module.
pub(super) struct ArrayShift;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "array_shift",
    stage: Stage::Geometry,
    summary: "anchor_l + (row_px, col_px): the whole array is displaced",
    params: &[Param::strength("row_px", "px", 0.005, -50.0, 50.0), Param::strength("col_px", "px", 0.005, -50.0, 50.0)],
    lookalikes: &[
        Lookalike {
            id: "lens_decentre",
            separate_by: "bead scan: a shifted array moves the images of all lenses equally",
        },
        Lookalike {
            id: "thermal_drift",
            separate_by: "repeated frames of a bead at rest: only a drift grows with time",
        },
        Lookalike {
            id: "radial_distortion",
            separate_by: "bead scan over the field: distortion grows with the field angle",
        },
    ],
};

impl Effect for ArrayShift {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn shift_ray(&self, p: &[f64], _ray: &Ray, _cx: &FrameContext<'_>) -> RayShift {
        RayShift::by_px([p[0], p[1]])
    }

    /// No displacement, and where the frames lie beside the expected ones, if that is too far for a small change to
    /// show.
    fn guess(&self, evidence: &Evidence<'_>) -> Vec<Vec<f64>> {
        let far = displacement(evidence).filter(|d| d[0].hypot(d[1]) >= FAR_PX);
        [vec![0.0, 0.0]].into_iter().chain(far.map(|d| d.to_vec())).collect()
    }
}

/// Foci are a few pixels wide: frames are linear in displacements below this, pixels.
const FAR_PX: f64 = 2.0;
/// Largest displacement that is looked for, along each axis, pixels: beyond that the foci of one lens meet those of
/// others.
const MOST_PX: usize = 16;
/// The frames must fit so many times better there (sum of products) than where they are expected.
const BETTER: f32 = 1.2;
/// Width of the blur that is subtracted from the light, pixels: what is broad has no place.
const BROAD_PX: f64 = 5.0;

/// The displacement (row, col), whole pixels, at which the measured light fits the expected one best: the maximum of
/// their cross-correlation, summed over the frames. None: none is clearly better than no displacement.
fn displacement(evidence: &Evidence<'_>) -> Option<[f64; 2]> {
    let (rows, cols) = evidence.frames.first().map(|f| f.light_e.dim()).filter(|(r, c)| *r > 1 && *c > 1)?;
    let size = [rows, cols].map(|n| fast_size(n + MOST_PX));
    let fft = RealFft2::new(size[0], size[1]);
    let mut work = fft.scratch();
    let mut spectrum = |image: &Array2<f32>| {
        let mut padded = Array2::zeros((size[0], size[1]));
        padded.slice_mut(s![..rows, ..cols]).assign(image);
        let mut out = vec![Complex32::default(); fft.spectrum_len()];
        if let Some(padded) = padded.as_slice() {
            fft.forward(padded, &mut out, &mut work);
        }
        out
    };
    let mut sum = vec![Complex32::default(); fft.spectrum_len()];
    let pictured =
        |f: &&EvidenceFrame<'_>| matches!(f.cx.role, Role::Scene | Role::Bead) && f.light_e.dim() == (rows, cols);
    for frame in evidence.frames.iter().filter(pictured) {
        let expected = frame.light_e.mapv(|e| e * frame.cx.gain_dn_per_e as f32);
        let sharp = |image: &Array2<f32>| image - &gaussian_blur(image, BROAD_PX);
        let pair = [sharp(&(&expected + &frame.residual_dn)), sharp(&expected)];
        let [measured, expected] = pair.map(|image| spectrum(&image));
        sum.iter_mut().zip(measured.iter().zip(&expected)).for_each(|(s, (m, e))| *s += m * e.conj());
    }
    let mut fits = vec![0.0f32; size[0] * size[1]];
    fft.inverse(&sum, &mut fits, &mut work);
    let within = MOST_PX.min(rows / 2).min(cols / 2) as isize;
    let at = |d: [isize; 2]| {
        let [r, c] = [0, 1].map(|a| d[a].rem_euclid(size[a] as isize) as usize);
        fits[r * size[1] + c]
    };
    let all = (-within..=within).flat_map(|r| (-within..=within).map(move |c| [r, c]));
    let best = all.max_by(|a, b| at(*a).total_cmp(&at(*b)))?;
    (at(best) > BETTER * at([0, 0]).max(0.0)).then(|| best.map(|d| d as f64))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::effects::FrameContext;

    fn evidence(moved: [f32; 2]) -> Evidence<'static> {
        let foci = |moved: [f32; 2]| {
            Array2::from_shape_fn((60, 72), |(r, c)| {
                let light = |i: usize| {
                    let [y, x] = [(i * 23 % 44 + 8) as f32 + moved[0], (i * 31 % 56 + 8) as f32 + moved[1]];
                    (-((r as f32 - y).powi(2) + (c as f32 - x).powi(2)) / 3.0).exp()
                };
                (0..9).map(|i| 300.0 * light(i)).sum::<f32>()
            })
        };
        let cx = FrameContext { role: Role::Scene, gain_dn_per_e: 1.0, ..FrameContext::default() };
        let light_e = foci([0.0; 2]);
        let residual_dn = foci(moved) - &light_e;
        Evidence { frames: vec![EvidenceFrame { cx, residual_dn, weight: Array2::ones(light_e.dim()), light_e }] }
    }

    #[test]
    fn a_large_displacement_is_a_start_and_a_small_one_is_not() {
        let starts = |moved| ArrayShift.guess(&evidence(moved));
        assert_eq!(starts([5.2, -3.1]), [[0.0, 0.0], [5.0, -3.0]]);
        assert_eq!(starts([-11.0, 7.0]), [[0.0, 0.0], [-11.0, 7.0]]);
        assert_eq!(starts([0.8, 0.5]), [[0.0, 0.0]]);
        assert_eq!(ArrayShift.guess(&Evidence::default()), [[0.0, 0.0]]);
    }
}
