//! Fits pupils to the PSFs of a lens: Levenberg and Marquardt's least squares.
//!
//! Where a focus lies is none of the pupil's: distortion of any law displaces it. So the tilt of each place is a value
//! of its own, projected out of everything else as the light of the place is. A tilt that may only follow the square of
//! the field is bought by other aberrations where the distortion is a cube.

use super::kernel::{Kernel, Pupil, Waves};
use super::{EVEN, FUNCTIONS, SQUARES, TERMS, field};
use ndarray::{Array1, Array2, s};
use ommatidia_physics::linalg::{least_squares, symmetric_eigen};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Iterations of the fit of one place, of each start over the field, and of the best of them.
const ROUNDS: [usize; 3] = [25, 3, 40];
/// A step that lowers the error by less than this share of it ends the fit.
const ENOUGH: f64 = 1e-4;
/// Largest cut-off frequency of a pupil, cycles/px: pixels do not show more.
const MOST_RADIUS: f64 = 0.5;
/// `A R^2` of a pupil without aberrations, where A is the area that the square of its PSF sees (`(sum h)^2 / sum h^2`,
/// px^2) and R its cut-off frequency: one over the integral of the squared transfer function.
const SHARPEST: f64 = 0.70;
/// Starts: radius as a multiple of that of a sharp pupil, and defocus, rad rms. One alone would find the nearest local
/// minimum, and without defocus there is no slope.
const STARTS: [[f64; 2]; 4] = [[1.0, 0.2], [1.25, 0.6], [1.6, 1.1], [2.1, 1.8]];

/// Starts over the field: defocus, rad rms at the edge, that grows with the square of the field about the chief ray of
/// the lens, which lies towards one side of the object or another. The sign of what is even is free at each place, so
/// that a fit from a wrong start takes one sign on one side of the object and the other beyond.
const CURVED: f64 = 0.2;
const OFF_AXIS: [f64; 3] = [0.0, -0.5, 0.5];

/// Number of starts over the field whose fits are finished.
const FINALISTS: usize = 2;

/// The PSF at one place of the source.
pub(super) struct Place {
    /// Place (y, x), each from -1 to 1 over the object.
    pub at: [f64; 2],
    /// Window of unit norm, [side, side].
    pub window: Array2<f64>,
}

/// The pupil of a lens.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LensPupil {
    /// Coefficients of the functions of the field, [term, function], rad.
    pub terms: Array2<f64>,
    pub apodisation: f64,
    /// Cut-off frequency, cycles/px.
    pub radius: f64,
    /// Relative error over all places (root mean square).
    pub misfit: f64,
}

impl LensPupil {
    /// The pupil for a source at (y, x).
    pub(super) fn at(&self, place: [f64; 2]) -> Pupil {
        let values = self.terms.dot(&Array1::from_vec(field(place)[..self.terms.ncols()].to_vec()));
        let mut terms = [0.0; TERMS];
        terms.iter_mut().zip(values).for_each(|(t, v)| *t = v);
        Pupil { terms, apodisation: self.apodisation, radius: self.radius }
    }

    /// Whether a fit over the field may have given it.
    pub(super) fn is_possible(&self) -> bool {
        let finite = self.terms.iter().chain([&self.apodisation, &self.misfit]).all(|v| v.is_finite());
        self.terms.dim() == (TERMS, FUNCTIONS) && finite && self.radius > 0.0 && self.radius <= MOST_RADIUS
    }

    /// With coefficients of more functions of the field, zero at first.
    fn widened(self, functions: usize) -> Self {
        let mut terms = Array2::zeros((TERMS, functions));
        terms.slice_mut(s![.., ..self.terms.ncols()]).assign(&self.terms);
        Self { terms, ..self }
    }
}

