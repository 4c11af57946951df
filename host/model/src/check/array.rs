//! The lenses that the foci form, against those that the manifest declares.
//!
//! Frames that are moved back by their positions add up to one bright spot a lens. Spots that form a complete lattice
//! of another shape or pitch than the declared one mean a wrong manifest; gaps in the right lattice are lenses that
//! show nothing. Where the spots or the declared places form no lattice, each is looked for among the others.

use super::hypotheses::Tried;
use super::scan::{Scan, median};
use super::{Finding, FocusPair, Outlier, Severity};
use ndarray::Array2;
use ommatidia_session::{ArrayGeometry, Manifest};

/// A spot counts if it is brighter than this share of the brightest.
const BRIGHT: f32 = 0.08;
/// And by this many robust standard deviations of the sum.
const CONTRAST: f32 = 8.0;
/// Radius within which only the brightest spot counts, as a share of the nominal window.
const RADIUS: f64 = 0.75;
/// Largest relative difference of a pitch from the declared one.
const PITCH: f64 = 0.15;
/// A spot belongs to a declared place within this share of the pitch.
const NEAR: f64 = 0.3;
/// A letter F, [row, col] from -1 to 1.
const LETTER: [[f64; 2]; 8] =
    [[1.0, -0.6], [0.5, -0.6], [0.0, -0.6], [-0.5, -0.6], [-1.0, -0.6], [-1.0, 0.0], [-1.0, 0.6], [0.0, 0.0]];

/// The spots of the summed frames.
#[derive(Clone, Debug)]
pub struct Lattice {
    /// Spots, sensor pixels [row, col].
    pub lenses_px: Vec<[f64; 2]>,
    /// Rows and columns that they form; None where they do not fill a lattice.
    pub shape: Option<[usize; 2]>,
    /// Their distance, sensor pixels; None for a single lens.
    pub pitch_px: Option<f64>,
}

/// Finds the spots of the summed frames.
pub fn lattice(scan: &Scan, tried: &Tried, m: &Manifest) -> Lattice {
    let none = Lattice { lenses_px: Vec::new(), shape: None, pitch_px: None };
    if !tried.testable || tried.coincidence < 0.2 {
        return none;
    }
    let bin = scan.bin as f64;
    let spots = spots(&scan.sum(&tried.moved), (RADIUS * m.optics.psf_window_px as f64 / bin).max(2.0));
    let lenses_px: Vec<[f64; 2]> = spots.iter().map(|p| p.map(|v| (v + 0.5) * bin - 0.5)).collect();
    let gap = 0.5 * m.optics.psf_window_px as f64;
    let lines = [0, 1].map(|a| levels(lenses_px.iter().map(|p| p[a]).collect(), gap));
    // Lenses are numbered row by row.
    let line = |a: usize, v: f64| lines[a].iter().filter(|l| **l < v - gap).count();
    let mut lenses_px = lenses_px;
    lenses_px.sort_by(|a, b| line(0, a[0]).cmp(&line(0, b[0])).then(a[1].total_cmp(&b[1])));
    let full = lines[0].len() * lines[1].len();
    // One lens may be dark without making the lattice doubtful.
    let shape = (full <= lenses_px.len() + full / 6 && !lenses_px.is_empty()).then(|| [lines[0].len(), lines[1].len()]);
    let mut steps: Vec<f32> =
        lines.iter().flat_map(|l| l.windows(2).map(|w| (w[1] - w[0]) as f32).collect::<Vec<_>>()).collect();
    let pitch_px = (!steps.is_empty()).then(|| f64::from(median(&mut steps)));
    Lattice { lenses_px, shape, pitch_px }
}

