//! Writes the optics out as a matrix.
//!
//! The low-rank operator of the instrument applies such a matrix fast, but has neither the effects of a state nor their
//! transpose. Unit sources on a lattice, wider apart than a window, show many columns of the matrix at once.

use super::views::Views;
use crate::fit::model::Model;
use ndarray::Array2;
use ommatidia_model::forward::ForwardError;
use ommatidia_physics::effects::{Chain, Stage};
use rayon::prelude::*;

/// Pixels by which an effect may widen a window or move its light inside it, on each side.
pub(super) const MARGIN: usize = 3;

/// The optics in windows of `window` pixels under a chain of effects, in the context of frame `k`.
///
/// # Errors
/// The parts of the instrument disagree.
pub(super) fn probed(model: &Model<'_>, chain: &Chain, k: usize, window: usize) -> Result<Views, ForwardError> {
    let (cx, forward) = (model.context(k, None), &model.forward);
    let object = forward.operator().object_shape();
    let sensor = model.seen.sensor;
    let margin = if chain.acts_at(Stage::Geometry) || chain.acts_at(Stage::Lens) { MARGIN } else { 0 };
    let side = window + 2 * margin;
    let response = forward.on_sensor(Array2::ones((sensor[0], sensor[1])), &Chain::default(), &cx);
    let images = |sources: &Array2<f32>, chain: &Chain| -> Result<Vec<Array2<f32>>, ForwardError> {
        let scene = forward.scene(sources.view(), chain, &cx)?.at_depth(model.depth_of(k));
        Ok((0..model.lenses()).map(|l| forward.lens_e(&scene, l, chain, &cx) * &response).collect())
    };
    // Where the effects move the light to, in whole pixels.
    let middle = object.map(|n| n / 2);
    let mut source = Array2::zeros((object[0], object[1]));
    source[middle] = 1.0;
    let (plain, moved) = (images(&source, &Chain::default())?, images(&source, chain)?);
    let corners = (0..model.lenses())
        .map(|l| {
            let shift = match (centroid(&plain[l]), centroid(&moved[l])) {
                (Some(a), Some(b)) => [b[0] - a[0], b[1] - a[1]],
                _ => [0.0; 2],
            };
            [0, 1].map(|a| {
                let centre = (object[a] as f64 - 1.0) / 2.0;
                let corner = (cx.anchors_px[l][a] - centre).round() as isize;
                corner + shift[a].round() as isize - (side / 2) as isize
            })
        })
        .collect();
    let mut it = Views::dark(object, sensor, side, corners);
    for row in 0..side {
        let lattices = (0..side).into_par_iter().map(|col| {
            let mut sources = Array2::zeros((object[0], object[1]));
            sources.slice_mut(ndarray::s![row..;side, col..;side]).fill(1.0);
            images(&sources, chain)
        });
        let lattices: Vec<Vec<Array2<f32>>> = lattices.collect::<Result<_, _>>()?;
        for (col, images) in lattices.iter().enumerate() {
            for r in (row..object[0]).step_by(side) {
                for c in (col..object[1]).step_by(side) {
                    images.iter().enumerate().for_each(|(l, image)| it.take(l, [r, c], image));
                }
            }
        }
    }
    Ok(it)
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
