//! Maps of the sensor that are estimated from scenes: a factor on their light, or on that of one lens, or light added.
//!
//! The residual of each pixel, divided by what a unit of the map would change, is averaged over neighbourhoods of
//! falling size: rows and columns, then Gaussians, then single pixels that stand out, then all single pixels. Two
//! halves of the frames give two independent estimates. A size is used only as far as the estimate of one half predicts
//! the residual of the other, so that neither noise nor detail of the specimens becomes a map.

use super::stats::{f_tail, sigmas};
use super::tables::TableFit;
use crate::data::Shown;
use crate::fit::{Fitted, Model, Predicted, Scenes, State, Term};
use ndarray::{Array2, Axis, Zip};
use ommatidia_physics::effects::{Effect, TableUse, blur_within, registry};
use rayon::prelude::*;

/// Standard deviations of the Gaussian neighbourhoods as shares of the smaller side of the sensor.
const BROAD: [f64; 2] = [0.25, 0.125];
/// Standard deviations of the smaller neighbourhoods, pixels; those above a twelfth of the side are left out.
const FINE_PX: [f64; 5] = [24.0, 12.0, 6.0, 3.0, 1.5];
/// A neighbourhood is used if the estimate of one half predicts the other by this many standard deviations.
const PREDICTS: f64 = 4.0;
/// A single pixel is used if it deviates by this many standard deviations in each half.
const STANDS_OUT: f32 = 5.0;
/// Fewest training frames: two in each half.
const FRAMES: usize = 4;

/// Which pixels share a value.
#[derive(Clone, Copy)]
enum Near {
    Row,
    Column,
    Gauss(f64),
    Itself,
    Alone,
}

/// What a unit of a map changes.
#[derive(Clone, Copy)]
struct Acts<'a> {
    acts: TableUse,
    /// For each frame the light through the lens that has the map, electrons; empty where all lenses have it.
    view_e: &'a [Option<Array2<f32>>],
}

impl Acts<'_> {
    /// Change of frame `k` by a unit of the map, DN at each pixel.
    fn template(&self, model: &Model<'_>, here: &Predicted, k: usize) -> Array2<f32> {
        let gain = model.forward.noise().gain_dn_per_e as f32;
        let even = |v: f32| Array2::from_elem(here.light_e.dim(), v);
        match (self.acts, self.view_e.get(k)) {
            (TableUse::SceneView, Some(Some(view_e))) => view_e * gain,
            (TableUse::SceneView, _) => even(0.0),
            (TableUse::SceneResponse, _) => &here.light_e * gain,
            (TableUse::SceneRate, _) => even(gain * model.seen.frames[k].info.exposure_ms as f32),
            (TableUse::SceneStray, _) => even(gain * here.light_e.mean().unwrap_or(0.0)),
            _ => even(1.0),
        }
    }
}

/// Sums over frames at each pixel: score `sum w^2 t r` and information `sum w^2 t^2`, for residuals r, the change t by
/// a unit of the map, and inverse standard deviations w. [sensor rows, sensor cols].
#[derive(Clone)]
struct Sums {
    score: Array2<f32>,
    information: Array2<f32>,
}

impl Sums {
    /// The score that is left beside a map.
    fn beside(&self, map: &Array2<f32>) -> Array2<f32> {
        &self.score - &(&self.information * map)
    }

    fn of(model: &Model<'_>, now: &[Predicted], acts: Acts<'_>, frames: &[usize]) -> Self {
        let shape = (model.seen.sensor[0], model.seen.sensor[1]);
        let mut sums = Self { score: Array2::zeros(shape), information: Array2::zeros(shape) };
        for k in frames {
            let here = &now[*k];
            let template = acts.template(model, here, *k);
            Zip::from(&mut sums.score)
                .and(&mut sums.information)
                .and(&here.residual_dn)
                .and(&here.inverse_sigma)
                .and(&template)
                .for_each(|score, information, r, w, template| {
                    *score += w * w * template * r;
                    *information += w * w * template * template;
                });
        }
        sums
    }
}

fn dot(a: &Array2<f32>, b: &Array2<f32>) -> f64 {
    Zip::from(a).and(b).fold(0.0, |sum, a, b| sum + f64::from(a * b))
}

/// `sum information map^2`.
fn power(information: &Array2<f32>, map: &Array2<f32>) -> f64 {
    Zip::from(information).and(map).fold(0.0, |sum, i, u| sum + f64::from(i * u * u))
}

/// What maps are estimated beside: a state, the light of its objects behind the optics, and the frames as predicted
/// from them.
#[derive(Clone, Copy)]
pub(crate) struct Beside<'a> {
    pub(crate) state: &'a State,
    pub(crate) scenes: &'a Scenes,
    pub(crate) predicted: &'a [Predicted],
}

impl<'a> Beside<'a> {
    /// A fit.
    pub(crate) fn of(fit: &'a Fitted) -> Self {
        Self { state: &fit.state, scenes: &fit.scenes, predicted: &fit.predicted }
    }

