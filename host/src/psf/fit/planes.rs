//! Beads grouped by depth, and their division into two halves that predict each other.

use ndarray::{Array2, Axis};

/// Fewest beads at a depth from which the field between them can be interpolated.
const FEW: usize = 4;

/// Beads at one depth: their indices and positions.
#[derive(Clone, Debug)]
pub struct Plane {
    /// Depth, um.
    pub z_um: f64,
    /// Indices of the beads at this depth.
    pub beads: Vec<usize>,
    /// Their positions, object pixels, [bead, (row, col)].
    pub at_px: Array2<f64>,
}

/// The beads of each plane for whose index `keep` is true.
pub fn select(planes: &[Plane], keep: impl Fn(usize) -> bool) -> Vec<Plane> {
    let part = |p: &Plane| {
        let rows: Vec<usize> = (0..p.beads.len()).filter(|i| keep(p.beads[*i])).collect();
        let beads = rows.iter().map(|i| p.beads[*i]).collect();
        Plane { z_um: p.z_um, beads, at_px: p.at_px.select(Axis(0), &rows) }
    };
    planes.iter().map(part).collect()
}

/// Splits beads into two halves (true: fit, false: hold out) such that each bead's neighbours lie in the other half.
///
/// A regular scan is split as a checkerboard. A scan that is itself one colour of a checkerboard is split by every
/// second row, an irregular scan by every second bead in order of position, and a depth scan at few positions by every
/// second depth.
pub fn checkerboard(planes: &[Plane], beads: usize) -> Vec<bool> {
    let mut train = vec![true; beads];
    if planes.iter().all(|p| p.beads.len() < FEW) {
        planes.iter().enumerate().for_each(|(i, p)| p.beads.iter().for_each(|b| train[*b] = i.is_multiple_of(2)));
        return train;
    }
    for plane in planes {
        let (rows, cols) = (levels(plane.at_px.column(0)), levels(plane.at_px.column(1)));
        let count = |levels: &[usize]| levels.iter().max().map_or(0, |m| m + 1);
        let regular = count(&rows) * count(&cols) <= 2 * plane.beads.len();
        let even = |i: &usize| (rows[*i] + cols[*i]).is_multiple_of(2);
        let n = plane.beads.len();
        let white = (0..n).filter(even).count();
        let one_colour = 4 * white.min(n - white) < n;
        for (i, bead) in plane.beads.iter().enumerate() {
            train[*bead] = match (regular, one_colour) {
                (true, false) => even(&i),
                (true, true) => rows[i].is_multiple_of(2),
                (false, _) => i.is_multiple_of(2),
            };
        }
    }
    train
}

/// Index of each value among the distinct ones; values within a hundredth of a pixel count as equal.
fn levels(values: ndarray::ArrayView1<'_, f64>) -> Vec<usize> {
    let mut distinct: Vec<i64> = values.iter().map(|v| (v * 100.0).round() as i64).collect();
    distinct.sort_unstable();
    distinct.dedup_by(|a, b| *a - *b <= 1);
    let rank = |v: &f64| distinct.partition_point(|d| *d < (v * 100.0).round() as i64 - 1);
    values.iter().map(rank).collect()
}