/// Fits the pupil of a lens to its PSFs, all of the same side; the first place is the one nearest to the centre. None:
/// no place, or no finite fit.
pub(super) fn fit_lens(places: &[Place]) -> Option<LensPupil> {
    let first = places.first()?;
    let side = first.window.nrows();
    let sharp = (SHARPEST / effective_area(&first.window)).sqrt();
    let starts = STARTS.iter().filter_map(|[wider, defocus]| {
        let radius = (wider * sharp).min(MOST_RADIUS);
        let mut terms = Array2::zeros((TERMS, 1));
        terms[[2, 0]] = *defocus;
        let start = LensPupil { terms, apodisation: 0.0, radius, misfit: f64::INFINITY };
        improved(&Kernel::new(side, MOST_RADIUS.min(1.3 * radius)), start, &places[..1], (ROUNDS[0], Edge::Free))
    });
    let best = starts.min_by(|a, b| a.misfit.total_cmp(&b.misfit))?;
    let wide = best.widened(FUNCTIONS);
    let curved = centres().flat_map(|centre| [CURVED, -CURVED].map(|by| (centre, by)));
    let starts = curved.map(|([y, x], by)| {
        let mut start = wide.clone();
        // |place - centre|^2, but for its constant.
        for (function, factor) in [(1, -2.0 * y), (2, -2.0 * x), (3, 1.0), (5, 1.0)] {
            start.terms[[2, function]] = by * factor;
        }
        start
    });
    over_field(starts.chain([wide.clone()]).collect(), places, Edge::Free)
}

/// What lenses of one design share.
pub(super) struct Design(LensPupil);

impl Design {
    /// Medians over lenses: cut-off frequency, apodisation, how wavefronts change with the square of the field, and how
    /// their odd terms change with the field. A lens whose fit went astray does not move them. None: fewer than three
    /// lenses.
    pub(super) fn of(lenses: &[&LensPupil]) -> Option<Self> {
        if lenses.len() < 3 {
            return None;
        }
        let median = |of: &dyn Fn(&LensPupil) -> f64| {
            let mut all: Vec<f64> = lenses.iter().map(|lens| of(lens)).collect();
            all.sort_by(f64::total_cmp);
            all.get(all.len() / 2).copied().unwrap_or(0.0)
        };
        let shared = |(k, f): (usize, usize)| f >= SQUARES || f > 0 && !EVEN[k];
        let term = |at: (usize, usize)| if shared(at) { median(&|lens| lens.terms[at]) } else { 0.0 };
        Some(Self(LensPupil {
            terms: Array2::from_shape_fn((TERMS, FUNCTIONS), term),
            apodisation: median(&|lens| lens.apodisation),
            radius: median(&|lens| lens.radius),
            misfit: f64::INFINITY,
        }))
    }

    /// The design with its field about a centre, for what changes with the square of the field.
    fn about(&self, [y, x]: [f64; 2]) -> LensPupil {
        let mut lens = self.0.clone();
        for mut row in lens.terms.outer_iter_mut() {
            let [of_yy, of_yx, of_xx] = [row[SQUARES], row[SQUARES + 1], row[SQUARES + 2]];
            row[0] += of_yy * y * y + of_yx * y * x + of_xx * x * x;
            row[1] -= 2.0 * of_yy * y + of_yx * x;
            row[2] -= 2.0 * of_xx * x + of_yx * y;
        }
        lens
    }
}

/// Whether the apodisation of a pupil is fitted, or that of the design.
#[derive(Clone, Copy, PartialEq)]
enum Edge {
    Free,
    OfDesign,
}

/// [`fit_lens`] from the design of all lenses, with their apodisation: defocus, spherical aberration, apodisation and
/// radius can stand for each other, and a lens alone hardly tells them apart.
pub(super) fn fit_like(design: &Design, places: &[Place]) -> Option<LensPupil> {
    over_field(centres().map(|centre| design.about(centre)).collect(), places, Edge::OfDesign)
}

/// Where the chief ray of a lens may lie in the field.
fn centres() -> impl Iterator<Item = [f64; 2]> {
    OFF_AXIS.iter().flat_map(|y| OFF_AXIS.map(|x| [*y, x]))
}