    /// For each of some frames the light through a lens, electrons.
    fn view_e(self, model: &Model<'_>, lens: usize, frames: &[usize]) -> Vec<Option<Array2<f32>>> {
        let chain = model.chain(&self.state.terms);
        let mut out = vec![None; self.predicted.len()];
        for k in frames {
            let view = |scene| model.lens_e(*k, scene, lens, &chain, self.state) * self.predicted[*k].scale as f32;
            out[*k] = self.scenes[*k].as_ref().map(view);
        }
        out
    }
}

/// Estimates the unnamed maps of scenes that are not in the state.
pub(crate) fn fit(model: &Model<'_>, now: Beside<'_>) -> Vec<TableFit> {
    let open = |e: &&&'static dyn Effect| !now.state.terms.iter().any(|t| t.id() == e.descriptor().id);
    registry().par_iter().filter(open).filter_map(|e| one(model, *e, now)).collect()
}

/// Estimates the map of an effect from scenes: of a map that one lens has, that of the lens which gains most. None: it
/// has no such map, or the scenes do not show one.
pub(crate) fn one(model: &Model<'_>, effect: &'static dyn Effect, now: Beside<'_>) -> Option<TableFit> {
    let acts = effect.table().filter(|kind| kind.acts.of_scenes())?.acts;
    let known = |shown: &Shown| matches!(shown, Shown::Object(_) | Shown::Bead(_));
    let frames = &model.seen.frames;
    let training: Vec<usize> = (0..frames.len()).filter(|k| known(&frames[*k].shown) && !frames[*k].held_out).collect();
    let judged = frames.iter().any(|f| known(&f.shown) && f.held_out);
    if training.len() < FRAMES || !judged {
        return None;
    }
    let expanded = effect.descriptor().expanded(model.lenses());
    let mut params: Vec<f64> = expanded.iter().map(|(_, p)| p.off).collect();
    let first = expanded.first()?.1;
    let found = match acts {
        TableUse::SceneView if model.lenses() < 2 => return None,
        TableUse::SceneView => {
            let of_lens = |lens: usize| {
                let view_e = now.view_e(model, lens, &training);
                Some((lens, estimate(model, now.predicted, Acts { acts, view_e: &view_e }, &training)?))
            };
            let all: Vec<(usize, Found)> = (0..model.lenses()).into_par_iter().filter_map(of_lens).collect();
            let (lens, found) = all.into_iter().max_by(|a, b| a.1.gain.total_cmp(&b.1.gain))?;
            *params.get_mut(1)? = lens as f64;
            found.among(model.lenses())
        }
        _ => estimate(model, now.predicted, Acts { acts, view_e: &[] }, &training)?,
    };
    params[0] = first.outer(found.variance);
    let size_sigma = found.variance / found.z.max(1.0);
    Some(TableFit {
        term: Term { effect, params, table: Some(found.map), table_error: 0.0 },
        z: found.z,
        p: found.p,
        size: found.variance,
        size_sigma,
        sigma: first.outer_sigma(found.variance, size_sigma),
        gain: found.gain,
        of_scenes: true,
    })
}

struct Found {
    map: Array2<f32>,
    /// Mean square of the map.
    variance: f64,
    /// Expected fall of chi-squared, as each half predicts it for the other.
    gain: f64,
    z: f64,
    p: f64,
}

impl Found {
    /// As the best of so many, of which noise makes one look good.
    fn among(self, chances: usize) -> Self {
        let p = (self.p * chances as f64).min(1.0);
        Self { p, z: sigmas((2.0 * p).min(1.0)), ..self }
    }
}

