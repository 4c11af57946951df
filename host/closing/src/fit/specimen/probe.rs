//! Writes the optics out as a matrix.
//!
//! The low-rank operator of the instrument applies such a matrix fast, but has neither the effects of a state nor their
//! transpose. Unit sources on a lattice, wider apart than a window, show many columns of the matrix at once.

use crate::fit::model::Model;
use crate::fit::projection::{Footprint, Views};
use crate::fit::state::Term;
use ndarray::Array2;
use ommatidia_model::forward::ForwardError;
use ommatidia_physics::effects::{Chain, FrameContext, Stage};
use rayon::prelude::*;

/// Pixels by which an effect may widen a window or move its light inside it, on each side.
pub(super) const MARGIN: usize = 3;
/// Light of a unit source beyond a window that is fainter than this, relative to the brightest pixel, is left out.
const FAINT: f32 = 1e-4;

/// An effect of the sensor belongs to the optics if no more than this share of what it changes is farther away than
/// [`MARGIN`]: wide blurs lose their tails, halos and ghosts lie outside.
const FAR: f64 = 0.2;
/// The same for what it changes in one frame and not in another, and for what is not in proportion to the light.
const UNLIKE: f64 = 0.01;
/// Light of the dots that effects are tried on, electrons: far from where a pixel saturates.
const DOTS_E: [f32; 2] = [100.0, 1000.0];

/// The optics in windows of `window` pixels under the effects of `terms`, in the context of the middle one of `frames`.
/// Not known are all object pixels whose windows reach a sensor pixel that is used.
///
/// # Errors
/// The parts of the instrument disagree.
pub(super) fn probed(
    model: &Model<'_>,
    terms: &[Term],
    frames: &[usize],
    window: usize,
) -> Result<Views, ForwardError> {
    let k = frames.get(frames.len() / 2).copied().unwrap_or(0);
    let (cx, forward) = (model.context(k, None), &model.forward);
    let (chain, near) = (&model.chain(terms), near(model, terms, frames, window));
    let object = forward.operator().object_shape();
    let sensor = model.seen.sensor;
    let dark = Array2::zeros((sensor[0], sensor[1]));
    let response = forward.on_sensor(&dark + 1.0, &Chain::default(), &cx);
    let stray = sensed(model, dark, &near, &cx);
    let images = |sources: &Array2<f32>, chain: &Chain| -> Result<Vec<Array2<f32>>, ForwardError> {
        let scene = forward.scene(sources.view(), chain, &cx)?.at_depth(model.depth_of(k));
        let image = |l: usize| forward.lens_e(&scene, l, chain, &cx);
        Ok((0..model.lenses())
            .map(|l| match near.is_empty() {
                true => image(l) * &response,
                false => sensed(model, image(l), &near, &cx) - &stray,
            })
            .collect())
    };
    // Where the effects move the light to, in whole pixels.
    let middle = object.map(|n| n / 2);
    let mut source = Array2::zeros((object[0], object[1]));
    source[middle] = 1.0;
    let (plain, moved) = (images(&source, &Chain::default())?, images(&source, chain)?);
    let middles: Vec<[isize; 2]> = (0..model.lenses())
        .map(|l| {
            let shift = match (centroid(&plain[l]), centroid(&moved[l])) {
                (Some(a), Some(b)) => [b[0] - a[0], b[1] - a[1]],
                _ => [0.0; 2],
            };
            [0, 1].map(|a| {
                let centre = (object[a] as f64 - 1.0) / 2.0;
                let corner = (cx.anchors_px[l][a] - centre).round() as isize;
                corner + shift[a].round() as isize
            })
        })
        .collect();
    let margin = if chain.acts_at(Stage::Geometry) || chain.acts_at(Stage::Lens) || !near.is_empty() {
        let side = window + 2 * MARGIN;
        let first = object.map(|n| (side / 2).min(n - 1));
        let mut sources = Array2::zeros((object[0], object[1]));
        sources.slice_mut(ndarray::s![first[0]..;side, first[1]..;side]).fill(1.0);
        widening(&images(&sources, chain)?, &middles, (object, first), window)
    } else {
        0
    };
    let side = window + 2 * margin;
    let corners = middles.iter().map(|m| m.map(|at| at - (side / 2) as isize)).collect();
    let footprint = Footprint { object, sensor, side, corners };
    let used = model.seen.used();
    let pixels = footprint.seen_by(&used.mapv(|v| v > 0.0));
    // The number of each object pixel among those that are not known.
    let mut numbers: Array2<Option<usize>> = Array2::from_elem((object[0], object[1]), None);
    for (x, p) in pixels.iter().enumerate() {
        numbers[[*p as usize / object[1], *p as usize % object[1]]] = Some(x);
    }
    let mut it = Views::dark(footprint, pixels);
    let lattice = |[row, col]: [usize; 2]| {
        let mut sources = Array2::zeros((object[0], object[1]));
        let of = ndarray::s![row..;side, col..;side];
        sources.slice_mut(of).zip_mut_with(&numbers.slice(of), |v, x| *v = f32::from(u8::from(x.is_some())));
        images(&sources, chain)
    };
    for row in 0..side.min(object[0]) {
        let lattices = (0..side.min(object[1])).into_par_iter().map(|col| lattice([row, col]));
        let lattices: Vec<Vec<Array2<f32>>> = lattices.collect::<Result<_, _>>()?;
        for (col, images) in lattices.iter().enumerate() {
            for r in (row..object[0]).step_by(side) {
                for c in (col..object[1]).step_by(side) {
                    if let Some(x) = numbers[[r, c]] {
                        images.iter().enumerate().for_each(|(l, image)| it.take(l, x, image));
                    }
                }
            }
        }
    }
    if model.seen.is_part() {
        it.merge_tails(&used);
    }
    Ok(it)
}

