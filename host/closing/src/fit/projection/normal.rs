//! The normal matrix A' W A of the optics, by products of dense matrices.
//!
//! Object pixels are taken in tiles. The windows of a tile behind a lens cover a region of the sensor that is little
//! larger than one of them. Where the regions of two tiles overlap, the windows of each are the rows of a matrix over
//! the pixels that they share, filled up with zeros, and the product of the two is a block of A' W A. A product of
//! matrices does three times the work of the products of the windows alone, several times as fast.

use super::views::{MERGED, Views};
use ommatidia_physics::linalg::add_products;
use rayon::prelude::*;
use std::ops::Range;

/// Rows and columns of a tile, object pixels.
const TILE: [usize; 2] = [2 * MERGED, 2 * MERGED];

/// A' W A for weights of the sensor pixels: the upper triangle, row by row, [unknowns, unknowns].
pub(super) fn normal(views: &Views, weight: &[f32]) -> Vec<f32> {
    let n = views.unknowns();
    let mut out = vec![0.0f32; n * n];
    let tiles = Tile::all(views);
    // The rows of the matrix that belong to each tile.
    let mut parts: Vec<Vec<&mut [f32]>> = tiles.iter().map(|_| Vec::new()).collect();
    let mut tile_of = vec![0; n];
    for (t, tile) in tiles.iter().enumerate() {
        tile.unknowns.iter().for_each(|x| tile_of[*x] = t);
    }
    for (row, t) in out.chunks_exact_mut(n.max(1)).zip(&tile_of) {
        parts[*t].push(row);
    }
    parts.into_par_iter().enumerate().for_each_init(Room::default, |room, (t, mut rows)| {
        let own = &tiles[t];
        // Tiles of the same row have pixels on either side of the diagonal.
        for other in tiles.iter().filter(|o| o.rows.start >= own.rows.start) {
            room.meet(views, weight, [own, other]);
            let sums = room.sums.chunks_exact(other.unknowns.len());
            for ((x, row), sums) in own.unknowns.iter().zip(&mut rows).zip(sums) {
                other.unknowns.iter().zip(sums).filter(|(y, _)| *y >= x).for_each(|(y, sum)| row[*y] = *sum);
            }
        }
    });
    out
}

/// A rectangle of object pixels.
struct Tile {
    rows: Range<usize>,
    cols: Range<usize>,
    /// Those of them that are not known, by their number among all, each with the place of its unknown in `unknowns`.
    pixels: Vec<(usize, usize)>,
    /// Their unknowns, ascending; no other tile has any of them.
    unknowns: Vec<usize>,
}

impl Tile {
    /// The tiles of an object that hold pixels that are not known, row by row.
    fn all(views: &Views) -> Vec<Self> {
        let [rows, cols] = views.object();
        let parts = |n: usize, by: usize| (0..n).step_by(by).map(move |first| first..(first + by).min(n));
        let tile =
            |(rows, cols): (Range<usize>, Range<usize>)| Self { rows, cols, pixels: Vec::new(), unknowns: Vec::new() };
        let across = cols.div_ceil(TILE[1]);
        let mut all: Vec<Self> = parts(rows, TILE[0])
            .flat_map(|rows| parts(cols, TILE[1]).map(move |cols| (rows.clone(), cols)))
            .map(tile)
            .collect();
        for x in 0..views.pixels().len() {
            let [r, c] = views.place_of(x);
            let (tile, unknown) = (&mut all[r / TILE[0] * across + c / TILE[1]], views.unknown(x));
            // Unknowns are numbered in the order of their first pixels.
            if tile.unknowns.last().is_none_or(|last| *last < unknown) {
                tile.unknowns.push(unknown);
            }
            if let Ok(place) = tile.unknowns.binary_search(&unknown) {
                tile.pixels.push((x, place));
            }
        }
        all.retain(|tile| !tile.pixels.is_empty());
        all
    }

    /// The rows and columns of the sensor that its windows behind a lens cover.
    fn region(&self, views: &Views, lens: usize) -> [Range<isize>; 2] {
        let [top, left] = views.corner_at(lens, [self.rows.start, self.cols.start]);
        let [height, width] = [&self.rows, &self.cols].map(|n| (n.len() + views.side() - 1) as isize);
        [top..top + height, left..left + width]
    }
}

/// Room for the product of two tiles.
#[derive(Default)]
struct Room {
    /// Windows over shared pixels, weighted and not, [unknown of a tile, shared pixel].
    windows: [Vec<f32>; 2],
    /// The product, [unknown of the first tile, unknown of the second].
    sums: Vec<f32>,
}