fn estimate(model: &Model<'_>, now: &[Predicted], acts: Acts<'_>, training: &[usize]) -> Option<Found> {
    // Pairs of frames stay together, since effects of the preceding frame come in pairs.
    let halves = [0, 1].map(|h| -> Vec<usize> {
        training.iter().enumerate().filter(|(n, _)| n / 2 % 2 == h).map(|(_, k)| *k).collect()
    });
    let sums = [0, 1].map(|h| Sums::of(model, now, acts, &halves[h]));
    let shape = sums[0].score.dim();
    let mut maps = [Array2::<f32>::zeros(shape), Array2::zeros(shape)];
    let mut whole = Array2::<f32>::zeros(shape);
    let side = shape.0.min(shape.1) as f64;
    let fine = FINE_PX.into_iter().filter(|px| *px <= side / 12.0).map(Near::Gauss);
    let sizes = [Near::Row, Near::Column].into_iter().chain(BROAD.map(|b| Near::Gauss(b * side))).chain(fine);
    for near in sizes.chain([Near::Alone, Near::Itself]) {
        let left = [0, 1].map(|h| sums[h].beside(&maps[h]));
        let mut more = [0, 1].map(|h| average(&left[h], &sums[h].information, near));
        let information = &sums[0].information + &sums[1].information;
        let mut both = average(&(&left[0] + &left[1]), &information, near);
        if matches!(near, Near::Alone) {
            let out = outliers(&left, &sums);
            more.iter_mut().chain([&mut both]).for_each(|m| *m *= &out);
        }
        // What the estimate of one half explains in the other.
        let top = dot(&more[0], &sums[1].beside(&maps[0])) + dot(&more[1], &sums[0].beside(&maps[1]));
        let bottom = power(&sums[1].information, &more[0]) + power(&sums[0].information, &more[1]);
        if bottom <= 0.0 || top < PREDICTS * bottom.sqrt() {
            continue;
        }
        let share = (top / bottom).min(1.0);
        for (map, more) in maps.iter_mut().zip(&more) {
            map.scaled_add(share as f32, more);
        }
        // Both halves together have half the noise.
        whole.scaled_add((2.0 * share / (1.0 + share)) as f32, &both);
    }
    let information: f64 = sums.iter().map(|s| s.information.iter().map(|v| f64::from(*v)).sum::<f64>()).sum();
    let variance = sums.iter().map(|s| power(&s.information, &whole)).sum::<f64>() / information.max(1e-30);
    if variance <= 0.0 {
        return None;
    }
    let [top, bottom] = cross(model, now, acts, &halves, &maps);
    let gain = 2.0 * top.iter().sum::<f64>() - bottom.iter().sum::<f64>();
    // The scatter of the frames: each tells by itself how much of the map it holds.
    let (s, q) = (top.iter().sum::<f64>(), bottom.iter().sum::<f64>());
    let share = s / q.max(1e-30);
    let n = top.len() as f64;
    let scatter = top.iter().zip(&bottom).map(|(t, b)| (t - share * b).powi(2)).sum::<f64>() * n / (n - 1.0);
    let t = s / (q + scatter).sqrt();
    let p = if t > 0.0 { f_tail(t * t, 1.0, n - 1.0) / 2.0 } else { 1.0 };
    Some(Found { map: whole, variance, gain, z: sigmas((2.0 * p).min(1.0)), p })
}

/// For each training frame, the score of the map that the other half gave, and its information.
fn cross(
    model: &Model<'_>,
    now: &[Predicted],
    acts: Acts<'_>,
    halves: &[Vec<usize>; 2],
    maps: &[Array2<f32>; 2],
) -> [Vec<f64>; 2] {
    let mut out = [Vec::new(), Vec::new()];
    for (map, frames) in maps.iter().zip(halves.iter().rev()) {
        for k in frames {
            let one = Sums::of(model, now, acts, &[*k]);
            out[0].push(dot(&one.score, map));
            out[1].push(power(&one.information, map));
        }
    }
    out
}

/// Mean of `score / information` over the neighbourhood of each pixel, weighted with the information.
fn average(score: &Array2<f32>, information: &Array2<f32>, near: Near) -> Array2<f32> {
    let over = |image: &Array2<f32>| match near {
        Near::Row => image.sum_axis(Axis(1)).insert_axis(Axis(1)),
        Near::Column => image.sum_axis(Axis(0)).insert_axis(Axis(0)),
        Near::Gauss(px) => blur_within(image, px),
        Near::Itself | Near::Alone => image.clone(),
    };
    let (top, bottom) = (over(score), over(information));
    // A neighbourhood with hardly any light says nothing.
    let least = 1e-4 * bottom.mean().unwrap_or(0.0);
    let mean = Zip::from(&top).and(&bottom).map_collect(|t, b| if *b > least { t / b } else { 0.0 });
    mean.broadcast(score.dim()).map(|m| m.to_owned()).unwrap_or_else(|| Array2::zeros(score.dim()))
}

/// 1 at pixels that deviate by themselves in both halves, in the same direction.
fn outliers(left: &[Array2<f32>; 2], sums: &[Sums; 2]) -> Array2<f32> {
    let pull = [0, 1].map(|h| {
        Zip::from(&left[h]).and(&sums[h].information).map_collect(|s, i| if *i > 0.0 { s / i.sqrt() } else { 0.0 })
    });
    // The scatter of the other pixels may exceed the noise.
    let scatter = pull.each_ref().map(|p| {
        let mut sizes: Vec<f32> = p.iter().map(|v| v.abs()).collect();
        sizes.sort_unstable_by(f32::total_cmp);
        // The median absolute value of a normal variable is 0.674 of its standard deviation.
        sizes.get(sizes.len() / 2).map_or(1.0, |v| (v / 0.674).max(1.0))
    });
    Zip::from(&pull[0]).and(&pull[1]).map_collect(|a, b| {
        let (a, b) = (a / scatter[0], b / scatter[1]);
        if a * b > 0.0 && a.abs().min(b.abs()) > STANDS_OUT { 1.0 } else { 0.0 }
    })
}
