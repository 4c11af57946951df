//! Slow motion of the foci during the scan, beyond what the table says: a stage or an array that creeps.
//!
//! Each frame, moved back by its position, is compared with the sum of all: `f(x) = a (S(x) - d . grad S(x))` by least
//! squares gives its displacement d. The displacements of all frames are then fitted with what optics may do to them
//! (another magnification, a turn, radial distortion and its centre) and with a drift, linear and quadratic in time. In
//! a scan line by line the row follows time, so that a wrong magnification looks like a drift along the rows; it acts
//! on the columns as well, which tells the two apart. The scatter about the fit gives the standard errors.

use super::hypotheses::Tried;
use super::scan::{SUSPECT, Scan, Small, median, middle};
use super::{Finding, Hypothesis, Outlier, Severity};
use ndarray::Array2;
use ommatidia_physics::linalg::least_squares;
use serde::Serialize;

/// Fewest frames from which a drift is estimated.
const FEWEST: usize = 25;
/// Chi-squared of the four terms of a drift from which it counts: five standard deviations of noise, 35 for four
/// degrees
/// of freedom, and some room for the scatter that the standard errors are taken from.
const SEEN_CHI2: f64 = 45.0;
/// Smallest drift that is worth a finding, sensor pixels times the root of the number of lenses. Aberrations that
/// change
/// over the field move foci too, differently behind each lens, and the scan goes through the field in the course of
/// time. This is twice the largest figure of 24 virtual instruments of one to nine lenses that did not move.
const LEAST_PX: f64 = 0.3;
/// Rounds of displacements and fit: each moves the frames back by what the last one found.
const ROUNDS: usize = 4;
/// Pixels of the summed frames count where they are brighter than this share of the brightest.
const BRIGHT: f32 = 0.03;
/// Terms of the fit: two offsets, magnification, turn, distortion and its centre, and the drift.
const TERMS: usize = 11;
/// The first term of the drift: linear and quadratic along the rows, then along the columns.
const DRIFT: usize = 7;
/// Displacements farther than this from the fit, robust standard deviations, do not count.
const OUTLIER: f64 = 5.0;

/// A drift of the foci over the scan, sensor pixels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Drift {
    /// From the first to the last frame, [row, col], px.
    pub moved_px: [f64; 2],
    /// Standard errors, px.
    pub sigma_px: [f64; 2],
    /// Largest distance between two moments of the scan, px: larger than `moved_px` where the foci come back.
    pub range_px: f64,
    /// Chi-squared of the drift, four degrees of freedom.
    pub chi2: f64,
    /// Scatter of single frames about the fit, px rms along one axis.
    pub scatter_px: f64,
    /// Whether it is significant, and large enough to matter.
    pub seen: bool,
}

/// Estimates the drift of the foci of `lenses` lenses; None where the table does not agree with the frames, or there
/// are too few.
pub fn drift(scan: &Scan, tried: &Tried, outliers: &[Outlier], lenses: usize) -> Option<Drift> {
    if !tried.testable || tried.best != Hypothesis::AS_IS {
        return None;
    }
    let typical = middle(&tried.by_frame);
    let used: Vec<usize> = (0..scan.frames.len())
        .filter(|n| tried.by_frame[*n] > SUSPECT * typical)
        .filter(|n| outliers.iter().all(|o| o.bead != scan.frames[*n].bead))
        .collect();
    if used.len() < FEWEST {
        return None;
    }
    let times = times(scan, &used)?;
    let reach = scan.all_moved_px.iter().flatten().fold(1.0f64, |m, v| m.max(v.abs()));
    let design: Vec<[[f64; TERMS]; 2]> = used
        .iter()
        .zip(&times)
        .map(|(n, t)| {
            let [r, c] = scan.frames[*n].moved_px.map(|v| v / reach);
            let far = r * r + c * c;
            [
                [1.0, 0.0, r, -c, r * far, 3.0 * r * r + c * c, 2.0 * r * c, *t, t * t, 0.0, 0.0],
                [0.0, 1.0, c, r, c * far, 2.0 * r * c, 3.0 * c * c + r * r, 0.0, 0.0, *t, t * t],
            ]
        })
        .collect();
    let mut shift_px = vec![[0.0; 2]; used.len()];
    let mut found = None;
    for _ in 0..ROUNDS {
        let here = displacements(scan, &used, &shift_px);
        let fit = Fit::of(&design, &here)?;
        shift_px = design.iter().map(|x| [0, 1].map(|a| fit.value(&x[a]))).collect();
        found = Some(fit);
    }
    found.map(|fit| fit.drift(LEAST_PX / (lenses.max(1) as f64).sqrt()))
}

