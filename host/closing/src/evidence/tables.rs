//! Effects with a table: a value for each pixel, or for spots, estimated from flats and darks.
//!
//! Two halves of the frames give two independent estimates of each value. Only what both have in common counts, which
//! does not rest on the noise model. Flats show no object, so errors of the optics do not enter.

use super::stats::{sigmas, two_sided};
use crate::fit::{Model, Predicted, State, Term};
use ndarray::{Array2, Axis, Zip, s};
use ommatidia_physics::effects::{Effect, Table, TableGroup, TableUse, blur_within, registry};
use ommatidia_session::Role;
use rayon::prelude::*;

/// An estimated table.
#[derive(Clone, Debug)]
pub struct TableFit {
    /// The effect with its estimated table; its first parameter is the rms or the largest value of the table.
    pub term: Term,
    /// Significance, standard deviations.
    pub z: f64,
    /// Probability of a larger value if the effect is absent.
    pub p: f64,
    /// The first parameter less the error of the calibration's maps, in the unit of
    /// [`ommatidia_physics::effects::Param::inner`].
    pub size: f64,
    /// Standard error of `size`, with the uncertainty of that map error.
    pub size_sigma: f64,
    /// Standard error of the first parameter.
    pub sigma: f64,
    /// Expected fall of chi-squared.
    pub gain: f64,
    /// Whether it was estimated from scenes ([`TableUse::of_scenes`]).
    pub of_scenes: bool,
}

/// Threshold of spots in the smoothed map, standard deviations.
const SPOT: f32 = 5.0;
/// Pixels beyond this are no part of a pattern of all pixels, standard deviations in each half.
const FAR_OUT: f32 = 6.0;
/// Standard deviation of the Gaussian blur for the detection of spots, pixels.
const SPOT_PX: f64 = 1.5;
/// Standard deviation of the Gaussian blur that is subtracted to test for a pattern of single pixels, pixels.
const SMOOTH_PX: f64 = 2.0;
/// The same for the table of the pattern, which keeps coarser structure.
const BROAD_PX: f64 = 8.0;
/// A pattern counts if its variance exceeds that of the map errors by this factor.
const TOLERANCE: f64 = 1.5;

/// An estimate of a table: values, inverse variances by the noise model, and by what factor the frames scatter more
/// than that around the value, 1 or more.
struct Half {
    value: Array2<f32>,
    weight: Array2<f32>,
    scatter: Array2<f32>,
    /// Number of frames, each counted by its share of the weight.
    frames: f64,
}

/// Variance of the errors of the calibration's maps, which the frames show as a pattern as well.
fn left(model: &Model<'_>, acts: TableUse) -> f64 {
    match acts {
        TableUse::Response => model.maps.response.powi(2),
        TableUse::Offset => model.maps.offset_dn.powi(2),
        TableUse::DarkRate => (model.maps.offset_dn / dn_per_rate(model)).powi(2),
        _ => 0.0,
    }
}

/// What a unit of a dark rate adds to the dark of the shortest exposure, DN per e-/ms.
fn dn_per_rate(model: &Model<'_>) -> f64 {
    let used = model.seen.frames.iter().filter(|f| f.role == Role::Dark);
    let shortest = used.map(|f| f.info.exposure_ms).filter(|t| *t > 0.0).fold(f64::INFINITY, f64::min);
    model.forward.noise().gain_dn_per_e * shortest
}

/// Whether a table is estimated from frames of a role. Scenes have maps of their own. Of a dark signal of all pixels
/// flats say little, since their lamp may have changed.
fn shows(role: Role, kind: Table) -> bool {
    match (kind.acts, kind.group) {
        (TableUse::Response, _) => role == Role::Flat,
        (TableUse::DarkRate, TableGroup::Pattern) => role == Role::Dark,
        (TableUse::DarkRate | TableUse::Offset, _) => matches!(role, Role::Flat | Role::Dark),
        _ => false,
    }
}

/// Estimates every effect with a table that is not in the state: those of the catalogue (`named`), or those without a
/// name.
pub fn fit(model: &Model<'_>, state: &State, now: &[Predicted], named: bool) -> Vec<TableFit> {
    registry()
        .par_iter()
        .filter(|e| e.descriptor().id.starts_with("unknown") != named)
        .filter(|e| !state.terms.iter().any(|t| t.id() == e.descriptor().id))
        .filter_map(|e| estimated(model, *e, now, jumping(state)))
        .collect()
}