impl Room {
    /// Sums up the products of the windows of two tiles behind all pairs of lenses.
    fn meet(&mut self, views: &Views, weight: &[f32], tiles: [&Tile; 2]) {
        self.sums.clear();
        self.sums.resize(tiles[0].unknowns.len() * tiles[1].unknowns.len(), 0.0);
        for lens in 0..views.lenses() {
            let own = tiles[0].region(views, lens);
            for other in 0..views.lenses() {
                let theirs = tiles[1].region(views, other);
                let shared = |a: usize| {
                    let on_sensor = 0..views.sensor()[a] as isize;
                    let first = own[a].start.max(theirs[a].start).max(on_sensor.start);
                    first..own[a].end.min(theirs[a].end).min(on_sensor.end)
                };
                let shared = [shared(0), shared(1)];
                if shared.iter().any(Range::is_empty) {
                    continue;
                }
                let [weighted, bare] = &mut self.windows;
                cut(views, (tiles[0], lens), &shared, Some(weight), weighted);
                cut(views, (tiles[1], other), &shared, None, bare);
                add_products(&mut self.sums, weighted, bare, shared[0].len() * shared[1].len());
            }
        }
    }
}

/// The windows of a tile behind a lens over shared pixels of the sensor, [unknown of the tile, shared pixel]: their
/// sums where several pixels are one unknown.
fn cut(
    views: &Views,
    (tile, lens): (&Tile, usize),
    [rows, cols]: &[Range<isize>; 2],
    weight: Option<&[f32]>,
    out: &mut Vec<f32>,
) {
    let (side, width, sensor_cols) = (views.side() as isize, views.width(), views.sensor()[1]);
    let area = rows.len() * cols.len();
    out.clear();
    out.resize(tile.unknowns.len() * area, 0.0);
    for (x, place) in &tile.pixels {
        let out = &mut out[place * area..][..area];
        let ([top, left], window) = (views.corner(lens, *x), views.window(lens, *x));
        let [first, last] = [left.max(cols.start), (left + side).min(cols.end)];
        if first >= last {
            continue;
        }
        let count = (last - first) as usize;
        for r in rows.start.max(top)..rows.end.min(top + side) {
            let to = &mut out[(r - rows.start) as usize * cols.len() + (first - cols.start) as usize..][..count];
            let from = &window[(r - top) as usize * width + (first - left) as usize..][..count];
            match weight {
                None => to.iter_mut().zip(from).for_each(|(to, v)| *to += v),
                Some(weight) => {
                    let weight = &weight[r as usize * sensor_cols + first as usize..][..count];
                    to.iter_mut().zip(from.iter().zip(weight)).for_each(|(to, (v, w))| *to += v * w);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::projection::Footprint;
    use ndarray::Array2;

    /// Pixel by pixel, for an object that is no multiple of a tile, of which some pixels are known, and windows that
    /// reach beyond the sensor.
    #[test]
    fn the_normal_matrix_is_the_sum_over_the_pixels() {
        let (object, sensor, side) = ([11, 13], [24, 29], 5);
        let corners = vec![[-2, 1], [4, 9], [9, -3], [10, 12]];
        let is_unknown =
            |p: &u32| !matches!((*p as usize / object[1], *p as usize % object[1]), (2..4, 3..6) | (8.., 8..));
        let pixels: Vec<u32> = (0..(object[0] * object[1]) as u32).filter(is_unknown).collect();
        let mut views = Views::dark(Footprint { object, sensor, side, corners: corners.clone() }, pixels.clone());
        let value = |k: usize| ((k * 37 % 101) as f32) / 101.0 - 0.3;
        let mut images: Vec<Array2<f32>> = Vec::new();
        for (x, p) in pixels.iter().enumerate() {
            let [r, c] = [*p as usize / object[1], *p as usize % object[1]];
            let mut all = Array2::zeros((sensor[0], sensor[1]));
            for (lens, corner) in corners.iter().enumerate() {
                let mut image = Array2::zeros((sensor[0], sensor[1]));
                for i in 0..side * side {
                    let at = [corner[0] + (r + i / side) as isize, corner[1] + (c + i % side) as isize];
                    let at = at.map(|v| usize::try_from(v).unwrap_or(usize::MAX));
                    if let Some(v) = image.get_mut(at) {
                        *v = value(i + 7 * lens + 3 * r + 11 * c);
                    }
                }
                views.take(lens, x, &image);
                all += &image;
            }
            images.push(all);
        }
        // Pixels that the left part of the sensor hardly sees are merged.
        views.merge_tails(&Array2::from_shape_fn((sensor[0], sensor[1]), |(_, c)| f32::from(u8::from(c < 3))));
        assert!(views.unknowns() < pixels.len() - 10, "{} of {}", views.unknowns(), pixels.len());
        let mut columns = vec![Array2::<f32>::zeros((sensor[0], sensor[1])); views.unknowns()];
        images.iter().enumerate().for_each(|(x, image)| columns[views.unknown(x)] += image);
        let weight: Vec<f32> =
            (0..sensor[0] * sensor[1]).map(|p| if p % 7 == 0 { 0.0 } else { value(p) + 1.0 }).collect();
        let (found, n) = (normal(&views, &weight), columns.len());
        for (x, a) in columns.iter().enumerate() {
            for (y, b) in columns.iter().enumerate().skip(x) {
                let sum: f64 = a.iter().zip(b).zip(&weight).map(|((a, b), w)| f64::from(a * b * w)).sum();
                assert!((f64::from(found[x * n + y]) - sum).abs() < 1e-3, "{x} {y}: {} {sum}", found[x * n + y]);
            }
            assert!(found[x * n..x * n + x].iter().all(|v| *v == 0.0));
        }
    }
}
