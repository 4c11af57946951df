//! Effects outside the catalogue: they test what `close` reports of a cause that the catalogue lacks.
//!
//! They are not in the registry; only the virtual instrument of a study can have one.

use crate::effects::{Descriptor, Effect, FrameContext, Param, Ray, RayShift, Stage};
use crate::session::Role;
use ndarray::Array2;

/// The law of an effect, given its only parameter.
enum Act {
    Ray(fn(f64, &Ray) -> RayShift),
    Light(fn(f64, &mut Array2<f32>, &FrameContext<'_>)),
    Charge(fn(f64, &mut Array2<f32>, &FrameContext<'_>)),
}

/// An effect outside the catalogue.
pub struct Foreign {
    descriptor: &'static Descriptor,
    act: Act,
}

const fn amplitude(step: f64) -> Param {
    Param::strength("amplitude", "1", step, -1e3, 1e3)
}

macro_rules! foreign {
    ($id:literal, $stage:ident, $step:literal, $summary:literal, $act:expr) => {
        Foreign {
            descriptor: &Descriptor {
                id: $id,
                stage: Stage::$stage,
                summary: $summary,
                params: &[amplitude($step)],
                lookalikes: &[],
            },
            act: $act,
        }
    };
}

/// All of them.
pub static FOREIGN: [Foreign; 8] = [
    foreign!(
        "lens_twist",
        Geometry,
        0.001,
        "the image of each lens turns about its anchor, every other one the other way",
        Act::Ray(lens_twist)
    ),
    foreign!(
        "root_compression",
        Charge,
        0.001,
        "Q - a (sqrt(Q F) - Q): the response bends like a square root",
        Act::Charge(root_compression)
    ),
    foreign!(
        "half_step",
        Light,
        0.001,
        "the response steps at the middle column of the sensor, as with two readout halves",
        Act::Light(half_step)
    ),
    foreign!(
        "diagonal_wave",
        Light,
        0.001,
        "light times 1 + a sin along the diagonal, 13.7 px a period",
        Act::Light(diagonal_wave)
    ),
    foreign!(
        "alternating_gain",
        Light,
        0.001,
        "light times 1 + a (-1)^frame: every other frame is brighter",
        Act::Light(alternating_gain)
    ),
    foreign!("stray_ring", Light, 0.01, "a ring of stray light in proportion to all light", Act::Light(stray_ring)),
    foreign!(
        "intensity_shift",
        Charge,
        0.01,
        "charge moves along the row in proportion to its square",
        Act::Charge(intensity_shift)
    ),
    foreign!(
        "tilted_response",
        Light,
        0.001,
        "response rises linearly from left to right",
        Act::Light(tilted_response)
    ),
];

/// The effect of that id.
pub fn find(id: &str) -> Option<&'static Foreign> {
    FOREIGN.iter().find(|f| f.descriptor.id == id)
}

impl Effect for Foreign {
    fn descriptor(&self) -> &'static Descriptor {
        self.descriptor
    }

    fn shift_ray(&self, p: &[f64], ray: &Ray, _cx: &FrameContext<'_>) -> RayShift {
        if let Act::Ray(act) = self.act { act(p[0], ray) } else { RayShift::default() }
    }

    fn on_light(&self, p: &[f64], light_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        if let Act::Light(act) = self.act {
            act(p[0], light_e, cx);
        }
    }

    fn on_charge(&self, p: &[f64], charge_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
        if let Act::Charge(act) = self.act {
            act(p[0], charge_e, cx);
        }
    }
}

fn lens_twist(a: f64, ray: &Ray) -> RayShift {
    let angle = if ray.lens.is_multiple_of(2) { a } else { -a };
    RayShift { px: [angle * ray.field_px[1], -angle * ray.field_px[0]], z_um: 0.0 }
}

fn root_compression(a: f64, charge_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
    let full = cx.full_scale_e;
    charge_e.mapv_inplace(|q| {
        let q = f64::from(q);
        (q - a * ((q.max(0.0) * full).sqrt() - q)) as f32
    });
}

fn half_step(a: f64, light_e: &mut Array2<f32>, _cx: &FrameContext<'_>) {
    let middle = light_e.ncols() / 2;
    light_e.indexed_iter_mut().filter(|((_, c), _)| *c >= middle).for_each(|(_, v)| *v *= 1.0 + a as f32);
}

fn diagonal_wave(a: f64, light_e: &mut Array2<f32>, _cx: &FrameContext<'_>) {
    const PERIOD_PX: f64 = 13.7;
    light_e.indexed_iter_mut().for_each(|((r, c), v)| {
        *v *= (1.0 + a * (std::f64::consts::TAU * (r + c) as f64 / PERIOD_PX).sin()) as f32;
    });
}

fn alternating_gain(a: f64, light_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
    if cx.role != Role::Dark {
        let sign = if cx.frame.is_multiple_of(2) { 1.0 } else { -1.0 };
        light_e.mapv_inplace(|v| v * (1.0 + a * sign) as f32);
    }
}

fn stray_ring(a: f64, light_e: &mut Array2<f32>, _cx: &FrameContext<'_>) {
    let (rows, cols) = light_e.dim();
    let mean = f64::from(light_e.mean().unwrap_or(0.0));
    let (radius, width) = (0.3 * rows.min(cols) as f64, 3.0);
    let from = |i: usize, n: usize| i as f64 - (n as f64 - 1.0) / 2.0;
    light_e.indexed_iter_mut().for_each(|((r, c), v)| {
        let off = (from(r, rows).hypot(from(c, cols)) - radius) / width;
        *v += (a * mean * (-0.5 * off * off).exp()) as f32;
    });
}

fn intensity_shift(a: f64, charge_e: &mut Array2<f32>, cx: &FrameContext<'_>) {
    let share = (a / cx.full_scale_e.max(1.0)) as f32;
    for mut row in charge_e.outer_iter_mut() {
        let moved: Vec<f32> = row.iter().map(|q| share * q * q.abs()).collect();
        let n = moved.len();
        for (c, v) in row.iter_mut().enumerate() {
            // What would leave the last column stays there.
            let out = if c + 1 < n { moved[c] } else { 0.0 };
            *v += if c > 0 { moved[c - 1] } else { 0.0 } - out;
        }
    }
}

fn tilted_response(a: f64, light_e: &mut Array2<f32>, _cx: &FrameContext<'_>) {
    let half = (light_e.ncols() as f64 - 1.0).max(1.0) / 2.0;
    light_e.indexed_iter_mut().for_each(|((_, c), v)| *v *= (1.0 + a * (c as f64 / half - 1.0)) as f32);
}
