//! Centroids of the foci of a bead scan.
//!
//! The rounds of a fit look at the same foci, each time round better places. What lies round a focus is kept in memory,
//! so that a frame is read again only where a focus turns out to lie elsewhere.

use super::{BeadError, BeadScan};
use ndarray::{Array2, ArrayView2, s};

/// Pixels by which a patch is larger than the window that it is cut for, on each side: so far the expected place of a
/// focus may move from round to round.
const SLACK: isize = 4;

/// One centroid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Centroid {
    pub(super) lens: usize,
    /// Stage displacement in nominal sensor pixels.
    pub(super) displacement: [f64; 2],
    pub(super) at: [f64; 2],
}

/// What lies round the foci of a scan, as far as it has been looked at. It takes about the memory that their windows
/// take later.
pub(super) struct Patches {
    living: Vec<usize>,
    /// For each bead that was looked at the patches of the living lenses.
    of_bead: Vec<Vec<Patch>>,
}

impl Patches {
    /// No patch yet of so many beads. Lenses that are `dead` have none.
    pub(super) fn new(beads: usize, dead: &[bool]) -> Self {
        Self { living: (0..dead.len()).filter(|l| !dead[*l]).collect(), of_bead: vec![Vec::new(); beads] }
    }

    /// Centroids of those foci of bead `n` that are bright and complete, with its stage displacement. `expected` are
    /// the places of the foci of all lenses, [row, col], sensor pixels.
    ///
    /// # Errors
    /// The frame cannot be read.
    pub(super) fn centroids(
        &mut self,
        scan: &mut BeadScan,
        n: usize,
        (expected, displacement): (&[[f64; 2]], [f64; 2]),
        radius: isize,
    ) -> Result<Vec<Centroid>, BeadError> {
        let corner = |lens: usize| expected[lens].map(|v| v.round() as isize - radius);
        let side = 2 * radius + 1;
        let patches = &mut self.of_bead[n];
        let holds = |(patch, lens): (&Patch, &usize)| patch.holds(corner(*lens), side);
        if patches.is_empty() || !patches.iter().zip(&self.living).all(holds) {
            let frame = scan.light_dn(n)?;
            *patches = self.living.iter().map(|lens| Patch::cut(&frame, corner(*lens), side)).collect();
        }
        let sigma = scan.noise().variance_dn2(scan.noise().black_level_dn).sqrt();
        let found = patches.iter().zip(&self.living).filter_map(|(patch, lens)| {
            let at = centroid(patch.window(corner(*lens), side)?, sigma)?;
            let at = [0, 1].map(|a| corner(*lens)[a] as f64 + at[a]);
            Some(Centroid { lens: *lens, displacement, at })
        });
        Ok(found.collect())
    }
}

/// A part of a frame.
#[derive(Clone, Debug)]
struct Patch {
    /// Sensor pixel of its first pixel.
    first: [isize; 2],
    /// [rows, cols]; empty where nothing of it lies on the sensor.
    light_dn: Array2<f32>,
    sensor: [isize; 2],
}

impl Patch {
    /// The part of a frame round a square window, as far as it lies on the sensor.
    fn cut(frame: &Array2<f32>, corner: [isize; 2], side: isize) -> Self {
        let sensor = [frame.nrows() as isize, frame.ncols() as isize];
        let span = |a: usize| {
            let start = (corner[a] - SLACK).clamp(0, sensor[a]);
            start..(corner[a] + side + SLACK).clamp(start, sensor[a])
        };
        let (rows, cols) = (span(0), span(1));
        let first = [rows.start, cols.start];
        Self { first, light_dn: frame.slice(s![rows, cols]).to_owned(), sensor }
    }

    /// Whether it shows all that the sensor has of a square window.
    fn holds(&self, corner: [isize; 2], side: isize) -> bool {
        let size = [self.light_dn.nrows() as isize, self.light_dn.ncols() as isize];
        (0..2).all(|a| {
            let (start, end) = (corner[a].max(0), (corner[a] + side).min(self.sensor[a]));
            start >= end || self.first[a] <= start && end <= self.first[a] + size[a]
        })
    }

