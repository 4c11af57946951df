//! Effects without a law: a value for each pixel (or spot), estimated from even light and darks.
//!
//! Two halves of the frames give two independent estimates of each value; what they share is real, whatever the noise model says.
//! Even light has no specimen in it, so that no error of the optics enters.

use super::model::{Model, Predicted, State, Term};
use super::stats::two_sided;
use crate::effects::{TableGroup, TableUse, blur_within, registry};
use crate::session::Role;
use ndarray::{Array2, Zip};
use rayon::prelude::*;

/// A table that the data ask for.
#[derive(Clone, Debug)]
pub struct TableFit {
    /// The effect with its estimated table, its first parameter the rms (or largest value) of the table.
    pub term: Term,
    /// Significance, standard deviations.
    pub z: f64,
    /// Probability without the effect.
    pub p: f64,
    /// The first parameter beyond what the calibration leaves, as [`crate::effects::Param::inner`] has it.
    pub size: f64,
    /// What of it would be told at one standard deviation.
    pub size_sigma: f64,
    /// Standard error of the first parameter.
    pub sigma: f64,
}

/// Pixels from which spots are told, standard deviations of their smoothed value.
const SPOT: f32 = 5.0;
/// Radius of the blur that spots are looked for with, pixels.
const SPOT_PX: f64 = 1.5;
/// Blur that a pattern of pixels is told from, standard deviation, pixels: it takes 2 % of a white one.
const SMOOTH_PX: f64 = 2.0;
/// The estimate of a remaining pattern may exceed what the calibration left by this factor before it counts.
const TOLERANCE: f64 = 1.5;

/// An estimate of a table: values and inverse variances.
struct Half {
    value: Array2<f32>,
    weight: Array2<f32>,
}

/// Fits every table effect of the catalogue that is not in the state.
pub fn fit(model: &Model<'_>, state: &State, now: &[Predicted]) -> Vec<TableFit> {
    // What the calibration's own maps leave of a pattern is no news.
    let left = |acts| match acts {
        TableUse::Response => model.maps.response.powi(2),
        TableUse::DarkRate => 0.0,
        TableUse::Offset => model.maps.offset_dn.powi(2),
    };
    registry()
        .par_iter()
        .filter(|e| !state.terms.iter().any(|t| t.id() == e.descriptor().id))
        .filter_map(|e| {
            let kind = e.table()?;
            let halves = [0, 1].map(|h| half(model, now, kind.acts, h));
            let [Some(a), Some(b)] = halves else { return None };
            let found = match kind.group {
                TableGroup::Pixel => pixels(&a, &b, left(kind.acts)),
                TableGroup::SparsePixels => sparse(&a, &b),
                TableGroup::Spots => spots(&a, &b, left(kind.acts)),
            }?;
            let expanded = e.descriptor().expanded(model.lenses());
            let mut params: Vec<f64> = expanded.iter().map(|(_, p)| p.off).collect();
            let first = expanded.first()?.1;
            params[0] = first.outer(found.size);
            Some(TableFit {
                term: Term { effect: *e, params, table: Some(found.table) },
                z: found.z,
                p: two_sided(found.z.max(0.0)) / 2.0,
                size: found.size,
                size_sigma: found.error + found.doubt,
                sigma: first.outer_sigma(found.size, found.error),
            })
        })
        .collect()
}

struct Shape {
    table: Array2<f32>,
    /// Variance of a pattern; value of what stands out most.
    size: f64,
    /// Its standard error.
    error: f64,
    /// How uncertain it is what the calibration leaves of the like.
    doubt: f64,
    z: f64,
}

/// One half of the frames: the weighted mean of `residual / template` at each pixel.
fn half(model: &Model<'_>, now: &[Predicted], acts: TableUse, which: usize) -> Option<Half> {
    let shape = (model.seen.sensor[0], model.seen.sensor[1]);
    let (mut top, mut bottom) = (Array2::<f32>::zeros(shape), Array2::<f32>::zeros(shape));
    let gain = model.forward.noise().gain_dn_per_e as f32;
    for (n, (k, f)) in model.seen.frames.iter().enumerate().filter(|(_, f)| !f.held_out).enumerate() {
        let used = match acts {
            TableUse::Response => f.role == Role::Flat,
            TableUse::DarkRate | TableUse::Offset => matches!(f.role, Role::Flat | Role::Dark),
        };
        if !used || n / 2 % 2 != which {
            continue;
        }
        let here = &now[k];
        let t = f.info.exposure_ms as f32;
        // Lamp and black level of the single frame are no pattern.
        let mean = here.residual_dn.mean().unwrap_or(0.0);
        Zip::from(&mut top)
            .and(&mut bottom)
            .and(&here.residual_dn)
            .and(&here.inverse_sigma)
            .and(&here.light_e)
            .for_each(|top, bottom, r, w, e| {
                let template = match acts {
                    TableUse::Response => gain * e,
                    TableUse::DarkRate => gain * t,
                    TableUse::Offset => 1.0,
                };
                *top += w * w * template * (r - mean);
                *bottom += w * w * template * template;
            });
    }
    if bottom.iter().all(|w| *w <= 0.0) {
        return None;
    }
    let value = Zip::from(&top).and(&bottom).map_collect(|t, b| if *b > 0.0 { t / b } else { 0.0 });
    Some(Half { value, weight: bottom })
}

