//! Single positions that disagree with their frames.
//!
//! A frame is suspected where it coincides badly with the sum of all frames, and better at another place. Strong
//! aberrations do the same at the edges and corners of a field: coma and distortion displace the foci there. They
//! change smoothly over the field, so the neighbours of the frame are displaced nearly alike, whereas a wrong row
//! stands alone. A suspect is therefore named only if its foci lie elsewhere than those of its neighbours in the
//! table, by more than a smooth field can change from one position to the next.

use super::hypotheses::Tried;
use super::scan::{SUSPECT, Scan, Small, add, dot, middle, without};
use super::{Finding, Severity};
use ndarray::Array2;
use ommatidia_session::{fixed, trimmed};
use serde::Serialize;

/// A place for its foci is found where its correlation reaches this share of the median one.
const FOUND: f64 = 0.75;
/// Pixels of the summed frames that a search uses: the brightest.
const BRIGHTEST: usize = 1500;
/// Most frames that are looked at more closely.
const MOST: usize = 24;
/// Foci lie elsewhere from this many small pixels on.
const MOVED: f64 = 1.5;
/// Neighbours that show where the foci of a frame belong: those around a position of a raster.
const NEIGHBOURS: usize = 8;
/// From one position to its neighbours, aberrations displace foci by less than this share of the distance: the local
/// magnification would differ by as much.
const STEEPEST: f64 = 0.25;

/// A bead frame whose foci lie elsewhere than its row says.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Outlier {
    /// Index of the frame among all bead frames.
    pub bead: usize,
    /// Its file, and its index there.
    pub file: String,
    /// Index in the file.
    pub frame: usize,
    /// Position in the table, um [y, x].
    pub at_um: [f64; 2],
    /// Where its foci lie, from where the table puts them, sensor pixels [row, col].
    pub off_px: [f64; 2],
    /// The position that its foci show, um [y, x].
    pub shown_um: [f64; 2],
}

/// The frames that coincide with the others much less than most do.
pub fn outliers(scan: &Scan, tried: &Tried) -> Vec<Outlier> {
    if !tried.testable || scan.frames.len() < 6 {
        return Vec::new();
    }
    let typical = middle(&tried.by_frame);
    let mut suspects: Vec<usize> = (0..scan.frames.len()).filter(|n| tried.by_frame[*n] < SUSPECT * typical).collect();
    suspects.sort_by(|a, b| tried.by_frame[*a].total_cmp(&tried.by_frame[*b]));
    suspects.truncate(MOST);
    let sum = scan.sum(&tried.moved);
    let reach = reach(scan);
    let noise: f64 = scan.frames.iter().map(|f| f.noise_dn2).sum();
    let mut found: Vec<Outlier> = suspects
        .into_iter()
        .filter_map(|n| {
            let f = &scan.frames[n];
            let mut others = sum.clone();
            let mut own = Array2::zeros(others.dim());
            add(&mut own, &f.light, scan.steps(tried.moved[n]), 1.0);
            others -= &own;
            let (by, value) = search(f, &others, (reach, noise - f.noise_dn2));
            let here = scan.steps(tried.moved[n]);
            let off = [0, 1].map(|a| ((by[a] - here[a]) * scan.bin as isize) as f64);
            let moved = off.iter().any(|o| o.abs() > MOVED * scan.bin as f64);
            if value <= FOUND * typical || !moved {
                // In its place, but fainter, wider or cut off; or no place fits: foci that fell off the sensor, or
                // another fault of the frame, but not of its row.
                return None;
            }
            let around = Neighbours::of(scan, tried, n);
            let (by, _) = search(f, &around.sum, (reach, around.noise_dn2));
            let from_them = [0, 1].map(|a| ((by[a] - here[a]) * scan.bin as isize) as f64);
            if from_them[0].hypot(from_them[1]) <= around.most_px(scan.bin) {
                // Its neighbours are displaced as well: aberrations of the field.
                return None;
            }
            let um_per_px = um_per_px(scan);
            Some(Outlier {
                bead: f.bead,
                file: f.file.clone(),
                frame: f.frame,
                at_um: f.at_um,
                off_px: off,
                shown_um: [0, 1].map(|a| f.at_um[a] + off[a] * um_per_px),
            })
        })
        .collect();
    found.sort_by_key(|o| o.bead);
    found
}

/// The frames next to one in the table.
struct Neighbours {
    /// Their sum, each moved back by its position, the nearest ones with the largest weights.
    sum: Array2<f32>,
    /// Sum of the squares that the noise adds to those of the sum.
    noise_dn2: f64,
    /// Their mean distance with these weights, sensor pixels.
    distance_px: f64,
}