/// Estimates the table of an effect from flats and darks. None: it has no such table, or the frames do not show one.
pub(crate) fn one(model: &Model<'_>, effect: &'static dyn Effect, now: &[Predicted]) -> Option<TableFit> {
    estimated(model, effect, now, 0.0)
}

/// Share of the pixels that jump between two levels under a state.
fn jumping(state: &State) -> f64 {
    let share = |t: &Term| {
        let params = t.effect.descriptor().params.iter();
        params.zip(&t.params).find(|(p, _)| p.name == "share").map(|(_, v)| *v)
    };
    state.terms.iter().filter(|t| t.effect.makes_wings()).filter_map(share).sum()
}

/// As [`one`], where a share of the pixels is known to jump between two levels.
fn estimated(model: &Model<'_>, effect: &'static dyn Effect, now: &[Predicted], jumping: f64) -> Option<TableFit> {
    let kind = effect.table().filter(|kind| !kind.acts.of_scenes())?;
    let halves = [0, 1].map(|h| half(model, now, kind, h));
    let [Some(a), Some(b)] = halves else { return None };
    let found = match kind.group {
        TableGroup::Pixel => {
            let single = outliers(&a, &b);
            let [fine, broad] = [SMOOTH_PX, BROAD_PX].map(|px| [&a, &b].map(|h| sharp(h, &single, px)));
            let of = |[a, b]: &[Half; 2], smooth_px| pattern(a, b, &single, left(model, kind.acts), kept(smooth_px));
            // Tested with a fine blur subtracted; the table keeps everything finer than shading.
            let found = of(&fine, SMOOTH_PX).filter(|_| is_white(&fine[0], &fine[1]));
            found.and_then(|f| Some(Shape { table: of(&broad, BROAD_PX)?.table, ..f }))
        }
        TableGroup::SparsePixels => single::sparse(&a, &b, jumping),
        TableGroup::Spots => spots(&a, &b, left(model, kind.acts)),
        TableGroup::Pattern | TableGroup::Scales => pattern(&a, &b, &single::hot(&a, &b), left(model, kind.acts), 1.0),
    }?;
    let expanded = effect.descriptor().expanded(model.lenses());
    let mut params: Vec<f64> = expanded.iter().map(|(_, p)| p.off).collect();
    let first = expanded.first()?.1;
    params[0] = first.outer(found.size);
    Some(TableFit {
        term: Term { effect, params, table: Some(found.table), table_error: found.table_error },
        z: found.z,
        p: two_sided(found.z.max(0.0)) / 2.0,
        size: found.size,
        size_sigma: found.error + found.doubt,
        sigma: first.outer_sigma(found.size, found.error),
        gain: found.z * found.z.abs(),
        of_scenes: false,
    })
}

/// Significance of a pattern common to two halves of the flats and darks: of the response, of the offset. None: too few
/// frames.
pub(crate) fn shared(model: &Model<'_>, now: &[Predicted]) -> [Option<f64>; 2] {
    [TableUse::Response, TableUse::Offset].map(|acts| {
        let [Some(a), Some(b)] = [0, 1].map(|h| half(model, now, Table { acts, group: TableGroup::Pattern }, h)) else {
            return None;
        };
        Some(pattern(&a, &b, &single::hot(&a, &b), left(model, acts), 1.0)?.z)
    })
}

struct Shape {
    table: Array2<f32>,
    /// Variance of a pattern, or depth or scale of spots and hot pixels.
    size: f64,
    /// Its standard error.
    error: f64,
    /// Uncertainty of the map errors that were subtracted.
    doubt: f64,
    /// Rms error of the table.
    table_error: f64,
    z: f64,
}

