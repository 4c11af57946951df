//! Processing by the camera: it smooths its frames before it sends them.
//!
//! `y -> y + strength (B y - y)` with the binomial kernel B = (1 2 1)'(1 2 1) / 16; the pixels at the edge are repeated
//! outside. It acts on the finished values, so the read noise of neighbours becomes correlated too, and even that of
//! diagonal neighbours. The kernel is that of the smallest noise filters of image processors (the binomial filter of
//! second order: Jähne, Digital Image Processing, section 11.4).

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use ndarray::{Array2, Axis, Zip, s};

/// The effect; its formula is in the documentation of the module.
pub(super) struct CameraProcessing;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "camera_processing",
    stage: Stage::Electronics,
    summary: "y + strength (B y - y), B the 3 x 3 binomial mean, after all noise: the camera smooths its frames",
    // At 1 the frame is B y: a camera cannot apply the filter by more than the whole of it.
    params: &[Param::strength("strength", "1", 0.01, 0.0, 1.0).far(&[0.5, 1.0])],
    lookalikes: &[
        Lookalike {
            id: "interpixel_capacitance",
            separate_by: "covariance of darks: processing correlates read noise, capacitance the charge alone",
        },
        Lookalike {
            id: "readout_lag",
            separate_by: "covariance of darks: processing correlates neighbours along rows and columns alike",
        },
        Lookalike {
            id: "charge_diffusion",
            separate_by: "covariance of darks: processing correlates neighbours, diffusion does not",
        },
        Lookalike { id: "noise_scale", separate_by: "covariance of darks: a wrong gain does not correlate neighbours" },
    ],
};

impl Effect for CameraProcessing {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_electronics(&self, p: &[f64], frame_dn: &mut Array2<f32>, _cx: &FrameContext<'_>) {
        if p[0] == 0.0 || frame_dn.is_empty() {
            return;
        }
        let smooth = binomial(&binomial(frame_dn, Axis(0)), Axis(1));
        let strength = p[0] as f32;
        frame_dn.zip_mut_with(&smooth, |y, b| *y += strength * (b - *y));
    }
}

/// (1 2 1) / 4 along an axis, [rows, cols] in and out; the first and the last line are repeated outside.
fn binomial(image: &Array2<f32>, axis: Axis) -> Array2<f32> {
    let n = image.len_of(axis);
    let mut out = image * 0.5;
    let mut add = |to: std::ops::Range<usize>, from: std::ops::Range<usize>| {
        let (mut to, from) = if axis == Axis(0) {
            (out.slice_mut(s![to, ..]), image.slice(s![from, ..]))
        } else {
            (out.slice_mut(s![.., to]), image.slice(s![.., from]))
        };
        Zip::from(&mut to).and(&from).for_each(|t, f| *t += 0.25 * f);
    };
    add(1..n, 0..n - 1);
    add(0..n - 1, 1..n);
    add(0..1, 0..1);
    add(n - 1..n, n - 1..n);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The naive sum over nine neighbours, [rows, cols].
    #[test]
    fn the_kernel_is_the_product_of_two_binomials() {
        let image = Array2::from_shape_fn((7, 9), |(r, c)| ((r * 31 + c * 17) % 23) as f32);
        let mut found = image.clone();
        CameraProcessing.on_electronics(&[0.3], &mut found, &FrameContext::default());
        let near = |i: usize, d: usize, n: usize| (i + d).saturating_sub(1).min(n - 1);
        for ((r, c), v) in image.indexed_iter() {
            let mut mean = 0.0;
            for (dr, dc) in (0..3).flat_map(|dr| (0..3).map(move |dc| (dr, dc))) {
                let weight = [1.0, 2.0, 1.0][dr] * [1.0, 2.0, 1.0][dc] / 16.0;
                mean += weight * image[[near(r, dr, 7), near(c, dc, 9)]];
            }
            let expected = v + 0.3 * (mean - v);
            assert!((found[[r, c]] - expected).abs() < 1e-5, "{r} {c}: {} {expected}", found[[r, c]]);
        }
        // An even frame stays even, up to its edges.
        let mut even = Array2::from_elem((5, 6), 64.0f32);
        CameraProcessing.on_electronics(&[1.0], &mut even, &FrameContext::default());
        assert!(even.iter().all(|v| *v == 64.0));
    }
}
