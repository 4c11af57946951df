//! Unnamed term: a simple operator on the light, weighted over the field, which `close` tries if no effect of the
//! catalogue explains the residuals.
//!
//! `mu -> mu + amplitude w(place, frame) A[mu]` with an operator A of [`OPERATORS`] and a weight w of [`WEIGHTS`]. The
//! operator indicates how something acts on the light, not its cause.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Param, Stage};
use super::effect::Effect;
use super::smooth::changed;
use ndarray::{Array2, Zip};

/// The effect; its formula is in the documentation of the module.
pub(super) struct UnknownOperator;

/// Names of the operators A.
pub const OPERATORS: [&str; 9] = [
    "the light itself",
    "its slope along the columns",
    "its slope along the rows",
    "its Laplacian",
    "its slope away from the middle",
    "its image turned by 180 degrees",
    "the mean light of the frame",
    "its square over full scale",
    "an even level by exposure",
];

/// Names of the weights w; x and y run from -1 to 1 over the sensor.
pub const WEIGHTS: [&str; 8] = [
    "even",
    "along x",
    "along y",
    "with the squared radius",
    "with x y",
    "with x2 - y2",
    "with time",
    "alternating by frame",
];

static DESCRIPTOR: Descriptor = Descriptor {
    id: "unknown_operator",
    stage: Stage::Light,
    summary: "mu + amplitude w A[mu]: an unnamed term, an operator A on the light with a weight w over the field",
    params: &[
        Param::strength("amplitude", "1", 0.01, -10.0, 10.0),
        Param::choice("operator", "index", 0.0, [0.0, 8.0]),
        Param::choice("weight", "index", 0.0, [0.0, 7.0]),
    ],
    lookalikes: &[],
};

impl Effect for UnknownOperator {
    fn descriptor(&self) -> &'static Descriptor {
        &DESCRIPTOR
    }

    fn on_light(&self, p: &[f64], light_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        if p[0] == 0.0 || light_e.is_empty() {
            return;
        }
        let mut term = operated(light_e, p[1] as usize, cx);
        weigh(&mut term, p[2] as usize, cx);
        let a = p[0] as f32;
        light_e.zip_mut_with(&term, |v, t| *v = changed(*v, a * t));
    }
}

/// A[mu].
fn operated(mu: &Array2<f32>, operator: usize, cx: &FrameContext<'_>) -> Array2<f32> {
    let (rows, cols) = mu.dim();
    let at = |r: isize, c: isize| mu[[r.clamp(0, rows as isize - 1) as usize, c.clamp(0, cols as isize - 1) as usize]];
    let local =
        |f: &dyn Fn(isize, isize) -> f32| Array2::from_shape_fn((rows, cols), |(r, c)| f(r as isize, c as isize));
    let dx = |r: isize, c: isize| 0.5 * (at(r, c + 1) - at(r, c - 1));
    let dy = |r: isize, c: isize| 0.5 * (at(r + 1, c) - at(r - 1, c));
    let half = [(rows as f32 - 1.0) / 2.0, (cols as f32 - 1.0) / 2.0];
    match operator {
        0 => mu.clone(),
        1 => local(&dx),
        2 => local(&dy),
        3 => local(&|r, c| at(r + 1, c) + at(r - 1, c) + at(r, c + 1) + at(r, c - 1) - 4.0 * at(r, c)),
        4 => local(&|r, c| {
            (r as f32 - half[0]) / half[0].max(1.0) * dy(r, c) + (c as f32 - half[1]) / half[1].max(1.0) * dx(r, c)
        }),
        5 => Array2::from_shape_fn((rows, cols), |(r, c)| mu[[rows - 1 - r, cols - 1 - c]]),
        6 => Array2::from_elem((rows, cols), mu.mean().unwrap_or(0.0)),
        7 => mu.mapv(|v| v * v / (cx.full_scale_e.max(1.0) as f32)),
        _ => Array2::from_elem((rows, cols), cx.exposure_ms as f32),
    }
}

/// Multiplies by w.
fn weigh(term: &mut Array2<f32>, weight: usize, cx: &FrameContext<'_>) {
    let (rows, cols) = term.dim();
    let scale = match weight {
        6 => cx.time_s as f32,
        7 => {
            if cx.frame.is_multiple_of(2) {
                1.0
            } else {
                -1.0
            }
        }
        _ => 1.0,
    };
    if scale != 1.0 {
        term.mapv_inplace(|v| v * scale);
    }
    if !(1..=5).contains(&weight) {
        return;
    }
    let along = |i: usize, n: usize| 2.0 * (i as f32 + 0.5) / n as f32 - 1.0;
    Zip::indexed(term).for_each(|(r, c), v| {
        let (y, x) = (along(r, rows), along(c, cols));
        *v *= match weight {
            1 => x,
            2 => y,
            3 => x * x + y * y,
            4 => x * y,
            _ => x * x - y * y,
        };
    });
}
