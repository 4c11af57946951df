//! Saturation: the wells of the pixels are full below the full scale of the converter.
//!
//! `Q -> Q (1 + (W^-n - 1) (Q / full scale)^n)^(-1/n)`, W = 1 - below: charge at full scale becomes W of full scale,
//! the depth of the well, and small charges hardly change. n is `sharpness`: 8 bends over the upper third of the well,
//! 32 nearly clips. Because the transition is smooth, a fit can start from a well as deep as the full scale. Of the
//! lost charge, the share `spill` goes to the pixels above and below, half each (blooming along the column).

use super::context::FrameContext;
use super::descriptor::{Descriptor, Lookalike, Param, Stage};
use super::effect::Effect;
use ndarray::Array2;

/// The effect; its formula is in the documentation of the module.
pub(super) struct Saturation;

static DESCRIPTOR: Descriptor = Descriptor {
    id: "saturation",
    stage: Stage::Charge,
    summary: "Q is limited to (1 - below) full scale, lost charge spills along the column: the wells are full early",
    params: &[
        Param::strength("below", "share of full scale", 0.1, 0.0, 0.95).far(&[0.4, 0.7, 0.9]),
        Param::shape("spill", "1", 0.0, 0.1, [0.0, 1.0], &[0.0]),
        // A well of 300,000 e- fills within 1/64 of its depth: sharper than that no frame tells from a clip.
        Param::shape("sharpness", "1", 8.0, 2.0, [4.0, 64.0], &[8.0, 32.0]),
    ],
    lookalikes: &[
        Lookalike {
            id: "nonlinearity",
            separate_by: "leave out the brightest pixels: nonlinearity remains, saturation does not",
        },
        Lookalike {
            id: "adc_nonlinearity",
            separate_by: "histogram of a bright ramp: a converter step leaves a gap at one code",
        },
    ],
};

/// Relative loss of charge that changes no number of single precision: a quarter of the distance of two of them.
const LEAST_LOSS: f64 = f32::EPSILON as f64 / 8.0;

/// Up to this distance from 1 the series of [`root`] is exact to 1e-13.
const NEAR: f64 = 1e-3;

/// `x^(1/n)` for n of 1 or more.
fn root(x: f64, n: f64) -> f64 {
    let t = x - 1.0;
    if t.abs() > NEAR {
        return x.powf(1.0 / n);
    }
    let by = 1.0 / n;
    1.0 + by * t * (1.0 + (by - 1.0) / 2.0 * t * (1.0 + (by - 2.0) / 3.0 * t))
}

impl Effect for Saturation {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_charge(&self, p: &[f64], charge_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        if p[0] == 0.0 || cx.full_scale_e <= 0.0 {
            return;
        }
        let n = p[2].max(1.0);
        // As (Q / full scale / W)^n - (Q / full scale)^n, which does not overflow where the charge is small.
        let (well, full) = ((1.0 - p[0]) * cx.full_scale_e, cx.full_scale_e);
        // Fits start from whole numbers, whose powers are products.
        let whole = n.fract() == 0.0;
        let power = |x: f64| if whole { x.powi(n as i32) } else { x.powf(n) };
        let mut lost = Array2::<f32>::zeros(if p[1] > 0.0 { charge_e.dim() } else { (0, 0) });
        // Below this, less is lost than single precision holds.
        let least = (well * (n * LEAST_LOSS).powf(1.0 / n)) as f32;
        for ((r, c), v) in charge_e.indexed_iter_mut().filter(|(_, v)| **v > least) {
            let q = f64::from(*v);
            let kept = (q / root(1.0 + power(q / well) - power(q / full), n)) as f32;
            if let Some(lost) = lost.get_mut((r, c)) {
                *lost = *v - kept;
            }
            *v = kept;
        }
        let half = (p[1] / 2.0) as f32;
        for (r, row) in lost.outer_iter().enumerate() {
            let near = [r.checked_sub(1), Some(r + 1).filter(|n| *n < lost.nrows())];
            for n in near.into_iter().flatten() {
                charge_e.row_mut(n).scaled_add(half, &row);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::root;

    #[test]
    fn the_series_near_one_is_the_root() {
        for n in [1.0, 4.5, 8.0, 64.0] {
            for x in [1.0, 1.0 + 1e-9, 1.0 - 1e-3, 1.0 + 1e-3, 1.002, 7.0] {
                let (found, exact) = (root(x, n), x.powf(1.0 / n));
                assert!((found - exact).abs() < 2e-13, "{n} {x}: {found} for {exact}");
            }
        }
    }
}
