//! A resolution target with bars at known places: three-bar groups of one period, along rows and along columns, at the
//! centre of the field and at its four edges.

use crate::session::ObjectGrid;
use ndarray::Array2;

/// Periods of the line pairs, object pixels, one for each frame; the finest first.
pub const PERIODS_PX: [f64; 7] = [2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0];

/// Distance of groups from the edge of the field, pixels.
const MARGIN: f64 = 4.0;
/// Half the distance between the two groups of a place, pixels.
const APART: f64 = 2.0;
/// Length of the shortest bar, pixels.
const SHORTEST: f64 = 6.0;

/// A group of three bars.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Group {
    /// Place in the field: `centre`, `left`, `right`, `top` or `bottom`.
    pub place: &'static str,
    /// Axis along which light and dark alternate: 0 from row to row, 1 from column to column.
    pub axis: usize,
    /// Upper left corner (row, col), pixels; pixel i covers i to i + 1.
    pub start: [f64; 2],
    /// Distance from one bar to the next, pixels. A bar is half as wide.
    pub period: f64,
    /// Length of a bar, pixels.
    pub length: f64,
}

/// The groups of a target with this period, object pixels. Empty if they do not fit into the grid.
pub fn groups(grid: &ObjectGrid, period: f64) -> Vec<Group> {
    let side = (2.5 * period).max(SHORTEST).ceil();
    let (rows, cols) = (grid.rows as f64, grid.cols as f64);
    if 3.0 * side + 2.0 * (MARGIN + 2.0 * APART) > rows.min(cols) {
        return Vec::new();
    }
    let middle = |n: f64| (n / 2.0).floor();
    let (y, x) = (middle(rows), middle(cols));
    let (before, behind) = (-side - APART, APART);
    let half = -(side / 2.0).floor();
    let places = [
        ("centre", [[y + half, x + before], [y + half, x + behind]]),
        ("left", [[y + before, MARGIN], [y + behind, MARGIN]]),
        ("right", [[y + before, cols - MARGIN - side], [y + behind, cols - MARGIN - side]]),
        ("top", [[MARGIN, x + before], [MARGIN, x + behind]]),
        ("bottom", [[rows - MARGIN - side, x + before], [rows - MARGIN - side, x + behind]]),
    ];
    let length = (2.5 * period).max(SHORTEST);
    let pair = |(place, starts): (&'static str, [[f64; 2]; 2])| {
        [0, 1].map(|axis| Group { place, axis, start: starts[axis], period, length })
    };
    places.into_iter().flat_map(pair).collect()
}

/// The target with this period (object pixels), [rows, cols] of `grid`. Each pixel is as bright as its share under
/// bars.
pub fn target(grid: &ObjectGrid, period: f64) -> Array2<f32> {
    let mut light = Array2::zeros((grid.rows, grid.cols));
    for group in groups(grid, period) {
        let covered = |i: usize, from: f64, to: f64| ((i as f64 + 1.0).min(to) - (i as f64).max(from)).max(0.0);
        let across = |i: usize| {
            let from = group.start[group.axis];
            (0..3).map(|bar| from + f64::from(bar) * period).map(|f| covered(i, f, f + period / 2.0)).sum::<f64>()
        };
        let along = |i: usize| {
            let from = group.start[1 - group.axis];
            covered(i, from, from + group.length)
        };
        for ((r, c), v) in light.indexed_iter_mut() {
            let (i, j) = if group.axis == 0 { (r, c) } else { (c, r) };
            *v += (across(i) * along(j)) as f32;
        }
    }
    light
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_hold_half_of_their_groups_light_and_do_not_touch() {
        let grid = ObjectGrid { rows: 96, cols: 96, pixel_um: 2.8 };
        for period in PERIODS_PX {
            let groups = groups(&grid, period);
            assert_eq!(groups.len(), 10);
            let light = target(&grid, period);
            let expected: f64 = groups.iter().map(|g| 1.5 * period * g.length).sum();
            assert!((f64::from(light.sum()) - expected).abs() < 1e-2, "{period}: {} {expected}", light.sum());
            assert!(light.iter().all(|v| (0.0..=1.0 + 1e-6).contains(v)));
        }
        assert!(groups(&ObjectGrid { rows: 40, cols: 96, pixel_um: 2.8 }, 6.0).is_empty());
    }
}