/// Times of the frames, from -1 at the first to 1 at the last; by their order where the table has no times.
fn times(scan: &Scan, used: &[usize]) -> Option<Vec<f64>> {
    let of = |n: &usize| {
        let f: &Small = &scan.frames[*n];
        (f.time_s, f.bead as f64)
    };
    let all: Vec<(f64, f64)> = used.iter().map(of).collect();
    let range = |v: &dyn Fn(&(f64, f64)) -> f64| {
        all.iter().map(v).fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], v| [l.min(v), h.max(v)])
    };
    let by_time = |p: &(f64, f64)| p.0;
    let by_order = |p: &(f64, f64)| p.1;
    let [low, high] = range(&by_time);
    let (timed, [low, high]) = if high > low { (true, [low, high]) } else { (false, range(&by_order)) };
    let at = |p: &(f64, f64)| 2.0 * ((if timed { p.0 } else { p.1 }) - low) / (high - low) - 1.0;
    (high > low).then(|| all.iter().map(at).collect())
}

/// Displacement of each frame from its position in the table, sensor pixels, where `shift_px` is known already.
fn displacements(scan: &Scan, used: &[usize], shift_px: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let moved: Vec<[f64; 2]> =
        used.iter().zip(shift_px).map(|(n, s)| [0, 1].map(|a| scan.frames[*n].moved_px[a] + s[a])).collect();
    let Some(first) = scan.frames.first() else { return Vec::new() };
    let mut sum = Array2::<f32>::zeros(first.light.dim());
    for (n, by) in used.iter().zip(&moved) {
        super::scan::add(&mut sum, &scan.frames[*n].light, scan.steps(*by), 1.0);
    }
    let top = sum.iter().fold(0.0f32, |m, v| m.max(*v));
    let (rows, cols) = sum.dim();
    // Brightness and slopes of the sum, at its bright pixels.
    let bright: Vec<([isize; 2], [f64; 3])> = sum
        .indexed_iter()
        .filter(|((r, c), v)| **v > BRIGHT * top && *r > 0 && *c > 0 && r + 1 < rows && c + 1 < cols)
        .map(|((r, c), v)| {
            let slope = |a: [usize; 2], b: [usize; 2]| 0.5 * f64::from(sum[a] - sum[b]);
            let slopes = [slope([r + 1, c], [r - 1, c]), slope([r, c + 1], [r, c - 1])];
            ([r as isize, c as isize], [f64::from(*v), slopes[0], slopes[1]])
        })
        .collect();
    used.iter()
        .zip(&moved)
        .zip(shift_px)
        .map(|((n, by), shift)| {
            let steps = scan.steps(*by);
            let light = &scan.frames[*n].light;
            let mut gram = Array2::<f64>::zeros((3, 3));
            let mut right = Array2::<f64>::zeros((3, 1));
            for (at, x) in &bright {
                let from = [at[0] + steps[0], at[1] + steps[1]];
                if from[0] < 0 || from[1] < 0 {
                    continue;
                }
                let Some(v) = light.get([from[0] as usize, from[1] as usize]) else { continue };
                for i in 0..3 {
                    right[[i, 0]] += x[i] * f64::from(*v);
                    (0..3).for_each(|j| gram[[i, j]] += x[i] * x[j]);
                }
            }
            let bin = scan.bin as f64;
            let part = [0, 1].map(|a| by[a] / bin - steps[a] as f64);
            match least_squares(&gram, &right) {
                Ok(x) if x[[0, 0]] > 0.0 => {
                    // The fraction of a step that was not moved back is no displacement.
                    [0, 1].map(|a| shift[a] + bin * (-x[[a + 1, 0]] / x[[0, 0]] - part[a]))
                }
                _ => [f64::NAN; 2],
            }
        })
        .collect()
}

/// The fit of all displacements.
struct Fit {
    terms: [f64; TERMS],
    covariance: Array2<f64>,
    scatter_px: f64,
}