/// One half of the frames: the weighted mean of `residual / template` at each pixel.
fn half(model: &Model<'_>, now: &[Predicted], kind: Table, which: usize) -> Option<Half> {
    let shape = (model.seen.sensor[0], model.seen.sensor[1]);
    let (mut top, mut bottom) = (Array2::<f32>::zeros(shape), Array2::<f32>::zeros(shape));
    let (mut squares, mut count) = (Array2::<f32>::zeros(shape), 0.0f32);
    let mut weights = [0.0f64; 2];
    let gain = model.forward.noise().gain_dn_per_e as f32;
    for (n, (k, f)) in model.seen.frames.iter().enumerate().filter(|(_, f)| !f.held_out).enumerate() {
        if !shows(f.role, kind) || n / 2 % 2 != which {
            continue;
        }
        let here = &now[k];
        let t = f.info.exposure_ms as f32;
        // The mean of a single frame depends on lamp and black level and is no pattern.
        let mean = here.residual_dn.mean().unwrap_or(0.0);
        count += 1.0;
        let before = bottom.sum();
        Zip::from(&mut squares)
            .and(&here.residual_dn)
            .and(&here.inverse_sigma)
            .for_each(|squares, r, w| *squares += (w * (r - mean)).powi(2));
        Zip::from(&mut top)
            .and(&mut bottom)
            .and(&here.residual_dn)
            .and(&here.inverse_sigma)
            .and(&here.light_e)
            .for_each(|top, bottom, r, w, e| {
                let template = match kind.acts {
                    TableUse::Response => gain * e,
                    TableUse::DarkRate => gain * t,
                    _ => 1.0,
                };
                *top += w * w * template * (r - mean);
                *bottom += w * w * template * template;
            });
        let own = f64::from(bottom.sum() - before);
        weights = [weights[0] + own, weights[1] + own * own];
    }
    if bottom.iter().all(|w| *w <= 0.0) {
        return None;
    }
    let value = Zip::from(&top).and(&bottom).map_collect(|t, b| if *b > 0.0 { t / b } else { 0.0 });
    let around = |s: &f32, v: &f32, w: &f32| ((s - v * v * w) / (count - 1.0).max(1.0)).max(1.0);
    let scatter = Zip::from(&squares).and(&value).and(&bottom).map_collect(around);
    Some(Half { value, weight: bottom, scatter, frames: weights[0].powi(2) / weights[1].max(1e-30) })
}

/// Subtracts a linear slope over the sensor, which a blur would turn into structure at the edges.
fn level(h: &Half) -> Half {
    let (rows, cols) = h.value.dim();
    let along = |i: usize, n: usize| i as f32 - (n as f32 - 1.0) / 2.0;
    let (mut top, mut bottom) = ([0.0f64; 2], [0.0f64; 2]);
    for ((r, c), v) in h.value.indexed_iter() {
        for (i, x) in [along(r, rows), along(c, cols)].into_iter().enumerate() {
            top[i] += f64::from(x * v);
            bottom[i] += f64::from(x * x);
        }
    }
    let slope = [0, 1].map(|i| (top[i] / f64::max(bottom[i], 1e-30)) as f32);
    let mut value = h.value.clone();
    Zip::indexed(&mut value).for_each(|(r, c), v| *v -= slope[0] * along(r, rows) + slope[1] * along(c, cols));
    Half { value, weight: h.weight.clone(), scatter: h.scatter.clone(), frames: h.frames }
}

fn mean(a: &Half, b: &Half) -> Half {
    let weight = &a.weight + &b.weight;
    let mut value = &a.value * &a.weight + &b.value * &b.weight;
    value.zip_mut_with(&weight, |v, w| *v = if *w > 0.0 { *v / w } else { 0.0 });
    Half { value, weight, scatter: Array2::ones(a.value.dim()), frames: a.frames + b.frames }
}

/// Subtracts the smooth part: shading, spots and steps are no properties of single pixels. The pixels of `single` have
/// no part in it: a hot pixel would leave its mark on all its neighbours.
fn sharp(h: &Half, single: &Array2<bool>, smooth_px: f64) -> Half {
    let flat = level(h);
    let share = blur_within(&single.mapv(|out| f32::from(!out)), smooth_px);
    let mut smooth = flat.value.clone();
    smooth.zip_mut_with(single, |v, out| *v = if *out { 0.0 } else { *v });
    let smooth = blur_within(&smooth, smooth_px);
    let value = Zip::from(&flat.value).and(&smooth).and(&share).map_collect(|v, s, n| v - s / n.max(1e-3));
    Half { value, ..flat }
}

/// Pixels that stand out in both halves from their noise and from the scatter of all pixels, to the same side.
fn outliers(a: &Half, b: &Half) -> Array2<bool> {
    let scatter = scatter(&mean(a, b).value);
    let in_sigmas = |v: f32, w: f32| if w > 0.0 { v / (1.0 / w + scatter).sqrt() } else { 0.0 };
    Zip::from(&a.value).and(&b.value).and(&a.weight).and(&b.weight).map_collect(|va, vb, wa, wb| {
        let [za, zb] = [in_sigmas(*va, *wa), in_sigmas(*vb, *wb)];
        za.min(zb) > FAR_OUT || za.max(zb) < -FAR_OUT
    })
}