    /// A square window. None where it reaches beyond the sensor.
    fn window(&self, corner: [isize; 2], side: isize) -> Option<ArrayView2<'_, f32>> {
        let size = [self.light_dn.nrows() as isize, self.light_dn.ncols() as isize];
        let span = |a: usize| {
            let start = corner[a] - self.first[a];
            (start >= 0 && start + side <= size[a]).then(|| start as usize..(start + side) as usize)
        };
        let (rows, cols) = (span(0)?, span(1)?);
        Some(self.light_dn.slice(s![rows, cols]))
    }
}

/// Centroid of the light in a window, less the median of its border, [row, col] from its first pixel. None if it holds
/// a saturated pixel, or has no peak of 8 sigma.
///
/// There is no threshold: it would cut the faint flare of coma and move the centroid towards the bright core.
fn centroid(window: ArrayView2<'_, f32>, sigma: f64) -> Option<[f64; 2]> {
    if window.iter().any(|v| !v.is_finite()) {
        return None;
    }
    let last = window.nrows() - 1;
    let border = window.indexed_iter().filter(|((r, c), _)| *r == 0 || *c == 0 || *r == last || *c == last);
    let mut border: Vec<f32> = border.map(|(_, v)| *v).collect();
    let middle = border.len() / 2;
    let level = f64::from(*border.select_nth_unstable_by(middle, f32::total_cmp).1);
    let peak = window.iter().fold(f32::NEG_INFINITY, |m, v| m.max(*v));
    if f64::from(peak) - level < 8.0 * sigma {
        return None;
    }
    let (mut sum, mut moment) = (0.0, [0.0; 2]);
    for ((r, c), v) in window.indexed_iter() {
        let light = f64::from(*v) - level;
        sum += light;
        moment[0] += light * r as f64;
        moment[1] += light * c as f64;
    }
    let inside = moment.iter().all(|m| (0.0..=last as f64).contains(&(m / sum)));
    (sum > 0.0 && inside).then(|| moment.map(|m| m / sum))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn a_patch_gives_the_windows_of_its_frame_and_says_where_it_does_not_reach() {
        let frame = Array2::from_shape_fn((30, 40), |(r, c)| (100 * r + c) as f32);
        let side = 5;
        for corner in [[10, 12], [-1, 3], [25, 35], [-9, 3], [40, 50]] {
            let patch = Patch::cut(&frame, corner, side);
            for moved in [[0, 0], [SLACK, -SLACK], [SLACK + 1, 0], [0, -SLACK - 1]] {
                let at = [corner[0] + moved[0], corner[1] + moved[1]];
                let inside = at[0] >= 0 && at[1] >= 0 && at[0] + side <= 30 && at[1] + side <= 40;
                let near = moved.iter().all(|d| d.abs() <= SLACK);
                assert!(!near || patch.holds(at, side), "{corner:?} {moved:?}");
                match patch.window(at, side) {
                    Some(window) => {
                        let [r, c] = at.map(|v| v as usize);
                        assert_eq!(window, frame.slice(s![r..r + 5, c..c + 5]), "{corner:?} {moved:?}");
                    }
                    None => assert!(!inside || !patch.holds(at, side), "{corner:?} {moved:?}"),
                }
            }
        }
        let patch = Patch::cut(&frame, [10, 12], side);
        assert!(!patch.holds([10 + SLACK + 1, 12], side) && !patch.holds([10, 12 - SLACK - 1], side));
    }

    #[test]
    fn the_centroid_is_that_of_the_light_above_its_border() {
        let mut window = Array2::from_elem((7, 7), 2.0f32);
        window[[2, 3]] += 30.0;
        window[[4, 3]] += 90.0;
        let at = centroid(window.view(), 1.0).unwrap();
        assert!((at[0] - 3.5).abs() < 1e-6 && (at[1] - 3.0).abs() < 1e-6, "{at:?}");
        assert_eq!(centroid(window.view(), 20.0), None);
        window[[0, 0]] = f32::NAN;
        assert_eq!(centroid(window.view(), 1.0), None);
    }
}
