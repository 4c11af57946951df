//! Estimates unknown specimens from their frames.
//!
//! Richardson-Lucy with the read noise as a constant light (Snyder et al., J. Opt. Soc. Am. A 10, 1014, 1993), on the
//! pixels of the training blocks. The estimate shapes the signatures of the effects and the weights of the pixels; no
//! residual depends on it, since everything that a change of the specimen can make is taken out of the residuals.

use crate::fit::projection::{LANES, Views};
use ndarray::Array2;

/// Number of iterations: later ones fit noise.
const ITERATIONS: usize = 25;
/// Iterations before the light outside the windows is first found.
pub(super) const BEFORE_STRAY: usize = 10;
/// Iterations after each time that it is found.
pub(super) const AFTER_STRAY: usize = 5;

/// Object pixels with less light on the sensor, relative to the brightest, are not estimated.
const LEAST: f32 = 1e-3;

/// An estimated specimen.
pub(super) struct Estimate {
    /// [object rows, object cols].
    pub(super) object: Array2<f32>,
    /// Light of its pixels that are not known on the sensor, electrons, [sensor rows, sensor cols].
    pub(super) light_e: Array2<f32>,
}

/// An estimate of the specimens of some frames that can go on from where it stands.
pub(super) struct Estimation<'a> {
    views: &'a Views,
    /// Positive at the pixels that count, [sensor pixels].
    weight: &'a [f32],
    /// Variance of the read noise, electrons squared.
    floor_e2: f32,
    /// Specimens, each [object pixels that are not known].
    objects: Vec<Vec<f32>>,
    /// What the other object pixels hold, [object rows, object cols].
    beside: &'a [Array2<f32>],
    /// Iterations that were made.
    done: usize,
}

impl<'a> Estimation<'a> {
    /// Begins with even specimens of frames whose objects hold `beside` outside of the pixels that are estimated.
    pub(super) fn new(views: &'a Views, weight: &'a [f32], floor_e2: f32, beside: &'a [Array2<f32>]) -> Self {
        let mut it = Self { views, weight, floor_e2, objects: Vec::new(), beside, done: 0 };
        it.begin_again();
        it
    }

    /// Goes on for so many iterations. `frames_e` are the frames without their dark signal, electrons, [sensor rows,
    /// sensor cols].
    pub(super) fn go_on(&mut self, frames_e: &[Array2<f32>], iterations: usize) {
        for (frames, objects) in frames_e.chunks(LANES).zip(self.objects.chunks_mut(LANES)) {
            let of = (self.views, self.weight, self.floor_e2);
            match frames.len() {
                ..=8 => iterate::<8>(of, frames, objects, iterations),
                _ => iterate::<LANES>(of, frames, objects, iterations),
            }
        }
        self.done += iterations;
    }

    /// Begins again, with even specimens. Pixels that are seen by their tails alone stay as they are beside: hardly
    /// anything of them is seen.
    pub(super) fn begin_again(&mut self) {
        let cols = self.views.object()[1];
        let begin = |beside: &Array2<f32>| {
            let of = |(x, p): (usize, &u32)| match self.views.is_tail(x) {
                true => beside[[*p as usize / cols, *p as usize % cols]],
                false => 1.0,
            };
            self.views.pixels().iter().enumerate().map(of).collect()
        };
        self.objects = self.beside.iter().map(begin).collect();
        self.done = 0;
    }

    /// Makes what is left of the iterations.
    pub(super) fn finish(&mut self, frames_e: &[Array2<f32>]) {
        self.go_on(frames_e, ITERATIONS.saturating_sub(self.done));
    }

    /// The specimens as they are.
    pub(super) fn estimates(&self) -> Vec<Estimate> {
        let of = |(objects, beside): (&[Vec<f32>], _)| match objects.len() {
            ..=8 => seen::<8>(self.views, objects, beside),
            _ => seen::<LANES>(self.views, objects, beside),
        };
        self.objects.chunks(LANES).zip(self.beside.chunks(LANES)).flat_map(of).collect()
    }
}

/// Iterations of Richardson-Lucy for at most L frames at once.
fn iterate<const L: usize>(
    (views, weight, floor_e2): (&Views, &[f32], f32),
    frames_e: &[Array2<f32>],
    found: &mut [Vec<f32>],
    iterations: usize,
) {
    let mut measured: Vec<[f32; L]> = vec![[0.0; L]; weight.len()];
    for (lane, frame) in frames_e.iter().enumerate() {
        measured.iter_mut().zip(frame).for_each(|(m, y)| m[lane] = (y + floor_e2).max(0.0));
    }
    let used: Vec<[f32; L]> = weight.iter().map(|w| [f32::from(u8::from(*w > 0.0)); L]).collect();
    // Low-rank PSFs have small negative values; object pixels with hardly any light on the sensor stay dark.
    let seen = views.adjoint(&used);
    let least = seen.iter().map(|s| s[0]).fold(0.0f32, f32::max) * LEAST;
    let mut objects: Vec<[f32; L]> = interleaved(found, views.pixels().len());
    for _ in 0..iterations {
        let mut ratio = views.forward(&objects);
        for ((r, m), u) in ratio.iter_mut().zip(&measured).zip(&used) {
            r.iter_mut().zip(m).zip(u).for_each(|((r, m), u)| *r = u * m / (r.max(0.0) + floor_e2));
        }
        let back = views.adjoint(&ratio);
        let all = objects.iter_mut().zip(&back).zip(&seen).enumerate();
        for (_, ((x, b), s)) in all.filter(|(x, _)| !views.is_tail(*x)) {
            x.iter_mut().zip(b).zip(s).for_each(|((x, b), s)| *x = if *s > least { *x * b.max(0.0) / s } else { 0.0 });
        }
    }
    for (lane, found) in found.iter_mut().enumerate() {
        found.iter_mut().zip(&objects).for_each(|(found, x)| *found = x[lane]);
    }
}

/// Specimens with their light on the sensor, at most L.
fn seen<const L: usize>(views: &Views, objects: &[Vec<f32>], beside: &[Array2<f32>]) -> Vec<Estimate> {
    let light = views.forward(&interleaved::<L>(objects, views.pixels().len()));
    let cols = views.object()[1];
    let image = |(lane, (unknown, beside)): (usize, (&Vec<f32>, &Array2<f32>))| {
        let mut object = beside.clone();
        for (p, v) in views.pixels().iter().zip(unknown) {
            object[[*p as usize / cols, *p as usize % cols]] = *v;
        }
        let light_of = |(r, c): (usize, usize)| light[r * views.sensor()[1] + c][lane];
        Estimate { object, light_e: Array2::from_shape_fn((views.sensor()[0], views.sensor()[1]), light_of) }
    };
    objects.iter().zip(beside).enumerate().map(image).collect()
}

/// Objects of `pixels` pixels, side by side pixel by pixel; what is left of L is dark.
fn interleaved<const L: usize>(objects: &[Vec<f32>], pixels: usize) -> Vec<[f32; L]> {
    let mut out = vec![[0.0; L]; pixels];
    for (lane, object) in objects.iter().enumerate() {
        out.iter_mut().zip(object).for_each(|(out, v)| out[lane] = *v);
    }
    out
}