/// Variance of most of the values of a map. The median absolute value of a normal variable is 0.674 of its standard
/// deviation.
fn scatter(map: &Array2<f32>) -> f32 {
    let mut sizes: Vec<f32> = map.iter().map(|v| v.abs()).collect();
    let middle = sizes.len() / 2;
    if sizes.is_empty() { 0.0 } else { (*sizes.select_nth_unstable_by(middle, f32::total_cmp).1 / 0.674).powi(2) }
}

/// Share of a white pattern's variance that [`sharp`] keeps: `1 - 2 g(0) + sum g^2` of a Gaussian g.
fn kept(smooth_px: f64) -> f64 {
    1.0 - 3.0 / (4.0 * std::f64::consts::PI * smooth_px * smooth_px)
}

/// Whether the pattern common to two halves is white after [`sharp`], as properties of single pixels are. Shading or
/// spots correlate neighbours.
fn is_white(a: &Half, b: &Half) -> bool {
    let (rows, cols) = a.value.dim();
    let together = |dr: usize, dc: usize| -> [f64; 2] {
        let (here, there) = (s![..rows - dr, ..cols - dc], s![dr.., dc..]);
        let mut sum = [0.0; 2];
        for (a, b) in [(&a.value, &b.value), (&b.value, &a.value)] {
            for (x, y) in a.slice(here).iter().zip(b.slice(there)) {
                let v = f64::from(x * y);
                sum[0] += v;
                sum[1] += v * v;
            }
        }
        sum
    };
    if rows < 3 || cols < 3 {
        return false;
    }
    let [own, _] = together(0, 0);
    // The subtracted blur correlates the neighbours of a white pattern by -0.06.
    [(0, 1), (1, 0), (1, 1), (0, 2), (2, 0)].iter().all(|(dr, dc)| {
        let [sum, squares] = together(*dr, *dc);
        sum < 0.1 * own.max(0.0) + 3.0 * squares.sqrt()
    })
}

/// What noise that the pixels of a row share, and of a column, adds to the variance of `sum a b`: for `lines` lines of
/// n pixels, which share the variance s^2 of each half, `lines n^2 s^4`. s^2 is what the means of the lines of `a - b`
/// scatter more than those of single pixels do; the pattern itself is in both halves alike.
fn by_lines(a: &Half, b: &Half) -> f64 {
    let differ = &a.value - &b.value;
    let of_noise = Zip::from(&a.weight)
        .and(&b.weight)
        .map_collect(|a, b| if *a > 0.0 && *b > 0.0 { 1.0 / a + 1.0 / b } else { 0.0 });
    let along = |axis: usize| {
        let (n, lines) = (differ.len_of(Axis(axis)) as f64, differ.len_of(Axis(1 - axis)) as f64);
        let square = |sum: &f32| (f64::from(*sum) / n).powi(2);
        let seen = differ.sum_axis(Axis(axis)).iter().map(square).sum::<f64>() / lines.max(1.0);
        let of_pixels = of_noise.iter().map(|v| f64::from(*v)).sum::<f64>() / (n * n * lines).max(1.0);
        lines * (n * (seen - of_pixels).max(0.0) / 2.0).powi(2)
    };
    along(0) + along(1)
}

