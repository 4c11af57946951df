//! Single positions that disagree with their frames.

use super::hypotheses::Tried;
use super::scan::{SUSPECT, Scan, Small, add, dot, middle, without};
use super::{Finding, Severity};
use ndarray::Array2;
use serde::Serialize;

/// A place for its foci is found where its correlation reaches this share of the median one.
const FOUND: f64 = 0.75;
/// Pixels of the summed frames that a search uses: the brightest.
const BRIGHTEST: usize = 1500;
/// Most frames that are looked at more closely.
const MOST: usize = 24;

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
            let moved = off.iter().any(|o| o.abs() > 1.5 * scan.bin as f64);
            let fits = value > FOUND * typical;
            if fits && !moved {
                // In its place, but fainter, wider or cut off: nothing to do with the table.
                return None;
            }
            if !fits {
                // No place fits: foci that fell off the sensor, or another fault of the frame, but not of its row.
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
                "{}: frame {}: the table says x_um = {x}, y_um = {y}, but its foci lie {:.0} px away, where a bead at \
                 x_um = {shown_x:.0}, y_um = {shown_y:.0} would put them",
                o.file,
                o.frame,
                r.hypot(c)
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
