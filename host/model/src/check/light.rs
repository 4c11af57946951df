//! What changes over a bead scan: the light of the beads, and the level between their foci.
//!
//! Vignetting makes beads at the edge of the field fainter, and a scan may reach the edge early or late, as one does
//! whose frames lie in the order of their names. So what the light owes to the distance from the middle of the scan is
//! fitted along with its change in time. What changes evenly along one axis is no different from a drift in a scan line
//! by line.

use super::scan::{Scan, middle};
use super::{Finding, Severity};
use ndarray::Array2;
use ommatidia_physics::linalg::least_squares;

/// Change of the light of the beads over the scan that is worth a remark.
const DRIFT: f64 = 0.1;
/// Share of the usual light below which a bead frame shows none.
const LOST: f64 = 0.02;
/// Terms of the fit: a constant, four of the distance from the middle, and the time.
const TERMS: usize = 6;
/// Frames farther than this from the fit, robust standard deviations, do not count.
const OUTLIER: f64 = 5.0;

/// Takes the frames without light out of the scan: they show no foci. Names them.
pub(super) fn lost(scan: &mut Scan) -> Option<Finding> {
    let light: Vec<f64> = scan.frames.iter().map(|f| f.total_dn).collect();
    let typical = middle(&light);
    if scan.frames.len() < 9 || typical <= 0.0 {
        return None;
    }
    let names: Vec<usize> = scan.frames.iter().filter(|f| f.total_dn < LOST * typical).map(|f| f.frame).collect();
    scan.frames.retain(|f| f.total_dn >= LOST * typical);
    let (frames, show) = if names.len() == 1 { ("frame", "shows") } else { ("frames", "show") };
    let shown: Vec<String> = names.iter().take(5).map(ToString::to_string).collect();
    let more = if names.len() > shown.len() { ", ..." } else { "" };
    let text = format!(
        "{} bead {frames} {show} less than {:.0} % of the light of the others (frame {}{more}): remove them with their \
         rows, or measure them again",
        names.len(),
        100.0 * LOST,
        shown.join(", ")
    );
    (!names.is_empty()).then(|| Finding::new("light", Severity::Warning, text))
}

/// What changes over the scan.
pub(super) fn drift(scan: &Scan) -> Vec<Finding> {
    let mut findings = Vec::new();
    let n = scan.frames.len();
    if n < 9 {
        return findings;
    }
    let third = n / 3;
    let change = change(scan).unwrap_or(0.0);
    if change.abs() > DRIFT && scan.frames.iter().all(|f| f.z_um == scan.frames[0].z_um) {
        let text = format!(
            "the light of the beads changes by {:+.0} % from the first to the last third of the scan: a lamp that \
             drifts, a bead that bleaches, or vignetting along the scan",
            100.0 * change
        );
        findings.push(Finding::new("drift", Severity::Warning, text));
    }
    let level: Vec<f64> = scan.frames.iter().map(|f| f64::from(f.level_dn)).collect();
    let moved = middle(&level[n - third..]) - middle(&level[..third]);
    let spread = middle(&level.iter().map(|v| (v - middle(&level)).abs()).collect::<Vec<_>>());
    if moved.abs() > (6.0 * spread).max(2.0) {
        let text = format!(
            "the level between the foci moves by {moved:+.1} DN from the first to the last third of the scan: black \
             level or stray light drift. `calibrate` takes the level of each frame off"
        );
        findings.push(Finding::new("drift", Severity::Warning, text));
    }
    findings
}

/// Change of the light from the first to the last third of the scan, relative to the usual light, beside what it owes
/// to the distance from the middle of the scan. None where that cannot be fitted.
fn change(scan: &Scan) -> Option<f64> {
    let light: Vec<f64> = scan.frames.iter().map(|f| f.total_dn).collect();
    let typical = middle(&light);
    let reach = scan.all_moved_px.iter().flatten().fold(1.0f64, |m, v| m.max(v.abs()));
    let last = (light.len() - 1) as f64;
    let rows: Vec<[f64; TERMS]> = scan
        .frames
        .iter()
        .enumerate()
        .map(|(i, f)| {
            let [r, c] = f.moved_px.map(|v| v / reach);
            [1.0, r * r, r * c, c * c, (r * r + c * c).powi(2), 2.0 * i as f64 / last - 1.0]
        })
        .collect();
    let value = |row: &[f64; TERMS], terms: &[f64; TERMS]| row.iter().zip(terms).map(|(x, t)| x * t).sum::<f64>();
    let mut terms = [0.0; TERMS];
    let mut limit = f64::INFINITY;
    for _ in 0..3 {
        let kept: Vec<usize> =
            (0..rows.len()).filter(|i| (light[*i] - value(&rows[*i], &terms)).abs() <= limit).collect();
        let design = Array2::from_shape_fn((kept.len(), TERMS), |(i, j)| rows[kept[i]][j]);
        let found = least_squares(&design, &Array2::from_shape_fn((kept.len(), 1), |(i, _)| light[kept[i]])).ok()?;
        terms = std::array::from_fn(|i| found[[i, 0]]);
        let off: Vec<f64> = rows.iter().zip(&light).map(|(row, y)| (y - value(row, &terms)).abs()).collect();
        limit = OUTLIER * 1.4826 * middle(&off).max(1e-6 * typical.abs());
    }
    // The middles of the first and the last third are two thirds of the scan apart, which is 4/3 of these times.
    (typical.abs() > 0.0).then(|| terms[TERMS - 1] * 4.0 / 3.0 / typical.abs())
}
