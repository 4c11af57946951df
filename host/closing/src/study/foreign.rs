//! Effects outside the catalogue: they test what `close` reports of a cause that the catalogue lacks.
//!
//! They are not in the registry; only the virtual instrument of a study can have one.

use ndarray::Array2;
use ommatidia_physics::effects::{Descriptor, Effect, FrameContext, Param, Ray, RayShift, Stage};
use ommatidia_session::Role;
use rand_distr::{Distribution, StandardNormal};

/// What an effect is like, for the tables of a study.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Like {
    /// In a small part of the sensor.
    Compact,
    /// Smooth over the sensor or the object.
    Smooth,
    /// Periodic in space.
    Periodic,
    /// From frame to frame.
    Temporal,
    /// Different in each lens.
    PerLens,
    /// In the noise only.
    Noise,
    /// By the amount of charge.
    Charge,
}

impl Like {
    /// The name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Compact => "compact",
            Self::Smooth => "smooth",
            Self::Periodic => "periodic",
            Self::Temporal => "temporal",
            Self::PerLens => "per lens",
            Self::Noise => "in the noise only",
            Self::Charge => "by charge",
        }
    }
}

/// The law of an effect, given its only parameter.
enum Act {
    Object(fn(f64, &mut Array2<f32>, &FrameContext<'_>)),
    Moving(fn(f64, &Ray, &FrameContext<'_>) -> RayShift),
    Reading(Reading),
    Ray(fn(f64, &Ray) -> RayShift),
    Light(fn(f64, &mut Array2<f32>, &FrameContext<'_>)),
    Charge(fn(f64, &mut Array2<f32>, &FrameContext<'_>)),
}

/// Noise that is not in the noise model.
struct Reading {
    add: fn(f64, &mut Array2<f32>, &FrameContext<'_>, &mut dyn rand::Rng),
    /// Variance that it adds to a pixel with so many DN of light, at amplitude 1, DN^2.
    variance_dn2: fn(f64) -> f64,
}

/// An effect outside the catalogue.
pub struct Foreign {
    descriptor: &'static Descriptor,
    like: Like,
    act: Act,
}

impl Foreign {
    /// What it is like.
    pub fn like(&self) -> Like {
        self.like
    }

    /// Variance that it adds to a pixel with so many DN of light, at amplitude 1, DN^2; `None`: it changes the mean.
    pub fn added_variance_dn2(&self, light_dn: f64) -> Option<f64> {
        match &self.act {
            Act::Reading(noise) => Some((noise.variance_dn2)(light_dn)),
            _ => None,
        }
    }
}

const fn amplitude(step: f64) -> Param {
    Param::strength("amplitude", "1", step, -1e3, 1e3)
}

macro_rules! foreign {
    ($id:literal, $stage:ident, $like:ident, $step:literal, $summary:literal, $act:expr) => {
        foreign!($id, $stage, $like, amplitude($step), $summary, $act)
    };
    ($id:literal, $stage:ident, $like:ident, $param:expr, $summary:literal, $act:expr) => {
        Foreign {
            like: Like::$like,
            descriptor: &Descriptor {
                id: $id,
                stage: Stage::$stage,
                summary: $summary,
                params: &[$param],
                lookalikes: &[],
            },
            act: $act,
        }
    };
}

/// All of them.
pub static FOREIGN: [Foreign; 16] = [
    foreign!(
        "lens_twist",
        Geometry,
        PerLens,
        0.001,
        "the image of each lens turns about its anchor, every other one the other way",
        Act::Ray(lens_twist)
    ),
    foreign!(
        "root_compression",
        Charge,
        Charge,
        0.001,
        "Q - a (sqrt(Q F) - Q): the response bends like a square root",
        Act::Charge(root_compression)
    ),
    foreign!(
        "half_step",
        Light,
        Smooth,
        0.001,
        "the response steps at the middle column of the sensor, as with two readout halves",
        Act::Light(half_step)
    ),
    foreign!(
        "diagonal_wave",
        Light,
        Periodic,
        0.001,
        "light times 1 + a sin along the diagonal, 13.7 px a period",
        Act::Light(diagonal_wave)
    ),
    foreign!(
        "alternating_gain",
        Light,
        Temporal,
        0.001,
        "light times 1 + a (-1)^frame: every other frame is brighter",
        Act::Light(alternating_gain)
    ),
    foreign!(
        "stray_ring",
        Light,
        Compact,
        0.01,
        "a ring of stray light in proportion to all light",
        Act::Light(stray_ring)
    ),
    foreign!(
        "intensity_shift",
        Charge,
        Charge,
        0.01,
        "charge moves along the row in proportion to its square",
        Act::Charge(intensity_shift)
    ),
    foreign!(
        "tilted_response",
        Light,
        Smooth,
        0.001,
        "response rises linearly from left to right",
        Act::Light(tilted_response)
    ),
    foreign!(
        "thumbprint",
        Light,
        Compact,
        0.01,
        "a fingerprint of 8 px off the centre takes light",
        Act::Light(thumbprint)
    ),
    foreign!(
        "saddle_shade",
        Light,
        Smooth,
        0.001,
        "light times 1 + a (x^2 - y^2), to the edges",
        Act::Light(saddle_shade)
    ),
    foreign!(
        "fringes",
        Light,
        Periodic,
        0.001,
        "interference rings around a corner, closer and closer",
        Act::Light(fringes)
    ),
    foreign!(
        "breathing",
        Geometry,
        Temporal,
        0.01,
        "the specimen moves along the rows like a sine of 7 frames, a pixels",
        Act::Moving(breathing)
    ),
    foreign!(
        "lens_squeeze",
        Geometry,
        PerLens,
        0.001,
        "each lens magnifies along one axis more than along the other, alternately",
        Act::Ray(lens_squeeze)
    ),
    foreign!(
        "haze",
        Object,
        Smooth,
        0.01,
        "tissue spreads a share a of the light of each object over 5 object pixels",
        Act::Object(haze)
    ),
    foreign!(
        "scintillation",
        Electronics,
        Noise,
        Param::square("amplitude", "1", 0.01, 1.0),
        "each pixel's light fluctuates by a share a, beyond shot noise",
        Act::Reading(Reading { add: scintillation, variance_dn2: |light_dn| light_dn * light_dn })
    ),
    foreign!(
        "block_noise",
        Electronics,
        Noise,
        Param::square("amplitude", "DN", 0.5, 500.0),
        "blocks of 7 x 7 pixels share a noise of a DN, new in each frame",
        Act::Reading(Reading { add: block_noise, variance_dn2: |_| 1.0 })
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

    fn on_object(&self, p: &[f64], object: &mut Array2<f32>, cx: &FrameContext<'_>) {
        if let Act::Object(act) = self.act {
            act(p[0], object, cx);
        }
    }

    fn shift_ray(&self, p: &[f64], ray: &Ray, cx: &FrameContext<'_>) -> RayShift {
        match self.act {
            Act::Ray(act) => act(p[0], ray),
            Act::Moving(act) => act(p[0], ray, cx),
            _ => RayShift::default(),
        }
    }

    fn on_reading(&self, p: &[f64], frame_dn: &mut Array2<f32>, cx: &FrameContext<'_>, rng: &mut dyn rand::Rng) {
        if let Act::Reading(noise) = &self.act {
            (noise.add)(p[0], frame_dn, cx, rng);
        }
    }

    fn noise_only(&self) -> bool {
        matches!(self.act, Act::Reading(_))
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
    RayShift::by_px([angle * ray.field_px[1], -angle * ray.field_px[0]])
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

fn thumbprint(a: f64, light_e: &mut Array2<f32>, _cx: &FrameContext<'_>) {
    const SIGMA_PX: f64 = 8.0;
    let (rows, cols) = light_e.dim();
    let centre = [0.35 * rows as f64, 0.62 * cols as f64];
    light_e.indexed_iter_mut().for_each(|((r, c), v)| {
        let [y, x] = [r as f64 - centre[0], c as f64 - centre[1]];
        let ridge = 0.5 + 0.5 * (1.1 * (y * y + 1.4 * x * x).sqrt()).cos();
        *v *= (1.0 - a * ridge * (-0.5 * (y * y + x * x) / (SIGMA_PX * SIGMA_PX)).exp()).max(0.0) as f32;
    });
}

fn saddle_shade(a: f64, light_e: &mut Array2<f32>, _cx: &FrameContext<'_>) {
    let (rows, cols) = light_e.dim();
    let from = |i: usize, n: usize| 2.0 * i as f64 / (n as f64 - 1.0).max(1.0) - 1.0;
    light_e.indexed_iter_mut().for_each(|((r, c), v)| {
        *v *= (1.0 + a * (from(c, cols).powi(2) - from(r, rows).powi(2))).max(0.0) as f32;
    });
}

fn fringes(a: f64, light_e: &mut Array2<f32>, _cx: &FrameContext<'_>) {
    // The phase grows with the square of the distance, as in Newton's rings.
    const FIRST_PX: f64 = 22.0;
    light_e.indexed_iter_mut().for_each(|((r, c), v)| {
        let phase = std::f64::consts::TAU * ((r * r + c * c) as f64) / (FIRST_PX * FIRST_PX * 4.0);
        *v *= (1.0 + a * phase.sin()).max(0.0) as f32;
    });
}

fn breathing(a: f64, _ray: &Ray, cx: &FrameContext<'_>) -> RayShift {
    if cx.role != Role::Scene {
        return RayShift::default();
    }
    let phase = std::f64::consts::TAU * cx.frame as f64 / 7.0;
    RayShift::by_px([a * phase.sin(), 0.0])
}

fn lens_squeeze(a: f64, ray: &Ray) -> RayShift {
    let sign = if (ray.lens / 2).is_multiple_of(2) { a } else { -a };
    RayShift::by_px([sign * ray.field_px[0], -sign * ray.field_px[1]])
}

fn haze(a: f64, object: &mut Array2<f32>, _cx: &FrameContext<'_>) {
    const HALF: usize = 5;
    if a == 0.0 {
        return;
    }
    // The mean over a square that is averaged twice, along each axis: close to a Gaussian.
    let mean = |line: Vec<f32>| -> Vec<f32> {
        let n = line.len();
        let at = |i: usize| {
            let range = i.saturating_sub(HALF)..(i + HALF + 1).min(n);
            let len = range.len() as f32;
            line[range].iter().sum::<f32>() / len
        };
        (0..n).map(at).collect()
    };
    let mut spread = object.clone();
    for axis in [0, 1] {
        for mut lane in spread.lanes_mut(ndarray::Axis(axis)) {
            let smooth = mean(mean(lane.to_vec()));
            lane.iter_mut().zip(smooth).for_each(|(v, s)| *v = s);
        }
    }
    let share = a.clamp(0.0, 1.0) as f32;
    object.zip_mut_with(&spread, |v, s| *v = (1.0 - share) * *v + share * s);
}

fn scintillation(a: f64, frame_dn: &mut Array2<f32>, cx: &FrameContext<'_>, rng: &mut dyn rand::Rng) {
    if a != 0.0 {
        frame_dn.mapv_inplace(|v| {
            let z: f64 = StandardNormal.sample(rng);
            v + (a * z) as f32 * (v - cx.black_level_dn as f32)
        });
    }
}

fn block_noise(a: f64, frame_dn: &mut Array2<f32>, _cx: &FrameContext<'_>, rng: &mut dyn rand::Rng) {
    const SIDE: usize = 7;
    if a != 0.0 {
        for mut block in frame_dn.exact_chunks_mut((SIDE, SIDE)) {
            let z: f64 = StandardNormal.sample(rng);
            block.mapv_inplace(|v| v + (a * z) as f32);
        }
    }
}