/// Local maxima of an image, brightest first.
fn spots(sum: &Array2<f32>, radius: f64) -> Vec<[f64; 2]> {
    let mut values: Vec<f32> = sum.iter().copied().collect();
    let level = median(&mut values);
    values.iter_mut().for_each(|v| *v = (*v - level).abs());
    let spread = 1.4826 * median(&mut values);
    let top = sum.iter().fold(0.0f32, |m, v| m.max(*v)) - level;
    let floor = (BRIGHT * top).max(CONTRAST * spread);
    let mut bright: Vec<(f32, [f64; 2])> =
        sum.indexed_iter().filter(|(_, v)| **v - level > floor).map(|((r, c), v)| (*v, [r as f64, c as f64])).collect();
    bright.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut found: Vec<[f64; 2]> = Vec::new();
    for (v, at) in bright {
        let near = |f: &[f64; 2]| (f[0] - at[0]).abs().max((f[1] - at[1]).abs()) <= radius;
        // A shoulder of a brighter spot is no maximum of its own.
        let (r, c) = (at[0] as usize, at[1] as usize);
        let around = sum.slice(ndarray::s![
            r.saturating_sub(1)..(r + 2).min(sum.nrows()),
            c.saturating_sub(1)..(c + 2).min(sum.ncols())
        ]);
        if !found.iter().any(near) && around.iter().all(|o| *o <= v) {
            found.push(at);
        }
    }
    found
}

/// Means of values that lie closer together than `gap`, ascending.
fn levels(mut values: Vec<f64>, gap: f64) -> Vec<f64> {
    values.sort_by(f64::total_cmp);
    let mut groups: Vec<Vec<f64>> = Vec::new();
    for v in values {
        match groups.last_mut() {
            Some(group) if v - group[group.len() - 1] < gap => group.push(v),
            _ => groups.push(vec![v]),
        }
    }
    groups.iter().map(|g| g.iter().sum::<f64>() / g.len() as f64).collect()
}

/// What the lattice means for the user.
pub fn describe(lattice: &Lattice, m: &Manifest, scan: &Scan) -> Vec<Finding> {
    let declared = [m.array.rows, m.array.cols];
    let count = lattice.lenses_px.len();
    if count == 0 {
        return Vec::new();
    }
    let places = m.array.places_px(&m.sensor);
    let is_grid = m.array.lenses_px.is_none();
    let (Some(shape), true) = (lattice.shape, is_grid) else { return one_by_one(lattice, &places, m, scan) };
    let words = |[rows, cols]: [usize; 2]| ArrayGeometry::grid(rows, cols, 0.0).words();
    let pitch = lattice.pitch_px.map_or(String::new(), |p| format!(", {p:.1} px apart"));
    let declares = declares(m);
    let error = |text: String| vec![Finding::new("array", Severity::Error, text)];
    let ratio = lattice.pitch_px.map(|p| p / m.array.pitch_px).filter(|_| m.array.lenses() > 1);
    if shape != declared && m.array.lenses() > 1 {
        let dead = if shape[0] <= declared[0] && shape[1] <= declared[1] {
            "; if the array is as declared, whole rows or columns of lenses are dark: look for what blocks them"
        } else {
            ""
        };
        return error(format!(
            "the foci form {}{pitch}; {declares}: correct [array] in session.toml{dead}",
            words(shape)
        ));
    }
    if m.array.lenses() == 1 && count > 1 && shape[0] * shape[1] > 1 {
        return several_of_one(count, &pitch);
    }
    if let Some(ratio) = ratio.filter(|r| (r - 1.0).abs() > PITCH) {
        let factor = if ratio > 1.0 {
            format!("{ratio:.2} times the declared pitch")
        } else {
            format!("the declared pitch over {:.2}", 1.0 / ratio)
        };
        return error(format!(
            "the foci of neighbouring lenses lie {:.1} px apart, {factor}; {declares}: correct array.pitch_px",
            ratio * m.array.pitch_px
        ));
    }
    let dead = m.array.lenses().saturating_sub(count);
    if dead > 0 {
        return dark(dead, m);
    }
    let text = format!("the foci form {}{pitch}, as declared", words(shape));
    vec![Finding::new("array", Severity::Ok, format!("{text} ({} bead frames)", scan.frames.len()))]
}

