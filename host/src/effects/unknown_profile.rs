//! Unnamed profile: a factor on the light, or added light, that depends on one covariate by a piecewise linear curve.
//!
//! `mu -> mu (1 + s(v))`, or `mu -> mu + s(v) t` with the exposure t in ms. The curve s interpolates [`KNOTS`] values
//! at even steps between `low` and `high` of the covariate v. Outside that range s is zero.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Param, Stage};
use super::effect::Effect;
use super::smooth::changed;
use ndarray::{Array2, Zip};

/// The effect; its formula is in the documentation of the module.
pub(super) struct UnknownProfile;

/// Number of values of the curve.
pub const KNOTS: usize = 12;

/// Names of the covariates.
pub const COVARIATES: [&str; 7] = [
    "row (px)",
    "column (px)",
    "radius from the middle of the sensor (px)",
    "diagonal, row + column (px)",
    "light (e-)",
    "time (s)",
    "row within the period (px)",
];

const fn knot(name: &'static str) -> Param {
    Param::strength(name, "1 or e-/ms", 0.01, -1e4, 1e4)
}

static DESCRIPTOR: Descriptor = Descriptor {
    id: "unknown_profile",
    stage: Stage::Light,
    summary: "mu (1 + s(v)) or mu + s(v) t: an unnamed term, a curve over one covariate v",
    params: &[
        knot("knot_00"),
        knot("knot_01"),
        knot("knot_02"),
        knot("knot_03"),
        knot("knot_04"),
        knot("knot_05"),
        knot("knot_06"),
        knot("knot_07"),
        knot("knot_08"),
        knot("knot_09"),
        knot("knot_10"),
        knot("knot_11"),
        Param::choice("covariate", "index", 0.0, [0.0, 6.0]),
        Param::choice("additive", "0 or 1", 0.0, [0.0, 1.0]),
        Param::choice("low", "unit of the covariate", 0.0, [-1e12, 1e12]),
        Param::choice("high", "unit of the covariate", 8.0, [-1e12, 1e12]),
    ],
    lookalikes: &[],
};

impl Effect for UnknownProfile {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    /// The number of independent periods over the rows.
    fn chances(&self, [rows, _]: [usize; 2], _frames: usize) -> f64 {
        rows as f64 / 2.0
    }

    fn on_light(&self, p: &[f64], light_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        let (knots, shape) = p.split_at(KNOTS);
        if knots.iter().all(|v| *v == 0.0) {
            return;
        }
        let (low, high) = (shape[2] as f32, shape[3] as f32);
        let step = (high - low) / (KNOTS as f32 - 1.0);
        if step.is_nan() || step <= 0.0 {
            return;
        }
        let (rows, cols) = light_e.dim();
        let middle = [(rows as f32 - 1.0) / 2.0, (cols as f32 - 1.0) / 2.0];
        let (covariate, additive) = (shape[0] as usize, shape[1] != 0.0);
        Zip::indexed(light_e).for_each(|(r, c), v| {
            let at = match covariate {
                0 => r as f32,
                1 => c as f32,
                2 => (r as f32 - middle[0]).hypot(c as f32 - middle[1]),
                3 => (r + c) as f32,
                4 => *v,
                5 => cx.time_s as f32,
                // One period is the range from low to high.
                _ => (r as f32 - low).rem_euclid(high - low) + low,
            };
            let place = (at - low) / step;
            if !(0.0..=KNOTS as f32 - 1.0).contains(&place) {
                return;
            }
            let i = (place as usize).min(KNOTS - 2);
            let part = place - i as f32;
            let s = knots[i] as f32 * (1.0 - part) + knots[i + 1] as f32 * part;
            *v = if additive { changed(*v, s * cx.exposure_ms as f32) } else { *v * (1.0 + s).max(0.0) };
        });
    }
}