impl Neighbours {
    fn of(scan: &Scan, tried: &Tried, n: usize) -> Self {
        let distance = |m: usize| [0, 1].map(|a| tried.moved[m][a] - tried.moved[n][a]);
        let mut near: Vec<(f64, usize)> =
            (0..scan.frames.len()).filter(|m| *m != n).map(|m| (distance(m)[0].hypot(distance(m)[1]), m)).collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        near.truncate(NEIGHBOURS);
        let mut found = Self { sum: Array2::zeros(scan.frames[n].light.dim()), noise_dn2: 0.0, distance_px: 0.0 };
        let mut weights = 0.0;
        for (px, m) in near {
            // A repeated position counts, but no more than one at the distance of a small pixel.
            let steps = px / scan.bin as f64;
            let weight = 1.0 / (1.0 + steps * steps);
            add(&mut found.sum, &scan.frames[m].light, scan.steps(tried.moved[m]), weight as f32);
            found.noise_dn2 += weight * weight * scan.frames[m].noise_dn2;
            found.distance_px += weight * px;
            weights += weight;
        }
        found.distance_px /= f64::max(weights, f64::MIN_POSITIVE);
        found
    }

    /// How far foci may lie from theirs without a fault of the row, sensor pixels.
    fn most_px(&self, bin: usize) -> f64 {
        f64::max(MOVED * bin as f64, STEEPEST * self.distance_px)
    }
}

/// Micrometres of the stage for one sensor pixel, from the table.
fn um_per_px(scan: &Scan) -> f64 {
    let pairs = scan.frames.iter().flat_map(|f| (0..2).map(|a| (f.at_um[a].abs(), f.moved_px[a].abs())));
    let (um, px) = pairs.fold((0.0, 0.0), |(u, p), (a, b)| (u + a, p + b));
    if px > 0.0 { um / px } else { 0.0 }
}

/// Largest motion that is searched, small pixels.
fn reach(scan: &Scan) -> [isize; 2] {
    let most = scan.frames.first().map_or([0, 0], |f| [f.light.nrows() as isize / 2, f.light.ncols() as isize / 2]);
    [0, 1].map(|a| {
        let far = scan.all_moved_px.iter().map(|m| scan.steps(*m)[a].abs()).max().unwrap_or(0);
        (far + far / 4 + 4).min(most[a])
    })
}

/// The motion of a frame's foci, in small pixels, at which it correlates best with the sum of the other frames, whose
/// noise has the sum of squares `noise_dn2`; and that correlation.
fn search(frame: &Small, others: &Array2<f32>, (reach, noise_dn2): ([isize; 2], f64)) -> ([isize; 2], f64) {
    let light = &frame.light;
    let mut bright: Vec<([isize; 2], f32)> =
        others.indexed_iter().map(|((r, c), v)| ([r as isize, c as isize], *v)).collect();
    let keep = BRIGHTEST.min(bright.len());
    if keep == 0 {
        return ([0, 0], 0.0);
    }
    bright.select_nth_unstable_by(keep - 1, |a, b| b.1.total_cmp(&a.1));
    bright.truncate(keep);
    let at = |p: [isize; 2]| if p[0] < 0 || p[1] < 0 { None } else { light.get([p[0] as usize, p[1] as usize]) };
    let mut best = ([0, 0], f64::NEG_INFINITY);
    for dr in -reach[0]..=reach[0] {
        for dc in -reach[1]..=reach[1] {
            let value: f64 =
                bright.iter().filter_map(|(p, v)| Some(f64::from(*at([p[0] + dr, p[1] + dc])?) * f64::from(*v))).sum();
            if value > best.1 {
                best = ([dr, dc], value);
            }
        }
    }
    // The correlation with all pixels, as for the other frames.
    let mut own = Array2::zeros(others.dim());
    add(&mut own, light, best.0, 1.0);
    let norm = (without(dot(light, light), frame.noise_dn2) * without(dot(others, others), noise_dn2)).sqrt();
    (best.0, if norm > 0.0 { dot(&own, others) / norm } else { 0.0 })
}

/// What outlying positions mean for the user.
pub fn describe(outliers: &[Outlier], scan: &Scan, tried: &Tried) -> Vec<Finding> {
    if outliers.is_empty() {
        return Vec::new();
    }
    if tried.best != super::Hypothesis::AS_IS {
        // The table as a whole is wrong: that comes first.
        return Vec::new();
    }
    let named: Vec<String> = outliers
        .iter()
        .take(5)
        .map(|o| {
            let ([y, x], [r, c], [shown_y, shown_x]) = (o.at_um, o.off_px, o.shown_um);
            format!(
                "{}: frame {}: the table says x_um = {}, y_um = {}, but its foci lie {:.0} px away, where a bead at \
                 x_um = {}, y_um = {} would put them",
                o.file,
                o.frame,
                trimmed(x, 3),
                trimmed(y, 3),
                r.hypot(c),
                fixed(shown_x, 0),
                fixed(shown_y, 0)
            )
        })
        .collect();
    let more = outliers.len().saturating_sub(named.len());
    let more = if more > 0 { format!("; and {more} more") } else { String::new() };
    let text = format!(
        "{}{more} ({} of {} frames): correct the row, or remove it with its frame",
        named.join("; "),
        outliers.len(),
        scan.frames.len()
    );
    vec![Finding::new("single positions", Severity::Error, text)]
}
