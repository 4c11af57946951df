//! Drift of the aberrations: the PSFs of all lenses became more comatic or astigmatic than in the calibration.
//!
//! To lowest order of its moments, a PSF h of a source whose focus lies at x = (y, x) from the axis of its lens, mm,
//! becomes
//! ```text
//! h - div lap (A h) + (d2/drdr - d2/dcdc) (y^2 - x^2) a h / 2 + 2 d2/drdc (y x a h)
//! A = (coma_row_px3, coma_col_px3) + coma_px3_per_mm (y, x),   a = astigmatism_px2_per_mm2
//! ```
//! The first term adds 6 A to the third moment of h along A and 2 A to the mixed one: coma, equal over the field (an
//! element is decentred) or in proportion to the field angle (Seidel). The second adds `a r^2` to the second moment
//! along the radius and takes it from that across it: Seidel astigmatism. Light and centroid of a focus stay. No pupil
//! is assumed. What spherical aberration and defocus do, an even ring, is not part of it. The same coefficients hold
//! for all lenses. Source: Born & Wolf, Principles of Optics, section 5.3 (dependence of the Seidel terms on the
//! field); moments by partial integration.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use super::smooth::changed;
use ndarray::{Array2, Zip, s};

/// The effect; its formula is in the documentation of the module.
pub(super) struct AberrationDrift;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "aberration_drift",
    stage: Stage::Lens,
    summary: "h - div lap (A h) + quadrupole of a r^2: coma, equal or linear in the field, and astigmatism changed",
    // A focus of 1.5 px rms has a skewness of 6 A / 1.5^3 and a second moment of 2.3 px^2: beyond these ranges the
    // terms exceed the focus itself at 0.1 mm from the axis.
    params: &[
        Param::strength("coma_row_px3", "px^3", 0.008, -2.0, 2.0),
        Param::strength("coma_col_px3", "px^3", 0.008, -2.0, 2.0),
        Param::strength("coma_px3_per_mm", "px^3/mm", 0.05, -20.0, 20.0),
        Param::strength("astigmatism_px2_per_mm2", "px^2/mm^2", 0.5, -200.0, 200.0),
    ],
    lookalikes: &[
        Lookalike {
            id: "readout_lag",
            separate_by: "covariance of flats: a readout lag correlates neighbours along rows, coma does not",
        },
        Lookalike { id: "array_shift", separate_by: "bead scan: a shift moves foci and leaves them symmetric" },
        Lookalike {
            id: "motion_blur",
            separate_by: "bead scan: aberrations show in beads, and their direction turns with the field",
        },
        Lookalike { id: "rank_truncation", separate_by: "a model of higher rank: it removes a truncation" },
    ],
};

impl Effect for AberrationDrift {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_lens(&self, p: &[f64], image_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        let Some([row, col]) = cx.axes_px.get(cx.lens).copied() else { return };
        if p.iter().all(|v| *v == 0.0) || image_e.is_empty() {
            return;
        }
        let mm = cx.pixel_pitch_um * 1e-3;
        let place = |(r, c): (usize, usize)| [(r as f64 - row) * mm, (c as f64 - col) * mm];
        let weighted = |weight: &dyn Fn([f64; 2]) -> f64| {
            let mut image = image_e.clone();
            image.indexed_iter_mut().filter(|(_, v)| **v != 0.0).for_each(|(at, v)| *v *= weight(place(at)) as f32);
            image
        };
        let mut change = Array2::<f32>::zeros(image_e.dim());
        if p[..3].iter().any(|v| *v != 0.0) {
            for axis in 0..2 {
                let image = weighted(&|at| p[axis] + p[2] * at[axis]);
                let curved = differences(&image, [1, 0]) + differences(&image, [0, 1]);
                change -= &slope(&curved, axis);
            }
        }
        if p[3] != 0.0 {
            let image = weighted(&|[y, x]| 0.5 * p[3] * (y * y - x * x));
            change += &(differences(&image, [1, 0]) - differences(&image, [0, 1]));
            let image = weighted(&|[y, x]| 2.0 * p[3] * y * x);
            change += &slope(&slope(&image, 0), 1);
        }
        Zip::from(image_e).and(&change).for_each(|v, c| *v = changed(*v, *c));
    }
}