/// The best fit to all places from any of the starts, which have one radius.
fn over_field(starts: Vec<LensPupil>, places: &[Place], edge: Edge) -> Option<LensPupil> {
    let side = places.first()?.window.nrows();
    let kernel = Kernel::new(side, MOST_RADIUS.min(1.3 * starts.first()?.radius));
    let tried = starts.into_par_iter().filter_map(|start| improved(&kernel, start, places, (ROUNDS[1], edge)));
    let mut found: Vec<LensPupil> = tried.collect();
    found.sort_by(|a, b| a.misfit.total_cmp(&b.misfit));
    found.truncate(FINALISTS);
    let finished = found.into_par_iter().filter_map(|start| improved(&kernel, start, places, (ROUNDS[2], edge)));
    finished.min_by(|a, b| a.misfit.total_cmp(&b.misfit))
}

/// `(sum h)^2 / sum h^2`, px^2.
pub(super) fn effective_area(window: &Array2<f64>) -> f64 {
    window.sum().powi(2) / window.mapv(|v| v * v).sum().max(f64::MIN_POSITIVE)
}

/// Least squares from a start, in at most so many rounds.
fn improved(kernel: &Kernel, start: LensPupil, places: &[Place], (rounds, edge): (usize, Edge)) -> Option<LensPupil> {
    let functions = start.terms.ncols();
    let unknowns = TERMS * functions + 2;
    let side = places.first()?.window.nrows();
    let mut tilts = vec![[0.0; 2]; places.len()];
    let mut now = LensPupil { misfit: misfit(kernel, &start, (places, &tilts)), ..start };
    let mut damping = 1e-2;
    for _ in 0..rounds {
        let mut normal = Array2::<f64>::zeros((unknowns, unknowns));
        let mut right = Array1::<f64>::zeros(unknowns);
        let waves = kernel.waves(side, now.radius);
        let mut own = Vec::with_capacity(places.len());
        for (place, tilt) in places.iter().zip(&tilts) {
            let (slopes, off) = slopes_at((kernel, &waves), &now, (place, *tilt));
            let (mut gram, mut lacks) = (slopes.dot(&slopes.t()), slopes.dot(&off));
            if edge == Edge::OfDesign {
                gram.row_mut(TERMS).fill(0.0);
                gram.column_mut(TERMS).fill(0.0);
                lacks[TERMS] = 0.0;
            }
            let tilt = Tilt::out_of(&mut gram, &mut lacks);
            // The derivative by a coefficient is that by its term, times its function of the field.
            let of = coefficients(place.at, functions);
            for (i, (a, by_a)) in of.iter().enumerate() {
                right[i] += by_a * lacks[*a];
                for (j, (b, by_b)) in of.iter().enumerate() {
                    normal[[i, j]] += by_a * by_b * gram[[*a, *b]];
                }
            }
            own.push((tilt, of));
        }
        let mut better = None;
        for _ in 0..6 {
            let stepped = solved(&normal, &right, damping).and_then(|step| {
                let tilts: Vec<[f64; 2]> =
                    own.iter().zip(&tilts).map(|((own, of), tilt)| own.after(&step, of, *tilt)).collect();
                Some((moved(&now, &step)?, tilts))
            });
            let found =
                stepped.map(|(to, tilts)| (LensPupil { misfit: misfit(kernel, &to, (places, &tilts)), ..to }, tilts));
            if let Some((found, moved)) = found.filter(|(f, _)| f.misfit < now.misfit) {
                (better, tilts) = (Some(found), moved);
                damping = (damping * 0.3).max(1e-9);
                break;
            }
            damping *= 5.0;
        }
        let Some(better) = better else { break };
        let gain = 1.0 - better.misfit / now.misfit;
        now = better;
        if gain < ENOUGH {
            break;
        }
    }
    now.misfit.is_finite().then(|| with_tilts(now, places, &tilts))
}

/// A pupil whose tilt follows the tilts of the places as well as its functions of the field can.
fn with_tilts(mut lens: LensPupil, places: &[Place], tilts: &[[f64; 2]]) -> LensPupil {
    let functions = lens.terms.ncols();
    let design = Array2::from_shape_fn((places.len(), functions), |(i, f)| field(places[i].at)[f]);
    let wanted = Array2::from_shape_fn((places.len(), 2), |(i, k)| tilts[i][k]);
    if let Ok(found) = least_squares(&design, &wanted) {
        let mut own = lens.terms.slice_mut(s![..2, ..]);
        own += &found.t();
    }
    lens
}