/// A pattern of all pixels but those of `single`: the variance common to both halves, beyond that of the map errors
/// (`left`). `kept` is the share of a white pattern's variance that the halves hold.
fn pattern(a: &Half, b: &Half, single: &Array2<bool>, left: f64, kept: f64) -> Option<Shape> {
    let (mut shared, mut noise, mut n) = (0.0, 0.0, 0.0);
    Zip::from(&a.value).and(&b.value).and(&a.weight).and(&b.weight).and(single).for_each(|a, b, wa, wb, single| {
        if *wa > 0.0 && *wb > 0.0 && !single {
            shared += f64::from(a * b);
            noise += 1.0 / (f64::from(*wa) * f64::from(*wb));
            n += 1.0;
        }
    });
    if n < 100.0 {
        return None;
    }
    let noise = noise + by_lines(a, b);
    let (variance, noise) = (shared / n / kept, noise / (kept * kept));
    let error = ((noise + 2.0 * variance.abs() * (noise * n).sqrt()).sqrt() + n.sqrt() * variance.abs()) / n;
    let z = (variance - TOLERANCE * left) / error;
    let both = mean(a, b);
    let keep = |v: &f32, w: &f32| {
        let w = f64::from(*w);
        if w > 0.0 { (f64::from(*v) * variance / (variance + 1.0 / w)) as f32 } else { 0.0 }
    };
    let table = Zip::from(&both.value).and(&both.weight).map_collect(keep);
    // Variance of the pattern given the noisy estimate of the pixel.
    let posterior = |w: &f32| variance.max(0.0) / (1.0 + variance.max(0.0) * f64::from(*w));
    let table_error = (both.weight.iter().map(posterior).sum::<f64>() / n).sqrt();
    Some(Shape { table, size: (variance - left).max(0.0), error, doubt: (TOLERANCE - 1.0) * left, table_error, z })
}

/// A map without what all pixels of a row, or of a column, share: the first column behind a lag is no spot. Medians
/// leave spots as they are.
fn without_lines(map: &Array2<f32>) -> Array2<f32> {
    let mut out = map.clone();
    for axis in [Axis(0), Axis(1)] {
        for mut line in out.axis_iter_mut(axis) {
            let mut values = line.to_vec();
            let middle = values.len() / 2;
            if !values.is_empty() {
                let median = *values.select_nth_unstable_by(middle, f32::total_cmp).1;
                line.mapv_inplace(|v| v - median);
            }
        }
    }
    out
}

/// Dark spots: minima of a map that is smoothed to their size.
fn spots(a: &Half, b: &Half, left: f64) -> Option<Shape> {
    let smooth = |h: &Half| {
        let flat = without_lines(&level(h).value);
        blur_within(&flat, SPOT_PX) - blur_within(&flat, 8.0 * SPOT_PX)
    };
    let (sa, sb) = (smooth(a), smooth(b));
    // Share of the variance of white noise after the blur: 1 / (4 pi sigma^2).
    let share = 1.0 / (4.0 * std::f64::consts::PI * SPOT_PX * SPOT_PX);
    let sigma_of = |h: &Half| {
        let mean = f64::from(h.weight.mean().unwrap_or(0.0));
        (share * (1.0 / mean.max(1e-30) + left)).sqrt() as f32
    };
    let (ea, eb) = (sigma_of(a), sigma_of(b));
    let both = (&sa + &sb) * 0.5;
    let mut core = Array2::from_elem(both.dim(), 0.0f32);
    let mut deepest = (0, 0);
    let mut z = 0.0f64;
    let mut bright = 0.0f64;
    Zip::indexed(&both).for_each(|at, v| {
        let least = (-sa[at] / ea).min(-sb[at] / eb);
        bright = bright.max(f64::from((sa[at] / ea).min(sb[at] / eb)));
        if least > SPOT {
            core[at] = 1.0;
            if *v < both[deepest] {
                deepest = at;
            }
            z = z.max(f64::from(least));
        }
    });
    // Dust is dark: a map with spots as bright is another effect.
    if bright > f64::from(SPOT) && bright > 0.5 * z {
        return None;
    }
    let chances = both.len() as f64 * share;
    let z = if z > 0.0 { sigmas((two_sided(z) * chances).min(1.0)) } else { 0.0 };
    // The table keeps the unsmoothed values around each spot.
    let near = blur_within(&core, 2.0 * SPOT_PX);
    let raw = mean(a, b);
    let table = Zip::from(&near).and(&raw.value).map_collect(|n, v| if *n > 0.02 { *v } else { 0.0 });
    // The depth is the mean of the nine pixels in the middle of the deepest spot.
    let (rows, cols) = raw.value.dim();
    let around = |i: usize, n: usize| i.saturating_sub(1)..(i + 2).min(n);
    let window = s![around(deepest.0, rows), around(deepest.1, cols)];
    let (values, weights) = (raw.value.slice(window), raw.weight.slice(window));
    let error = 1.0 / f64::from(weights.sum()).max(1e-30).sqrt();
    let size = if z > 0.0 { -f64::from(values.mean().unwrap_or(0.0)) } else { 0.0 };
    Some(Shape { table, size, error, doubt: 0.0, table_error: 0.0, z })
}

mod single;

#[cfg(test)]
mod tests;