/// `f(x + step) + f(x - step) - 2 f(x)`; dark outside. [rows, cols] in and out.
fn differences(image: &Array2<f32>, step: [usize; 2]) -> Array2<f32> {
    let mut out = image * -2.0;
    add_displaced(&mut out, image, step, [1.0, 1.0]);
    out
}

/// `(f(x + 1) - f(x - 1)) / 2` along an axis; dark outside. [rows, cols] in and out.
fn slope(image: &Array2<f32>, axis: usize) -> Array2<f32> {
    let mut out = Array2::zeros(image.dim());
    add_displaced(&mut out, image, [1 - axis, axis], [0.5, -0.5]);
    out
}

/// Adds `weights[0] f(x + step) + weights[1] f(x - step)`.
fn add_displaced(out: &mut Array2<f32>, image: &Array2<f32>, [dr, dc]: [usize; 2], weights: [f32; 2]) {
    let (rows, cols) = image.dim();
    if dr >= rows || dc >= cols {
        return;
    }
    let (near, far) = (s![..rows - dr, ..cols - dc], s![dr.., dc..]);
    out.slice_mut(near).scaled_add(weights[0], &image.slice(far));
    out.slice_mut(far).scaled_add(weights[1], &image.slice(near));
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Moments `sum r^i c^j v` of what the effect adds to a focus at (30, 34), whose axis is at (20, 29), pixels of
    /// 10 um.
    fn moments(p: &[f64], powers: &[[i32; 2]]) -> Vec<f64> {
        let axes_px = [[20.0, 29.0]];
        let cx = FrameContext { axes_px: &axes_px, pixel_pitch_um: 10.0, ..FrameContext::default() };
        let spot = Array2::from_shape_fn((61, 69), |(r, c)| {
            let square = (r as f32 - 30.0).powi(2) + (c as f32 - 34.0).powi(2);
            1e4 * (-square / 8.0).exp()
        });
        let mut image = spot.clone();
        AberrationDrift.on_lens(p, &mut image, &cx);
        let change = image - &spot;
        let sum: f64 = spot.iter().map(|v| f64::from(*v)).sum();
        let one = |[i, j]: &[i32; 2]| -> f64 {
            let term = |((r, c), v): ((usize, usize), &f32)| {
                f64::from(*v) * (r as f64 - 30.0).powi(*i) * (c as f64 - 34.0).powi(*j)
            };
            change.indexed_iter().map(term).sum::<f64>() / sum
        };
        powers.iter().map(one).collect()
    }

    fn near(found: &[f64], expected: &[f64]) {
        for (f, e) in found.iter().zip(expected) {
            assert!((f - e).abs() < 2e-2 * e.abs().max(0.01), "{found:?} instead of {expected:?}");
        }
    }

    #[test]
    fn coma_adds_third_moments_and_nothing_below() {
        let powers = [[0, 0], [1, 0], [0, 1], [2, 0], [1, 1], [0, 2], [3, 0], [1, 2], [0, 3], [2, 1]];
        near(&moments(&[0.01, 0.0, 0.0, 0.0], &powers), &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.06, 0.02, 0.0, 0.0]);
        // 0.1 and 0.05 mm from the axis. The coefficient is linear over the focus: its mean is that at the centroid.
        let field = moments(&[0.0, 0.0, 0.1, 0.0], &powers);
        near(&field[..3], &[0.0; 3]);
        near(&field[6..], &[0.06, 0.02, 0.03, 0.01]);
    }

    #[test]
    fn astigmatism_stretches_along_the_radius_and_shrinks_across() {
        // y = 0.1, x = 0.05 mm: (y^2 - x^2) a = 0.0075 px^2, and 2 y x a = 0.01 px^2.
        let found = moments(&[0.0, 0.0, 0.0, 1.0], &[[0, 0], [1, 0], [0, 1], [2, 0], [0, 2], [1, 1]]);
        near(&found, &[0.0, 0.0, 0.0, 0.0075, -0.0075, 0.01]);
    }
}