/// Number of derivatives of the PSF at a place: by the terms there, the apodisation, and the logarithm of the radius.
const SLOPES: usize = TERMS + 2;

/// The derivative at a place that each unknown of a lens goes with, by its index, and the factor on it.
fn coefficients(at: [f64; 2], functions: usize) -> Vec<(usize, f64)> {
    let values = field(at);
    let of_terms = (0..TERMS).flat_map(|k| values.iter().take(functions).map(move |value| (k, *value)));
    of_terms.chain([(TERMS, 1.0), (TERMS + 1, 1.0)]).collect()
}

/// The tilt of a place, linearised beside all other derivatives there.
struct Tilt {
    /// Inverse of the Gram matrix of the derivatives by the two tilts.
    inverse: [[f64; 2]; 2],
    /// Products of these with all derivatives; zero with themselves.
    across: [[f64; SLOPES]; 2],
    /// Products of these with what the PSF lacks.
    lacks: [f64; 2],
}

impl Tilt {
    /// Takes what a tilt can make out of the Gram matrix of the derivatives of a place, and out of their products with
    /// what its PSF lacks. The tilts of the lens are not fitted beside it.
    fn out_of(gram: &mut Array2<f64>, lacks: &mut Array1<f64>) -> Self {
        let (a, b, d) = (gram[[0, 0]], gram[[0, 1]], gram[[1, 1]]);
        let determinant = a * d - b * b;
        let usable = determinant > 1e-9 * a * d;
        let by = if usable { 1.0 / determinant } else { 0.0 };
        let across: [[f64; SLOPES]; 2] =
            [0, 1].map(|t| std::array::from_fn(|k| if k < 2 { 0.0 } else { gram[[t, k]] }));
        let it = Self { inverse: [[d * by, -b * by], [-b * by, a * by]], across, lacks: [lacks[0], lacks[1]] };
        let share = it.solve(it.lacks);
        for t in 0..2 {
            gram.row_mut(t).fill(0.0);
            gram.column_mut(t).fill(0.0);
            lacks[t] = 0.0;
        }
        for k in 2..SLOPES {
            let solved = it.solve([across[0][k], across[1][k]]);
            (2..SLOPES).for_each(|j| gram[[j, k]] -= across[0][j] * solved[0] + across[1][j] * solved[1]);
            lacks[k] -= across[0][k] * share[0] + across[1][k] * share[1];
        }
        it
    }

    fn solve(&self, right: [f64; 2]) -> [f64; 2] {
        self.inverse.map(|row| row[0] * right[0] + row[1] * right[1])
    }

    /// The tilt of the place after a step of all other unknowns, which go with the derivatives as [`coefficients`]
    /// says.
    fn after(&self, step: &Array1<f64>, of: &[(usize, f64)], tilt: [f64; 2]) -> [f64; 2] {
        let taken = self.across.map(|across| of.iter().zip(step).map(|((k, by), s)| across[*k] * by * s).sum::<f64>());
        let moved = self.solve([0, 1].map(|k| self.lacks[k] - taken[k]));
        [0, 1].map(|k| tilt[k] + moved[k])
    }
}

/// Derivatives of the PSF at a place, [`SLOPES`, pixel], and what it lacks, [pixel]; the light is free.
fn slopes_at(
    (kernel, waves): (&Kernel, &Waves),
    lens: &LensPupil,
    (place, tilt): (&Place, [f64; 2]),
) -> (Array2<f64>, Array1<f64>) {
    let (psf, slopes) = kernel.psf_and_slopes(waves, &tilted(lens.at(place.at), tilt));
    let flat = |a: &Array2<f64>| Array1::from_iter(a.iter().copied());
    let (model, wanted) = (flat(&psf), flat(&place.window));
    let square = model.dot(&model).max(f64::MIN_POSITIVE);
    let scale = model.dot(&wanted) / square;
    let off = &wanted - &(&model * scale);
    let mut rows = Array2::zeros((SLOPES, model.len()));
    for (mut row, slope) in rows.outer_iter_mut().zip(&slopes) {
        let slope = flat(slope) * scale;
        // What another light would explain is none of the pupil's.
        row.assign(&(&slope - &(&model * (model.dot(&slope) / square))));
    }
    (rows, off)
}