fn mean(a: &Half, b: &Half) -> Half {
    let weight = &a.weight + &b.weight;
    let mut value = &a.value * &a.weight + &b.value * &b.weight;
    value.zip_mut_with(&weight, |v, w| *v = if *w > 0.0 { *v / w } else { 0.0 });
    Half { value, weight }
}

/// A pattern of all pixels: the variance that both halves share, beyond what the calibration leaves. What is smooth over pixels (shade, spots,
/// a step) is no property of single pixels and is taken out first.
fn pixels(a: &Half, b: &Half, left: f64) -> Option<Shape> {
    let sharp = |h: &Half| Half { value: &h.value - &blur_within(&h.value, SMOOTH_PX), weight: h.weight.clone() };
    let (a, b) = (&sharp(a), &sharp(b));
    let (mut shared, mut noise, mut n) = (0.0, 0.0, 0.0);
    // Hot pixels and dust are other effects: their values stand out, so they are left out here.
    Zip::from(&a.value).and(&b.value).and(&a.weight).and(&b.weight).for_each(|a, b, wa, wb| {
        if *wa > 0.0 && *wb > 0.0 && !(a * wa.sqrt() > 6.0 && b * wb.sqrt() > 6.0) {
            shared += f64::from(a * b);
            noise += 1.0 / (f64::from(*wa) * f64::from(*wb));
            n += 1.0;
        }
    });
    if n < 100.0 {
        return None;
    }
    let variance = shared / n;
    let error = ((noise + 2.0 * variance.abs() * (noise * n).sqrt()).sqrt() + n.sqrt() * variance.abs()) / n;
    let z = (variance - TOLERANCE * left) / error;
    let both = mean(a, b);
    let keep = |v: &f32, w: &f32| {
        let w = f64::from(*w);
        if w > 0.0 { (f64::from(*v) * variance / (variance + 1.0 / w)) as f32 } else { 0.0 }
    };
    let table = Zip::from(&both.value).and(&both.weight).map_collect(keep);
    Some(Shape { table, size: (variance - left).max(0.0), error, doubt: (TOLERANCE - 1.0) * left, z })
}

/// Single pixels that stand out in both halves.
fn sparse(a: &Half, b: &Half) -> Option<Shape> {
    let both = mean(a, b);
    let mut table = Array2::zeros(both.value.dim());
    let (mut largest, mut z) = (0.0f64, 0.0f64);
    // Of a pixel as good as most: what the session could tell, where nothing stands out.
    let weight = f64::from(both.weight.mean().unwrap_or(0.0));
    let mut sigma = if weight > 0.0 { 1.0 / weight.sqrt() } else { 0.0 };
    Zip::indexed(&both.value).and(&both.weight).for_each(|at, v, w| {
        let stands_out = |h: &Half| h.value[at] * h.weight[at].sqrt();
        let least = f64::from(stands_out(a).min(stands_out(b)));
        if least > 4.5 {
            table[at] = *v;
            if f64::from(*v) > largest {
                largest = f64::from(*v);
                sigma = 1.0 / f64::from(*w).sqrt();
            }
            z = z.max(least * std::f64::consts::SQRT_2);
        }
    });
    // As many chances as pixels.
    let chances = both.value.len() as f64;
    let z = if z > 0.0 { super::stats::sigmas((two_sided(z) * chances).min(1.0)) } else { 0.0 };
    Some(Shape { table, size: largest, error: sigma, doubt: 0.0, z })
}

/// Spots: what stands out of a map that is smoothed to their size.
fn spots(a: &Half, b: &Half, left: f64) -> Option<Shape> {
    let smooth = |h: &Half| blur_within(&h.value, SPOT_PX) - blur_within(&h.value, 8.0 * SPOT_PX);
    let (sa, sb) = (smooth(a), smooth(b));
    // What white noise is after the blur: 1 / (4 pi sigma^2) of its variance.
    let share = 1.0 / (4.0 * std::f64::consts::PI * SPOT_PX * SPOT_PX);
    let sigma_of = |h: &Half| {
        let mean = f64::from(h.weight.mean().unwrap_or(0.0));
        (share * (1.0 / mean.max(1e-30) + left)).sqrt() as f32
    };
    let (ea, eb) = (sigma_of(a), sigma_of(b));
    let both = (&sa + &sb) * 0.5;
    let mut core = Array2::from_elem(both.dim(), 0.0f32);
    let (mut deepest, mut z) = (0.0f64, 0.0f64);
    Zip::indexed(&both).for_each(|at, v| {
        let least = (-sa[at] / ea).min(-sb[at] / eb);
        if least > SPOT {
            core[at] = 1.0;
            deepest = deepest.max(-f64::from(*v));
            z = z.max(f64::from(least));
        }
    });
    let chances = both.len() as f64 * share;
    let z = if z > 0.0 { super::stats::sigmas((two_sided(z) * chances).min(1.0)) } else { 0.0 };
    // The spot's own values, from the unsmoothed map, where a core is near.
    let near = blur_within(&core, 2.0 * SPOT_PX);
    let raw = mean(a, b);
    let table = Zip::from(&near).and(&raw.value).map_collect(|n, v| if *n > 0.02 { *v } else { 0.0 });
    Some(Shape { table, size: deepest, error: f64::from(ea.hypot(eb)) / 2.0, doubt: 0.0, z })
}