impl Fit {
    fn of(design: &[[[f64; TERMS]; 2]], found: &[[f64; 2]]) -> Option<Self> {
        let mut terms = [0.0; TERMS];
        let mut limit = f64::INFINITY;
        for round in 0..3 {
            let mut gram = Array2::<f64>::zeros((TERMS, TERMS));
            let mut right = Array2::<f64>::zeros((TERMS, 1));
            let (mut squares, mut count) = (0.0, 0.0);
            let off = |terms: &[f64; TERMS], x: &[f64; TERMS], y: f64| {
                y - x.iter().zip(terms).map(|(x, t)| x * t).sum::<f64>()
            };
            for (x, y) in design.iter().zip(found).flat_map(|(x, y)| x.iter().zip(y)) {
                let rest = off(&terms, x, *y);
                if !y.is_finite() || rest.abs() > limit {
                    continue;
                }
                (squares, count) = (squares + rest * rest, count + 1.0);
                for i in 0..TERMS {
                    right[[i, 0]] += x[i] * y;
                    (0..TERMS).for_each(|j| gram[[i, j]] += x[i] * x[j]);
                }
            }
            if count < 2.0 * FEWEST as f64 {
                return None;
            }
            let solution = least_squares(&gram, &right).ok()?;
            terms = std::array::from_fn(|i| solution[[i, 0]]);
            let rests = design.iter().zip(found).flat_map(|(x, y)| x.iter().zip(y));
            let mut sizes: Vec<f32> =
                rests.map(|(x, y)| off(&terms, x, *y).abs() as f32).filter(|v| v.is_finite()).collect();
            limit = OUTLIER * 1.4826 * f64::from(median(&mut sizes)).max(1e-6);
            if round == 2 {
                // `squares` is about the terms of the round before, which hardly differ.
                let variance = squares / (count - TERMS as f64);
                let covariance = least_squares(&gram, &Array2::eye(TERMS)).ok()?.mapv(|v| v * variance);
                return Some(Self { terms, covariance, scatter_px: variance.sqrt() });
            }
        }
        None
    }

    fn value(&self, x: &[f64; TERMS]) -> f64 {
        x.iter().zip(&self.terms).map(|(x, t)| x * t).sum()
    }

    fn drift(&self, least_px: f64) -> Drift {
        let terms: [f64; 4] = std::array::from_fn(|i| self.terms[DRIFT + i]);
        let own = self.covariance.slice(ndarray::s![DRIFT.., DRIFT..]).to_owned();
        let column = Array2::from_shape_fn((4, 1), |(i, _)| terms[i]);
        let chi2 = least_squares(&own, &column).map_or(0.0, |x| (0..4).map(|i| x[[i, 0]] * terms[i]).sum());
        let at = |t: f64| [0, 1].map(|a| terms[2 * a] * t + terms[2 * a + 1] * t * t);
        let moments: Vec<[f64; 2]> = (0..=40).map(|i| at(f64::from(i) / 20.0 - 1.0)).collect();
        let apart = |p: &[f64; 2], q: &[f64; 2]| (p[0] - q[0]).hypot(p[1] - q[1]);
        let range_px = moments.iter().flat_map(|p| moments.iter().map(move |q| apart(p, q))).fold(0.0, f64::max);
        Drift {
            moved_px: [2.0 * terms[0], 2.0 * terms[2]],
            sigma_px: [0, 2].map(|i| 2.0 * own[[i, i]].max(0.0).sqrt()),
            range_px,
            chi2,
            scatter_px: self.scatter_px,
            seen: chi2 > SEEN_CHI2 && range_px > least_px,
        }
    }
}

/// What a drift means for the user.
pub fn describe(drift: Option<&Drift>) -> Vec<Finding> {
    let Some(d) = drift.filter(|d| d.seen) else { return Vec::new() };
    let [row, col] = d.moved_px;
    let total = row.hypot(col);
    let motion = if d.range_px > 1.3 * total {
        format!("wander by up to {:.2} px during the scan and end {total:.2} px from where they began", d.range_px)
    } else {
        format!("drift by {total:.2} px from the first to the last bead frame")
    };
    let text = format!(
        "the foci {motion}, beyond the positions in the table ({row:+.2} +- {:.2} px along the rows, {col:+.2} +- {:.2} \
         px along the columns): stage or array moved during the scan, or the axes of the stage are not square or count \
         differently. Let the stage settle and warm up, and scan again; scanning in random order keeps a drift from \
         looking like distortion",
        d.sigma_px[0], d.sigma_px[1]
    );
    vec![Finding::new("drift", Severity::Warning, text)]
}