/// What spots mean that form no grid, or should form none: each declared place is looked for among them.
fn one_by_one(lattice: &Lattice, places: &[[f64; 2]], m: &Manifest, scan: &Scan) -> Vec<Finding> {
    let spots = &lattice.lenses_px;
    if places.len() == 1 {
        return if spots.len() > 1 { several_of_one(spots.len(), "") } else { Vec::new() };
    }
    let near = matches(spots, places, NEAR * m.array.pitch_px);
    let (found, elsewhere) = (near.iter().flatten().count(), spots.len() - near.iter().flatten().count());
    if elsewhere == 0 && found < places.len() {
        return dark(places.len() - found, m);
    }
    if elsewhere == 0 {
        let text = format!("the foci of {found} lenses lie where they are declared");
        return vec![Finding::new("array", Severity::Ok, format!("{text} ({} bead frames)", scan.frames.len()))];
    }
    // Reflections shine beside lenses, too, and lenses may be dark: a third of the places must be empty for them to be
    // wrong.
    let severity = if 3 * found < 2 * places.len() { Severity::Error } else { Severity::Warning };
    let list: Vec<String> = spots.iter().map(|p| format!("[{:.0}, {:.0}]", p[0], p[1])).collect();
    let text = format!(
        "the foci of one bead form {} spots, {found} of them where a lens is declared and {elsewhere} elsewhere; {}: \
         if each spot is a lens, write under [array] in session.toml `rows = 1`, `cols = {}`, `pitch_px = {:.0}` and \
         `lenses_px = [{}]`; if not, look for what else shines",
        spots.len(),
        declares(m),
        spots.len(),
        usual_distance(spots),
        list.join(", ")
    );
    vec![Finding::new("array", severity, text)]
}

/// For each place the spot that lies within `reach`, with the common shift of all places under which the most have one;
/// of equal shifts the smallest.
fn matches(spots: &[[f64; 2]], places: &[[f64; 2]], reach: f64) -> Vec<Option<usize>> {
    let under = |shift: [f64; 2]| -> Vec<Option<usize>> {
        let off = |s: &[f64; 2], p: &[f64; 2]| (s[0] - p[0] - shift[0]).hypot(s[1] - p[1] - shift[1]);
        let nearest = |p: &[f64; 2]| (0..spots.len()).min_by(|a, b| off(&spots[*a], p).total_cmp(&off(&spots[*b], p)));
        places.iter().map(|p| nearest(p).filter(|s| off(&spots[*s], p) <= reach)).collect()
    };
    let shifts = spots.iter().flat_map(|s| places.iter().map(move |p| [s[0] - p[0], s[1] - p[1]]));
    let by_worth = shifts.map(|shift| {
        let found = under(shift);
        (found.iter().flatten().count(), shift[0].hypot(shift[1]), found)
    });
    let best = by_worth.max_by(|a, b| a.0.cmp(&b.0).then(b.1.total_cmp(&a.1)));
    best.map_or_else(|| vec![None; places.len()], |(.., found)| found)
}

