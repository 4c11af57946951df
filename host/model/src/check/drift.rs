//! Slow motion of the foci during the scan, beyond what the table says: a stage or an array that creeps.
//!
//! Each frame, moved back by its position, is compared with the sum of all: `f(x) = a (S(x) - d . grad S(x))` by least
//! squares gives its displacement d. The displacements of all frames are then fitted with what optics may do to them
//! (another magnification, a turn, radial distortion and its centre) and with a drift, linear and quadratic in time. In
//! a scan line by line the row follows time, so that a wrong magnification looks like a drift along the rows; it acts
//! on the columns as well, which tells the two apart. The scatter about the fit gives the standard errors.
//!
//! Aberrations that change over the field displace the centroids of foci too, and the scan goes through the field in
//! the course of time. They do it differently behind each lens, whereas a drift moves all foci alike. So the drift is
//! also estimated behind each lens alone: what all lenses share counts, measured by how far they disagree.
//!
//! What cannot be told: behind one lens, and where the aberrations of all lenses are the same, in a scan line by
//! line, a drift and a smooth displacement over the field are the same thing.

use super::array::Lattice;
use super::hypotheses::Tried;
use super::scan::{SUSPECT, Scan, Small, median, middle};
use super::{Finding, Hypothesis, Outlier, Severity};
use ndarray::Array2;
use ommatidia_physics::linalg::least_squares;
use ommatidia_session::with_error_signed;
use serde::Serialize;

/// Fewest frames from which a drift is estimated.
const FEWEST: usize = 25;
/// Chi-squared of the four terms of a drift from which it counts: five standard deviations of noise, 35 for four
/// degrees of freedom, and some room for the scatter that the standard errors are taken from.
const SEEN_CHI2: f64 = 45.0;
/// Smallest drift that is worth a finding, sensor pixels times the root of the number of lenses. This is twice the
/// largest figure of 24 virtual instruments of one to nine lenses that did not move.
const LEAST_PX: f64 = 0.3;
/// A drift that all lenses share exceeds the standard error of their mean this many times. Of few lenses more is asked,
/// as the disagreement of few is known badly: [`shared`] follows the ratios that chance exceeds once in a thousand.
const SHARED: f64 = 2.5;
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
    /// How far the drifts that single lenses show are apart, px, as a standard deviation: aberrations that change over
    /// the field. 0 where fewer than two lenses can be judged alone.
    pub between_lenses_px: f64,
    /// Whether it is significant, and large enough to matter.
    pub seen: bool,
}

/// Estimates the drift of the foci of `lenses` lenses, which were found at `lattice`; None where the table does not
/// agree with the frames, or there are too few.
pub fn drift(scan: &Scan, tried: &Tried, outliers: &[Outlier], (lattice, lenses): (&Lattice, usize)) -> Option<Drift> {
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
        let here = displacements(scan, &used, &shift_px, &|_| true);
        let fit = Fit::of(&design, &here)?;
        shift_px = design.iter().map(|x| [0, 1].map(|a| fit.value(&x[a]))).collect();
        found = Some(fit);
    }
    let spots: Vec<[f64; 2]> = lattice.lenses_px.iter().map(|p| p.map(|v| (v + 0.5) / scan.bin as f64 - 0.5)).collect();
    let alone = (0..spots.len()).filter_map(|lens| {
        let here = displacements(scan, &used, &shift_px, &|at| nearest(&spots, at) == Some(lens));
        Fit::of(&design, &here).map(|fit| fit.moves())
    });
    let alone: Vec<Moves> = if spots.len() > 1 { alone.collect() } else { Vec::new() };
    found.map(|fit| fit.drift(LEAST_PX / (lenses.max(1) as f64).sqrt(), &alone))
}