/// The step of damped normal equations; None: no finite step.
fn solved(normal: &Array2<f64>, right: &Array1<f64>, damping: f64) -> Option<Array1<f64>> {
    let mean = normal.diag().mean()?.max(f64::MIN_POSITIVE);
    let mut damped = normal.clone();
    damped.diag_mut().mapv_inplace(|v| v * (1.0 + damping) + 1e-6 * damping * mean);
    let eigen = symmetric_eigen(&damped).ok()?;
    let floor = 1e-12 * eigen.values.iter().fold(0.0f64, |m, v| m.max(*v));
    let shares = eigen.vectors.t().dot(right);
    let shares =
        ndarray::Zip::from(&shares).and(&eigen.values).map_collect(|s, v| if *v > floor { s / v } else { 0.0 });
    Some(eigen.vectors.dot(&shares)).filter(|x| x.iter().all(|v| v.is_finite()))
}

/// A pupil after a step; None: outside the physical range.
fn moved(from: &LensPupil, step: &Array1<f64>) -> Option<LensPupil> {
    let (terms, rest) = (from.terms.len(), from.terms.dim());
    let by = Array2::from_shape_vec(rest, step.slice(s![..terms]).to_vec()).ok()?;
    let apodisation = (from.apodisation + step[terms]).clamp(-0.5, 3.0);
    let radius = from.radius * step[terms + 1].clamp(-0.2, 0.2).exp();
    (radius <= MOST_RADIUS).then(|| LensPupil { terms: &from.terms + &by, apodisation, radius, misfit: from.misfit })
}

/// A pupil with more tilt.
fn tilted(mut pupil: Pupil, tilt: [f64; 2]) -> Pupil {
    pupil.terms.iter_mut().zip(tilt).for_each(|(term, more)| *term += more);
    pupil
}

/// Relative error of the PSFs (root mean square over the places), the light of each place free, with its tilt.
fn misfit(kernel: &Kernel, lens: &LensPupil, (places, tilts): (&[Place], &[[f64; 2]])) -> f64 {
    let waves = kernel.waves(places.first().map_or(0, |p| p.window.nrows()), lens.radius);
    let of = |(place, tilt): (&Place, &[f64; 2])| {
        let model = kernel.psf(&waves, &tilted(lens.at(place.at), *tilt));
        let (square, product) = (model.mapv(|v| v * v).sum(), (&model * &place.window).sum());
        place.window.mapv(|v| v * v).sum() - product * product / square.max(f64::MIN_POSITIVE)
    };
    (places.iter().zip(tilts).map(of).sum::<f64>().max(0.0) / places.len() as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_design_is_shared_by_most_lenses_and_moves_with_the_centre_of_the_field() {
        let lens = |radius: f64, curvature: f64| {
            let mut terms = Array2::zeros((TERMS, FUNCTIONS));
            // Defocus that grows with the square of the field, as y^2 + y x / 2 + 2 x^2, about a centre of its own.
            [(0, 9.0), (1, 7.0), (3, curvature), (4, curvature / 2.0), (5, 2.0 * curvature)]
                .into_iter()
                .for_each(|(f, v)| terms[[2, f]] = v);
            LensPupil { terms, apodisation: 0.5, radius, misfit: 0.0 }
        };
        let (a, b, astray) = (lens(0.2, 0.3), lens(0.2, 0.3), lens(0.4, -5.0));
        assert!(Design::of(&[&a, &b]).is_none());
        let design = Design::of(&[&astray, &a, &b]);
        let about = design.as_ref().map(|design| design.about([0.5, -0.25]));
        for [y, x] in [[0.0, 0.0], [0.5, -0.25], [-1.0, 1.0]] {
            let (v, u) = (y - 0.5, x + 0.25);
            let expected = 0.3 * (v * v + v * u / 2.0 + 2.0 * u * u);
            let found = about.as_ref().map(|lens| (lens.at([y, x]).terms[2], lens.radius));
            assert!(found.is_some_and(|(d, r)| (d - expected).abs() < 1e-12 && r == 0.2), "{found:?} {expected}");
        }
    }
}