/// Median distance of a spot to the nearest other one, sensor pixels.
fn usual_distance(spots: &[[f64; 2]]) -> f32 {
    let distance = |a: &[f64; 2], b: &[f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
    let nearest = |i: usize| {
        let others = spots.iter().enumerate().filter(|(j, _)| *j != i);
        others.map(|(_, b)| distance(&spots[i], b)).fold(f64::INFINITY, f64::min) as f32
    };
    median(&mut (0..spots.len()).map(nearest).collect::<Vec<_>>())
}

/// What the manifest declares, in words.
fn declares(m: &Manifest) -> String {
    format!("session.toml declares {}, {} px apart", m.array.words(), m.array.pitch_px)
}

/// The finding that some lenses show nothing.
fn dark(lenses: usize, m: &Manifest) -> Vec<Finding> {
    let text =
        format!("{lenses} of {} lenses show no focus: clean or unblock them, and measure again", m.array.lenses());
    vec![Finding::new("lenses", Severity::Warning, text)]
}

/// The finding that one lens has several spots.
fn several_of_one(spots: usize, pitch: &str) -> Vec<Finding> {
    let text = format!(
        "the foci of one bead form {spots} spots{pitch}; session.toml declares one lens: if there are more, correct \
         [array]; if one PSF has several spots, let psf_window_px hold all of them"
    );
    vec![Finding::new("array", Severity::Warning, text)]
}

/// Predicted and found foci of some frames, for a picture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shown {
    /// Where table and manifest put the foci, and where they were found.
    pub pairs: Vec<FocusPair>,
    /// Brightest light of these frames in each small pixel, DN.
    pub light: Array2<f32>,
    /// Sensor pixels along one side of a small pixel.
    pub bin: usize,
}

/// The frames whose positions, by the table, draw a letter F in the middle of the field: no mirror image and no turn of
/// it is an F. It is small enough for those of neighbouring lenses to stay apart, if the scan is fine enough.
fn letter(scan: &Scan, m: &Manifest) -> Vec<usize> {
    let far = |a: usize| scan.frames.iter().map(|f| f.moved_px[a].abs()).fold(0.0, f64::max);
    let step = 2.0 * (far(0) * far(1) / scan.frames.len().max(1) as f64).sqrt();
    let own = if m.array.lenses() > 1 { (0.36 * m.array.pitch_px).max(2.0 * step) } else { f64::INFINITY };
    let half = [0, 1].map(|a| far(a).min(own));
    let mut frames: Vec<usize> = LETTER
        .iter()
        .filter_map(|[row, col]| {
            let at = [row * half[0], col * half[1]];
            let off = |n: &usize| {
                let moved = scan.frames[*n].moved_px;
                (moved[0] - at[0]).powi(2) + (moved[1] - at[1]).powi(2)
            };
            (0..scan.frames.len()).min_by(|a, b| off(a).total_cmp(&off(b)))
        })
        .collect();
    frames.sort_unstable();
    frames.dedup();
    frames
}

/// The foci of frames that draw a letter F, and of all outliers. The anchors are those that the frames show (those of
/// the manifest, where they show none); from there the foci move by the table, or as they were found to move.
pub fn foci(scan: &Scan, tried: &Tried, lattice: &Lattice, outliers: &[Outlier], m: &Manifest) -> Shown {
    let letter = letter(scan, m);
    let anchors = if lattice.lenses_px.is_empty() { m.array.places_px(&m.sensor) } else { lattice.lenses_px.clone() };
    let dim = scan.frames.first().map_or((0, 0), |f| f.light.dim());
    let mut shown = Shown { pairs: Vec::new(), light: Array2::zeros(dim), bin: scan.bin };
    for (n, f) in scan.frames.iter().enumerate() {
        let outlier = outliers.iter().find(|o| o.bead == f.bead);
        if !letter.contains(&n) && outlier.is_none() {
            continue;
        }
        shown.light.zip_mut_with(&f.light, |a, b| *a = a.max(*b));
        let off = outlier.map_or([0.0; 2], |o| o.off_px);
        for (lens, anchor) in anchors.iter().enumerate() {
            let at = |moved: [f64; 2]| [anchor[0] + moved[0], anchor[1] + moved[1]];
            let found = [tried.moved[n][0] + off[0], tried.moved[n][1] + off[1]];
            let found_px = (!lattice.lenses_px.is_empty()).then(|| at(found));
            shown.pairs.push(FocusPair { bead: f.bead, lens, predicted_px: at(f.moved_px), found_px });
        }
    }
    shown
}
