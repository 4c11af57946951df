//! The region of a large frame on which specimens are estimated.
//!
//! What takes specimens out of frames is exact only where all object pixels that a sensor pixel sees are unknowns, and
//! large objects have too many. But few sensor pixels see few object pixels: those behind each lens that show one
//! square of the object, and, where views overlap, the squares that lie a displacement between two lenses away. So the
//! region is made of the sensor pixels that see squares of the object at such places and nothing else. Every
//! specimen outside of them is allowed for as well, since no pixel of the region sees it.

use crate::fit::projection::{CORE, Footprint, MERGED};
use ndarray::{Array2, s};
use rayon::prelude::*;
use std::ops::RangeInclusive;

/// Places of the first square that are tried along each side of the object, its middle among them.
const PLACES: usize = 21;
/// Sensor pixels that are looked at along its longer side to compare places.
const LOOKED_AT: usize = 128;
/// Least number of fitted pixels of a region for each unknown: with one, a specimen explains everything.
const LEAST: f64 = 1.3;

/// Shares of the pixels that may be held out: with fewer nothing is judged, with more nothing is fitted.
const HELD_OUT: RangeInclusive<f64> = 0.05..=0.6;
/// Numbers of blocks along each side that are tried.
const TRIED: usize = 4;
/// Share of the views by which one number is better than another.
const CLEARLY: f64 = 0.1;

/// How large a region may be.
#[derive(Clone, Copy)]
pub(super) struct Size {
    /// Most object pixels that it sees.
    pub(super) pixels: usize,
    /// Most unknowns, where those that are seen by their tails alone are merged.
    pub(super) unknowns: usize,
    /// Share of the pixels that is not held out.
    pub(super) fitted: f64,
}

/// Sensor pixels that see few object pixels and nothing else, [sensor rows, sensor cols]: of several places those with
/// most light (`light`, of the same shape) that no specimen explains. None: at every place specimens would explain
/// nearly all of it.
pub(super) fn region(footprint: &Footprint, light: &Array2<f32>, most: Size) -> Option<Array2<bool>> {
    let moves = moves(footprint);
    let step = footprint.sensor.iter().max()?.div_ceil(LOOKED_AT);
    let tried = (0..PLACES * PLACES).into_par_iter().filter_map(|i| {
        let at = [i / PLACES, i % PLACES];
        let centre = [0, 1].map(|a| ((2 * at[a] + 1) * footprint.object[a] / (2 * PLACES)) as isize);
        let (object, unknowns) = squares(footprint, centre, &moves, most)?;
        let alone = footprint.alone(&object, step);
        let pixels = (count(&alone) * step * step) as f64;
        let lit: f64 =
            alone.indexed_iter().filter(|(_, v)| **v).map(|((r, c), _)| f64::from(light[[r * step, c * step]])).sum();
        // An effect shows in what more there is of pixels than of unknowns, by the square root of the light.
        let fitted = most.fitted * pixels;
        let left = 1.0 - unknowns as f64 / fitted;
        (fitted >= LEAST * unknowns as f64).then(|| (lit.max(f64::MIN_POSITIVE) * left, object))
    });
    let (_, object) = tried.reduce_with(|a, b| if b.0 > a.0 { b } else { a })?;
    Some(footprint.alone(&object, 1))
}

/// Displacements of the object that bring the view of one lens to that of another, (0, 0) among them.
fn moves(footprint: &Footprint) -> Vec<[isize; 2]> {
    let of = |a: &[isize; 2], b: &[isize; 2]| [a[0] - b[0], a[1] - b[1]];
    let mut all: Vec<[isize; 2]> =
        footprint.corners.iter().flat_map(|a| footprint.corners.iter().map(move |b| of(a, b))).collect();
    all.sort_unstable();
    all.dedup();
    all
}

/// The largest squares about `centre` and the places at `moves` from there whose pixels on the object are not too many,
/// and about how many unknowns they are. None: even a square whose middle no window leaves is too large.
fn squares(
    footprint: &Footprint,
    centre: [isize; 2],
    moves: &[[isize; 2]],
    most: Size,
) -> Option<(Array2<bool>, usize)> {
    let object = footprint.object;
    let painted = |half: isize| {
        let mut out = Array2::from_elem(object, false);
        for by in moves {
            let span = |a: usize| {
                let clip = |v: isize| v.clamp(0, object[a] as isize) as usize;
                clip(centre[a] + by[a] - half)..clip(centre[a] + by[a] + half + 1)
            };
            out.slice_mut(s![span(0), span(1)]).fill(true);
        }
        out
    };
    let tail = (footprint.side / 2).saturating_sub(CORE) as isize;
    let unknowns = |half: isize| {
        let own = count(&painted(half - tail));
        own + (count(&painted(half)) - own).div_ceil(MERGED * MERGED)
    };
    let fits = |half: isize| count(&painted(half)) <= most.pixels && unknowns(half) <= most.unknowns;
    let (mut largest, mut too_large) = (tail, object[0].max(object[1]) as isize);
    while too_large - largest > 1 {
        let half = (largest + too_large) / 2;
        if fits(half) { largest = half } else { too_large = half }
    }
    fits(largest).then(|| (painted(largest), unknowns(largest)))
}

