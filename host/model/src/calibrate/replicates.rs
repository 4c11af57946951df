//! The uncertainty of the PSF model by a delete-a-group jackknife (Shao & Tu, *The Jackknife and Bootstrap*, 1995, ch.
//! 2): J refits, each of which leaves out one group of beads.
//!
//! The groups are spread over the field, so that each refit leaves evenly distributed gaps: beads are counted along a
//! space-filling curve, and every J-th one belongs to the same group.

use super::model::Model;
use crate::psf::fit::{Plane, select};
use crate::psf::{LensWindows, LowRankPsf};
use ndarray::ArrayView2;
use ommatidia_physics::linalg::NotConverged;

/// Largest memory of all replicates, bytes.
pub const MOST_BYTES: usize = 256 << 20;

/// What the refits of a model start from.
pub(super) struct ReplicateRequest<'a> {
    /// The model from all beads; its size bounds the memory.
    pub psf: &'a LowRankPsf,
    /// Bead windows of each lens.
    pub windows: &'a [LensWindows],
    /// Lenses that show no focus.
    pub dead: &'a [bool],
    /// Beads by depth.
    pub planes: &'a [Plane],
    /// Number of refits; 0: none.
    pub count: usize,
}

/// The refits of a model, and a note where there are fewer than requested.
pub(super) fn replicates(
    model: &Model,
    ReplicateRequest { psf, windows, dead, planes, count: asked }: ReplicateRequest<'_>,
) -> Result<(Vec<LowRankPsf>, Option<String>), NotConverged> {
    if asked == 0 {
        return Ok((Vec::new(), None));
    }
    let bytes = asked * size_of::<f32>() * (psf.basis.len() + psf.coefficients.len());
    if bytes > MOST_BYTES {
        let (found, most) = (bytes >> 20, MOST_BYTES >> 20);
        let note = format!(
            "no replicates of the PSF model: {asked} would take {found} MB, the limit is {most} MB; the uncertainty \
             of the model is not known"
        );
        return Ok((Vec::new(), Some(note)));
    }
    // Each plane keeps at least half of its beads.
    let fewest = planes.iter().map(|p| p.beads.len()).min().unwrap_or(0);
    if asked < 2 || fewest < 2 * asked {
        let note = format!(
            "no replicates of the PSF model: expected {asked} groups of two beads or more at each depth, found \
             {fewest} beads; \
             the uncertainty of the model is not known"
        );
        return Ok((Vec::new(), Some(note)));
    }
    let groups = groups(planes, asked);
    let seen: Vec<Vec<bool>> = windows.iter().map(LensWindows::seen).collect();
    let windows = model.filled(windows);
    let refit = |j: usize| model.refit(&windows, &seen, dead, &select(planes, |bead| groups[bead] != j));
    Ok(((0..asked).map(refit).collect::<Result<_, _>>()?, None))
}

/// Group (0 to count - 1) of each bead: the replicate that has not seen it.
pub(super) fn groups(planes: &[Plane], count: usize) -> Vec<usize> {
    let beads = planes.iter().flat_map(|p| &p.beads).max().map_or(0, |n| n + 1);
    let mut groups = vec![0; beads];
    for plane in planes {
        let keys = along_curve(plane.at_px.view());
        let mut order: Vec<usize> = (0..keys.len()).collect();
        order.sort_by_key(|i| keys[*i]);
        order.iter().enumerate().for_each(|(n, i)| groups[plane.beads[*i]] = n % count);
    }
    groups
}

/// Index of each position on Morton's space-filling curve, which interleaves the bits of row and column.
fn along_curve(at_px: ArrayView2<'_, f64>) -> Vec<u64> {
    let range =
        |a: usize| at_px.column(a).iter().fold([f64::INFINITY, f64::NEG_INFINITY], |r, v| [r[0].min(*v), r[1].max(*v)]);
    let (rows, cols) = (range(0), range(1));
    let side = (rows[1] - rows[0]).max(cols[1] - cols[0]).max(f64::MIN_POSITIVE);
    let step = |v: f64, low: f64| ((v - low) / side * 65_535.0).round() as u64;
    let spread = |v: u64| (0..16).fold(0, |out, bit| out | ((v >> bit) & 1) << (2 * bit));
    at_px.outer_iter().map(|p| spread(step(p[0], rows[0])) << 1 | spread(step(p[1], cols[0]))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array2;

    #[test]
    fn groups_are_even_and_spread_over_the_field() {
        for side in [9, 13, 16] {
            let at_px = Array2::from_shape_fn((side * side, 2), |(i, a)| [i / side, i % side][a] as f64 * 7.3);
            let plane = Plane { z_um: 0.0, beads: (0..side * side).collect(), at_px };
            let groups = groups(std::slice::from_ref(&plane), 8);
            for j in 0..8 {
                let here: Vec<usize> = (0..side * side).filter(|n| groups[*n] == j).collect();
                assert!(here.len() >= side * side / 8, "{side} {j}: {}", here.len());
                // The mean of a group lies near the middle, and it reaches every quarter of the field.
                let quarter = |n: usize| (2 * (n / side) / side, 2 * (n % side) / side);
                let reached: std::collections::BTreeSet<_> = here.iter().map(|n| quarter(*n)).collect();
                assert_eq!(reached.len(), 4, "{side} {j}");
            }
        }
    }
}