/// The spot that is nearest to a small pixel.
fn nearest(spots: &[[f64; 2]], at: [isize; 2]) -> Option<usize> {
    let far = |s: &[f64; 2]| (s[0] - at[0] as f64).powi(2) + (s[1] - at[1] as f64).powi(2);
    (0..spots.len()).min_by(|a, b| far(&spots[*a]).total_cmp(&far(&spots[*b])))
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

/// Displacement of each frame from its position in the table, sensor pixels, where `shift_px` is known already, by the
/// small pixels of the summed frames that are `counted`.
fn displacements(
    scan: &Scan,
    used: &[usize],
    shift_px: &[[f64; 2]],
    counted: &dyn Fn([isize; 2]) -> bool,
) -> Vec<[f64; 2]> {
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
        .filter(|(at, _)| counted(*at))
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

    fn moves(&self) -> Moves {
        Moves(std::array::from_fn(|i| self.terms[DRIFT + i]))
    }

    /// The drift, which is worth a finding from `least_px` on, where single lenses show the drifts `alone`.
    fn drift(&self, least_px: f64, alone: &[Moves]) -> Drift {
        let moves = self.moves();
        let own = self.covariance.slice(ndarray::s![DRIFT.., DRIFT..]).to_owned();
        let column = Array2::from_shape_fn((4, 1), |(i, _)| moves.0[i]);
        let chi2 = least_squares(&own, &column).map_or(0.0, |x| (0..4).map(|i| x[[i, 0]] * moves.0[i]).sum());
        let range_px = moves.range_px();
        let lenses = alone.len() as f64;
        let mean: [f64; 4] = std::array::from_fn(|i| alone.iter().map(|m| m.0[i]).sum::<f64>() / lenses.max(1.0));
        let apart: Vec<Moves> = alone.iter().map(|m| Moves(std::array::from_fn(|i| m.0[i] - mean[i]))).collect();
        let variance = |of: &dyn Fn(&Moves) -> f64| {
            if alone.len() > 1 { apart.iter().map(|m| of(m).powi(2)).sum::<f64>() / (lenses - 1.0) } else { 0.0 }
        };
        let between_lenses_px = variance(&|m| m.range_px()).sqrt();
        let error = |i: usize| {
            let of_lenses = variance(&|m| m.0[i]) / lenses.max(1.0);
            2.0 * (own[[i, i]].max(0.0) + of_lenses).sqrt()
        };
        Drift {
            moved_px: [2.0 * moves.0[0], 2.0 * moves.0[2]],
            sigma_px: [0, 2].map(error),
            range_px,
            chi2,
            scatter_px: self.scatter_px,
            between_lenses_px,
            seen: chi2 > SEEN_CHI2 && range_px > least_px && range_px > shared(alone.len()) * between_lenses_px,
        }
    }
}

/// From which multiple of the disagreement between lenses on they share a drift.
fn shared(lenses: usize) -> f64 {
    let n = lenses.max(2) as f64;
    SHARED * (1.0 + 2.0 / (n - 1.0)) / n.sqrt()
}

/// A drift: linear and quadratic along the rows, then along the columns, at times from -1 to 1, px.
struct Moves([f64; 4]);

impl Moves {
    /// Largest distance between two moments, px.
    fn range_px(&self) -> f64 {
        let at = |t: f64| [0, 1].map(|a| self.0[2 * a] * t + self.0[2 * a + 1] * t * t);
        let moments: Vec<[f64; 2]> = (0..=40).map(|i| at(f64::from(i) / 20.0 - 1.0)).collect();
        let apart = |p: &[f64; 2], q: &[f64; 2]| (p[0] - q[0]).hypot(p[1] - q[1]);
        moments.iter().flat_map(|p| moments.iter().map(move |q| apart(p, q))).fold(0.0, f64::max)
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
        "the foci {motion}, beyond the positions in the table ({} px along the rows, {} px along the columns): stage \
         or array moved during the scan, or the axes of the stage are not square or count differently. Let the stage \
         settle and warm up, and scan again; scanning in random order keeps a drift from looking like distortion",
        with_error_signed(row, d.sigma_px[0], 2),
        with_error_signed(col, d.sigma_px[1], 2)
    );
    vec![Finding::new("drift", Severity::Warning, text)]
}