/// How many spatial blocks there should be along each side of the sensor so that what held-out blocks of a region show
/// is seen by other pixels as well, behind other lenses: `first`, unless that share of it is clearly larger with a few
/// more. A pitch of two blocks, for example, holds out all views of a place or none of them. `held_out` says whether a
/// pixel is held out with so many blocks along each side.
pub(super) fn blocks_per_side(
    footprint: &Footprint,
    region: &Array2<bool>,
    first: usize,
    held_out: impl Fn(usize) -> Array2<bool> + Sync,
) -> usize {
    let enough = 2.min(footprint.corners.len().saturating_sub(1));
    let seen_elsewhere = |blocks: usize| {
        let held_out = held_out(blocks);
        let is_seen = |p: [isize; 2]| {
            let at = p.map(|v| usize::try_from(v).unwrap_or(usize::MAX));
            region.get(at) == Some(&true) && held_out.get(at) == Some(&false)
        };
        let (mut views, mut elsewhere) = (0usize, 0usize);
        for ((r, c), _) in held_out.indexed_iter().filter(|(at, out)| **out && region[*at]) {
            for corner in &footprint.corners {
                let object = [r as isize - corner[0], c as isize - corner[1]];
                // The middles of the windows of one object pixel lie as far apart as their corners.
                let half = (footprint.side / 2) as isize;
                if (0..2).any(|a| !(half..footprint.object[a] as isize + half).contains(&object[a])) {
                    continue;
                }
                views += 1;
                let others = footprint.corners.iter().filter(|o| *o != corner);
                elsewhere += usize::from(
                    others.map(|o| [0, 1].map(|a| object[a] + o[a])).filter(|p| is_seen(*p)).count() >= enough,
                );
            }
        }
        let share = count(&held_out) as f64 / count(region).max(1) as f64;
        if HELD_OUT.contains(&share) { elsewhere as f64 / views.max(1) as f64 } else { 0.0 }
    };
    let shares: Vec<(usize, f64)> =
        (first..first + TRIED).into_par_iter().map(|blocks| (blocks, seen_elsewhere(blocks))).collect();
    let best = shares.iter().copied().reduce(|a, b| if b.1 > a.1 { b } else { a });
    best.filter(|best| best.1 > shares[0].1 + CLEARLY).map_or(first, |best| best.0)
}

fn count(set: &Array2<bool>) -> usize {
    set.iter().filter(|v| **v).count()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// A square array of nine lenses whose views overlap, as on a sensor of a Miniscope V4.
    fn overlapping() -> Footprint {
        let pitch = 168;
        let corners = (0..9).map(|l| [l / 3, l % 3].map(|i| i as isize * pitch - 18)).collect();
        Footprint { object: [272, 272], sensor: [608, 608], side: 37, corners }
    }

    #[test]
    fn a_region_sees_few_object_pixels_and_has_more_pixels_than_these() {
        let footprint = overlapping();
        for most in [4000, 10_000] {
            let most = Size { pixels: most, unknowns: most / 2, fitted: 1.0 };
            let region = region(&footprint, &Array2::ones((608, 608)), most).unwrap();
            let pixels = footprint.seen_by(&region).len();
            assert!(pixels <= most.pixels && pixels > most.pixels / 3, "{pixels} of {}", most.pixels);
            assert!(count(&region) > most.unknowns, "{} {}", count(&region), most.unknowns);
        }
        // Two lenses that show the same: each pixel sees two object pixels, and no region has more pixels than these.
        let twice = Footprint { object: [200, 200], sensor: [240, 240], side: 31, corners: vec![[0, 0], [5, 5]] };
        assert!(
            region(&twice, &Array2::ones((240, 240)), Size { pixels: 10_000, unknowns: 5000, fitted: 1.0 }).is_none()
        );
    }

    #[test]
    fn what_is_held_out_is_seen_behind_other_lenses() {
        // Blocks of 100 pixels: those of nine lenses at a pitch of 200 would all be held out, or none.
        let corners = (0..9).map(|l| [l / 3, l % 3].map(|i| i as isize * 200)).collect();
        let footprint = Footprint { object: [200, 200], sensor: [600, 600], side: 1, corners };
        let footprint = Footprint { side: 100, ..footprint };
        let region = Array2::from_elem([600, 600], true);
        let board = |n: usize| Array2::from_shape_fn([600, 600], |(r, c)| (r * n / 600 + c * n / 600) % 2 == 1);
        assert_ne!(blocks_per_side(&footprint, &region, 6, board), 6);
        // At a pitch of one block and a half six are as good as others.
        let corners = (0..9).map(|l| [l / 3, l % 3].map(|i| i as isize * 150)).collect();
        assert_eq!(blocks_per_side(&Footprint { corners, ..footprint }, &region, 6, board), 6);
    }
}