/// What the sensor makes of light, electrons, [sensor rows, sensor cols], under effects that are linear in it.
/// Constants that an effect adds stay in.
fn sensed(model: &Model<'_>, light_e: Array2<f32>, near: &Chain, cx: &FrameContext<'_>) -> Array2<f32> {
    let mut charge_e = model.forward.on_sensor(light_e, near, cx);
    near.on_charge(&mut charge_e, cx);
    // Linear in DN above black as in electrons.
    near.on_electronics(&mut charge_e, cx);
    charge_e
}

/// Those of the effects of the sensor that are linear in the light and change a pixel by its neighbours alone, in all
/// frames alike: the specimen is seen through them as it is through the lenses. What acts from afar, or on one frame
/// only, or bends the response, is left to the prediction.
fn near(model: &Model<'_>, terms: &[Term], frames: &[usize], window: usize) -> Chain {
    let (sensor, side) = (model.seen.sensor, window + 2 * MARGIN);
    let dark = Array2::<f32>::zeros((sensor[0], sensor[1]));
    let dots = |light_e: f32| {
        let mut dots = dark.clone();
        dots.slice_mut(ndarray::s![side / 2..;side, side / 2..;side]).fill(light_e);
        dots
    };
    let around = |at: usize, n: usize| (side / 2..n).step_by(side).any(|dot| at.abs_diff(dot) <= MARGIN);
    let is_near = |term: &&Term| {
        if !matches!(term.effect.descriptor().stage, Stage::Light | Stage::Charge | Stage::Electronics) {
            return false;
        }
        let chain = model.chain([*term]);
        let changed = |k: usize, light_e: f32| {
            let cx = model.context(k, None);
            let of = |light: Array2<f32>, chain: &Chain| sensed(model, light, chain, &cx);
            (of(dots(light_e), &chain) - of(dark.clone(), &chain) - of(dots(light_e), &Chain::default())) / light_e
        };
        let changes: Vec<Array2<f32>> = frames.iter().map(|k| changed(*k, DOTS_E[1])).collect();
        let Some(first) = changes.first() else { return false };
        let size = |image: &Array2<f32>| image.iter().map(|v| f64::from(v.abs())).sum::<f64>();
        let far = |((r, c), v): ((usize, usize), &f32)| {
            if around(r, sensor[0]) && around(c, sensor[1]) { 0.0 } else { f64::from(v.abs()) }
        };
        let all = size(first);
        let elsewhere: f64 = first.indexed_iter().map(far).sum();
        let alike = |other: &Array2<f32>| size(&(other - first)) <= UNLIKE * all;
        let is_linear = || frames.first().is_some_and(|k| alike(&changed(*k, DOTS_E[0])));
        all > 0.0 && elsewhere <= FAR * all && changes.iter().all(alike) && is_linear()
    };
    model.chain(terms.iter().filter(is_near))
}

/// Pixels by which the windows of a lattice of sources have to be wider than `window` to hold their light, at most
/// [`MARGIN`]. The lattice has its first source at `first` and one every `window + 2 MARGIN` pixels; `images` are those
/// of the lenses, and `middles` the sensor pixels of object pixel (0, 0).
fn widening(
    images: &[Array2<f32>],
    middles: &[[isize; 2]],
    (object, first): ([usize; 2], [usize; 2]),
    window: usize,
) -> usize {
    let (half, side) = ((window / 2 + MARGIN) as isize, window + 2 * MARGIN);
    // The brightest pixel of each ring, from the outermost to the edge of the plain window, and inside.
    let mut rings = [0.0f32; MARGIN + 1];
    for (image, middle) in images.iter().zip(middles) {
        for r in (first[0]..object[0]).step_by(side) {
            for c in (first[1]..object[1]).step_by(side) {
                for (dr, dc) in (-half..=half).flat_map(|dr| (-half..=half).map(move |dc| (dr, dc))) {
                    let at = [middle[0] + r as isize + dr, middle[1] + c as isize + dc];
                    let ([Ok(row), Ok(col)], ring) = (at.map(usize::try_from), half - dr.abs().max(dc.abs())) else {
                        continue;
                    };
                    let ring = &mut rings[MARGIN.min(ring as usize)];
                    *ring = image.get((row, col)).map_or(*ring, |v| ring.max(v.abs()));
                }
            }
        }
    }
    let least = FAINT * rings.iter().fold(0.0f32, |m, v| m.max(*v));
    let dark = rings[..MARGIN].iter().take_while(|v| **v < least).count();
    MARGIN - dark
}

/// Centroid of an image, [row, col]. None: it is dark.
fn centroid(image: &Array2<f32>) -> Option<[f64; 2]> {
    let mut sums = [0.0f64; 3];
    for ((r, c), v) in image.indexed_iter() {
        let v = f64::from(*v);
        sums.iter_mut().zip([1.0, r as f64, c as f64]).for_each(|(s, w)| *s += w * v);
    }
    (sums[0] > 0.0).then(|| [sums[1] / sums[0], sums[2] / sums[0]])
}
