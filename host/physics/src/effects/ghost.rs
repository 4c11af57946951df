//! Ghost: a faint image of the whole frame, rotated by 180 degrees about a point of the sensor, from light reflected
//! between two surfaces.
//!
//! `mu(x) -> mu(x) + ratio mu(2 c - x)` with c = (centre_row, centre_col) from the centre of the sensor, pixels. It
//! acts on specimens and beads, and leaves out what light they have beyond the sensor. A flat field, which is lit there
//! as well, does not show it: turned, it is the same light.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use super::evidence::Evidence;
use super::smooth::gaussian_blur;
use crate::fft2::{RealFft2, fast_size};
use crate::interpolation::shifted;
use ndarray::{Array2, s};

/// The effect; its formula is in the documentation of the module.
pub(super) struct Ghost;

/// Largest distance of the point from the centre of the sensor along each axis, pixels.
const REACH_PX: f64 = 1000.0;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "ghost",
    stage: Stage::Light,
    summary: "mu(x) + ratio mu(2 c - x): a faint image, rotated by 180 degrees about c",
    params: &[
        Param::strength("ratio", "1", 0.0005, 0.0, 1.0),
        Param::shape("centre_row", "px", 0.0, 0.25, [-REACH_PX, REACH_PX], &[]),
        Param::shape("centre_col", "px", 0.0, 0.25, [-REACH_PX, REACH_PX], &[]),
    ],
    lookalikes: &[
        Lookalike {
            id: "lens_leakage",
            separate_by: "move the bead: a ghost moves in the opposite direction, a leak with it",
        },
        Lookalike {
            id: "halo",
            separate_by: "a single bright bead off the centre: a ghost appears on the other side of the centre",
        },
    ],
};

impl Effect for Ghost {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_light(&self, p: &[f64], light_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        if p[0] != 0.0 && cx.shows_specimen() {
            add_turned(light_e, [p[1], p[2]], p[0]);
        }
    }

    /// There are twice as many centres as pixels along each axis; those within one focus (3 x 3) count once.
    fn chances(&self, [rows, cols]: [usize; 2], _frames: usize) -> f64 {
        (4 * rows * cols) as f64 / 9.0
    }

    /// The centres about which the rotated light explains most of the residual.
    fn guess(&self, evidence: &Evidence<'_>) -> Vec<Vec<f64>> {
        centres(evidence).into_iter().map(|[row, col]| vec![0.0, row, col]).collect()
    }
}

/// `image(x) += ratio image(2 c - x)`; the image is dark outside.
fn add_turned(image: &mut Array2<f32>, centre: [f64; 2], ratio: f64) {
    let turned = image.slice(s![..;-1, ..;-1]).to_owned();
    image.scaled_add(ratio as f32, &shifted(&turned, centre.map(|c| 2.0 * c)));
}

/// Width of the blur that is subtracted from the light, pixels: a broad glow has no centre.
const BROAD_PX: f64 = 5.0;
/// Number of centres to propose from anywhere.
const KEEP: usize = 3;
/// Beside them the best in each of 3 x 3 squares of this side about the centre of the sensor is proposed, pixels.
/// Surfaces that are square to the axis turn the image about it, and an array that is symmetric about the axis makes
/// such a ghost resemble another specimen: where nobody knows the specimen, little of it is in the residual.
const NEAR_PX: f64 = 20.0;
/// Smallest distance between them, pixels.
const APART_PX: f64 = 3.0;

/// Centres (row, col) about which rotated light explains most of the residual, best first.
///
/// Light rotated about t/2 explains `(sum w R L(t - x))^2 / sum w L(t - x)^2` of the squared residual. Both sums are
/// convolutions.
fn centres(evidence: &Evidence<'_>) -> Vec<[f64; 2]> {
    let Some((rows, cols)) = evidence.frames.first().map(|f| f.light_e.dim()).filter(|(r, c)| *r > 1 && *c > 1) else {
        return Vec::new();
    };
    let size = [fast_size(2 * rows), fast_size(2 * cols)];
    let fft = RealFft2::new(size[0], size[1]);
    let mut work = fft.scratch();
    let mut spectrum = |image: &Array2<f32>| {
        let mut padded = Array2::zeros((size[0], size[1]));
        padded.slice_mut(s![..rows, ..cols]).assign(image);
        let mut out = vec![Default::default(); fft.spectrum_len()];
        if let Some(padded) = padded.as_slice() {
            fft.forward(padded, &mut out, &mut work);
        }
        out
    };
    let zero = || vec![rustfft::num_complex::Complex32::default(); fft.spectrum_len()];
    let (mut match_sum, mut power_sum) = (zero(), zero());
    for frame in evidence.frames.iter().filter(|f| f.light_e.dim() == (rows, cols)) {
        let sharp = &frame.light_e - &gaussian_blur(&frame.light_e, BROAD_PX);
        let pairs = [
            (&mut match_sum, &frame.residual_dn * &frame.weight, sharp.clone()),
            (&mut power_sum, frame.weight.clone(), &sharp * &sharp),
        ];
        for (sum, a, b) in pairs {
            let (a, b) = (spectrum(&a), spectrum(&b));
            sum.iter_mut().zip(a.iter().zip(&b)).for_each(|(s, (a, b))| *s += a * b);
        }
    }
    let mut inverse = |spectrum: Vec<_>| {
        let mut image = vec![0.0f32; size[0] * size[1]];
        fft.inverse(&spectrum, &mut image, &mut work);
        image
    };
    let (matched, power) = (inverse(match_sum), inverse(power_sum));
    // Where hardly any rotated light falls on the sensor, the ratio consists of rounding errors.
    let floor = 0.02 * power.iter().fold(0.0f32, |m, v| m.max(*v));
    let gain = |i: usize| {
        if matched[i] > 0.0 && power[i] > floor { matched[i] * (matched[i] / power[i]) } else { 0.0 }
    };
    let mut order: Vec<(f32, usize)> = (0..matched.len()).map(|i| (gain(i), i)).filter(|(g, _)| *g > 0.0).collect();
    order.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut kept: Vec<[f64; 2]> = Vec::new();
    let mut near = [false; 9];
    for (_, i) in order {
        let centre = [(i / size[1], rows), (i % size[1], cols)].map(|(sum, n)| (sum as f64 - (n as f64 - 1.0)) / 2.0);
        let square = centre.map(|x| (x / NEAR_PX + 1.5).floor());
        let square = square.iter().all(|s| (0.0..3.0).contains(s)).then(|| 3 * square[0] as usize + square[1] as usize);
        let is_first = square.is_some_and(|s| !near[s]);
        if kept.len() >= KEEP && !is_first {
            continue;
        }
        if kept.iter().all(|k| (k[0] - centre[0]).hypot(k[1] - centre[1]) >= APART_PX) {
            kept.push(centre);
            square.into_iter().for_each(|s| near[s] = true);
        }
    }
    kept
}
