//! Unnamed term: a simple operator on the light, weighted over the field, which `close` tries if no effect of the
//! catalogue explains the residuals.
//!
//! `mu -> mu + amplitude w(place, frame) A[mu]` with an operator A of [`OPERATORS`] and a weight w of [`WEIGHTS`]. The
//! operator indicates how something acts on the light, not its cause.

use super::context::FrameContext;
use super::descriptor::{Descriptor, Param, Stage};
use super::effect::Effect;
use super::smooth::{changed, couple};
use ndarray::{Array2, Axis, Zip, s};
use ommatidia_session::Role;

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
pub const WEIGHTS: [&str; 9] = [
    "even",
    "along x",
    "along y",
    "with the squared radius",
    "with x y",
    "with x2 - y2",
    "with time",
    "alternating by frame",
    "alternating by frame of scenes",
];

static DESCRIPTOR: Descriptor = Descriptor {
    id: "unknown_operator",
    stage: Stage::Light,
    summary: "mu + amplitude w A[mu]: an unnamed term, an operator A on the light with a weight w over the field",
    params: &[
        Param::strength("amplitude", "1", 0.01, -10.0, 10.0),
        Param::choice("operator", "index", 0.0, [0.0, 8.0]),
        Param::choice("weight", "index", 0.0, [0.0, 8.0]),
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
    let half = [(rows as f32 - 1.0) / 2.0, (cols as f32 - 1.0) / 2.0];
    match operator {
        0 => mu.clone(),
        1 => slope(mu, Axis(1)),
        2 => slope(mu, Axis(0)),
        3 => {
            // A step of the heat equation that moves a quarter to the neighbours.
            let mut blurred = mu.clone();
            couple(&mut blurred, 0.25);
            (blurred - mu) * 4.0
        }
        4 => {
            let (mut down, across) = (slope(mu, Axis(0)), slope(mu, Axis(1)));
            Zip::indexed(&mut down).and(&across).for_each(|(r, c), y, x| {
                let from = [(r as f32 - half[0]) / half[0].max(1.0), (c as f32 - half[1]) / half[1].max(1.0)];
                *y = from[0] * *y + from[1] * x;
            });
            down
        }
        5 => mu.slice(s![..;-1, ..;-1]).to_owned(),
        6 => Array2::from_elem((rows, cols), mu.mean().unwrap_or(0.0)),
        7 => mu.mapv(|v| v * v / (cx.full_scale_e.max(1.0) as f32)),
        _ => Array2::from_elem((rows, cols), cx.exposure_ms as f32),
    }
}

/// Half the difference of the two neighbours along an axis; the edge pixels are repeated outside.
fn slope(mu: &Array2<f32>, axis: Axis) -> Array2<f32> {
    let n = mu.len_of(axis);
    let mut out = Array2::zeros(mu.dim());
    for (i, mut lane) in out.axis_iter_mut(axis).enumerate() {
        let [before, after] = [i.saturating_sub(1), (i + 1).min(n - 1)].map(|j| mu.index_axis(axis, j));
        Zip::from(&mut lane).and(&after).and(&before).for_each(|v, a, b| *v = 0.5 * (a - b));
    }
    out
}

/// Multiplies by w.
fn weigh(term: &mut Array2<f32>, weight: usize, cx: &FrameContext<'_>) {
    let (rows, cols) = term.dim();
    let scale = match weight {
        6 => cx.time_s as f32,
        // What happens to scenes alone, flats do not show.
        8 if cx.role != Role::Scene => 0.0,
        7 | 8 if !cx.frame.is_multiple_of(2) => -1.0,
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
