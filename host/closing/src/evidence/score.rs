//! Score tests (Rao, Proc. Camb. Phil. Soc. 44, 50, 1948): how much additional columns would improve a fit, without a
//! fit.
//!
//! With templates X in units of the noise, nuisance columns Z, their projector P_Z and the residual r, the score is
//! s = X'(1 - P_Z) r. With Q = X'(1 - P_Z) X the estimate is theta = Q^-1 s. Its covariance is Q^-1 V Q^-1 with
//! ```text
//! V = phi Q + C
//! ```
//! phi >= 1: scatter of the scores between spatial blocks, or between frames, over that of the noise (White,
//! Econometrica 48, 817, 1980, with clusters). C: covariance of the score by the uncertainty of the calibration, from
//! its delete-a-group jackknife replicates and what it states of light outside its windows. T = s' V^-1 s over its d
//! degrees of freedom is compared with F(d, nu); nu are the effective degrees of freedom of V (Satterthwaite,
//! Biometrics Bull. 2, 110, 1946).

use super::stats::{f_tail, sigmas};
use crate::fit::gauge::{GAUGE, directions};
use crate::fit::{Cell, Design, Sums, pseudo_inverse};
use ndarray::{Array1, Array2};
use std::ops::Range;

/// Degrees of freedom of a stated uncertainty that is itself uncertain by a quarter (JCGM 100:2008, G.4.2).
pub(super) const STATED_DEGREES: f64 = 8.0;

/// Score test of some columns, with others projected out.
#[derive(Clone, Debug)]
pub struct Test {
    /// Estimated values, one for each column.
    pub theta: Vec<f64>,
    /// Covariance of `theta`.
    pub covariance: Array2<f64>,
    /// Covariance of `theta` by the noise alone.
    pub noise: Array2<f64>,
    /// Expected fall of chi-squared.
    pub gain: f64,
    /// Test statistic T: the same with scatter and calibration in its error.
    pub t: f64,
    /// Degrees of freedom: linearly independent columns.
    pub dof: f64,
    /// Effective degrees of freedom of the variance.
    pub nu: f64,
    /// Probability of a larger statistic if the effect is absent.
    pub p: f64,
    /// The same as standard deviations of a normal variable (two-sided).
    pub z: f64,
    /// Scatter between clusters over that of the noise, at least 1.
    pub phi: f64,
    /// Share of the columns' squared norm that remains after the projection.
    pub left: f64,
}

impl Test {
    /// Takes the evidence away: the columns are no sign of the effect, whatever they would explain.
    pub(crate) fn discard(&mut self) {
        (self.t, self.p, self.z) = (0.0, 1.0, 0.0);
    }
}

/// Scatter of scores between clusters.
struct Scatter {
    /// Over that of the noise, at least 1.
    phi: f64,
    /// Degrees of freedom that it is estimated with.
    degrees: f64,
}

/// Score tests of a linearised problem with given columns projected out.
pub struct Scores<'d> {
    design: &'d Design,
    sums: Sums,
    given: Vec<usize>,
    /// (Z'Z)^-1.
    inverse: Array2<f64>,
    /// Gram matrices by cluster: one for each spatial block, and one for each frame.
    clusters: [Vec<Array2<f64>>; 2],
}

impl<'d> Scores<'d> {
    /// Prepares tests on the training cells with the columns `given` projected out.
    pub fn new(design: &'d Design, given: Vec<usize>) -> Self {
        Self::on(design, given, |_| true)
    }

    /// The same on those of the training cells for which `take` is true.
    pub(crate) fn on(design: &'d Design, given: Vec<usize>, take: impl Fn(&Cell) -> bool) -> Self {
        let taken = |c: &Cell| !c.held_out && take(c);
        let sums = design.sums(taken);
        let z = sums.gram.select(ndarray::Axis(0), &given).select(ndarray::Axis(1), &given);
        let inverse = pseudo_inverse(&z);
        let by = |key: &dyn Fn(&Cell) -> usize| {
            let mut keys: Vec<usize> = design.cells.iter().filter(|c| taken(c)).map(key).collect();
            keys.sort_unstable();
            keys.dedup();
            let sum = |k: usize| design.sums(|c| taken(c) && key(c) == k).gram;
            keys.into_iter().map(sum).collect::<Vec<_>>()
        };
        let clusters = [by(&|c| c.block), by(&|c| c.frame)];
        Self { design, sums, given, inverse, clusters }
    }

    /// Part of a Gram matrix, `rows` by `cols`, with the given columns projected out.
    fn projected(&self, gram: &Array2<f64>, rows: &[usize], cols: &[usize]) -> Array2<f64> {
        let pick = |r: &[usize], c: &[usize]| Array2::from_shape_fn((r.len(), c.len()), |(i, j)| gram[[r[i], c[j]]]);
        let total = |r: &[usize]| {
            Array2::from_shape_fn((r.len(), self.given.len()), |(i, j)| self.sums.gram[[r[i], self.given[j]]])
        };
        let (b, c) = (total(rows).dot(&self.inverse), total(cols).dot(&self.inverse));
        pick(rows, cols) - b.dot(&pick(&self.given, cols)) - pick(rows, &self.given).dot(&c.t())
            + b.dot(&pick(&self.given, &self.given)).dot(&c.t())
    }

    /// Fisher information of the values of some columns, with the given columns projected out.
    pub fn information(&self, columns: &[usize]) -> Array2<f64> {
        self.projected(&self.sums.gram, columns, columns)
    }

    /// Tests columns. None: they are linearly dependent on the given columns, so the data do not determine them.
    pub fn test(&self, columns: &[usize]) -> Option<Test> {
        let r = self.design.residual();
        let q = self.projected(&self.sums.gram, columns, columns);
        let alone: f64 = columns.iter().map(|c| self.sums.gram[[*c, *c]]).sum();
        let before = Array2::from_shape_fn((columns.len(), columns.len()), |(i, j)| {
            self.design.before[[columns[i], columns[j]]]
        });
        // What a change of the specimens makes is no part of the effect that is tested.
        let measurable = self.design.estimated.then(|| directions(&q, &before).measurable);
        let reduced = |m: &Array2<f64>| measurable.as_ref().map_or_else(|| m.clone(), |t| t.t().dot(m).dot(t));
        let q_inverse = match &measurable {
            Some(t) => t.dot(&pseudo_inverse(&reduced(&q))).dot(&t.t()),
            None => pseudo_inverse(&q),
        };
        let (before, dof) = (before.diag().sum(), q_inverse.dot(&q).diag().sum().round());
        if dof < 0.5 || q.diag().sum() < (1e-6 * alone).max(GAUGE * before) {
            return None;
        }
        let s = self.projected(&self.sums.gram, columns, &[r]).column(0).to_owned();
        let theta = q_inverse.dot(&s);
        let gain = s.dot(&theta);
        let Scatter { phi, degrees } = self.scatter(columns, r, &theta, &q_inverse, dof);
        let [scattered, stated] = self.design.error_rows().map(|rows| self.calibration(columns, rows));
        let v = &q * phi + &scattered + &stated;
        let v_inverse = match &measurable {
            Some(t) => t.dot(&pseudo_inverse(&reduced(&v))).dot(&t.t()),
            None => pseudo_inverse(&v),
        };
        let t = s.dot(&v_inverse.dot(&s)).max(0.0);
        // Effective degrees of freedom of V: its parts weighted by their shares (Satterthwaite).
        let share = |c: &Array2<f64>| (v_inverse.dot(c).diag().sum() / dof).clamp(0.0, 1.0);
        let [by_replicates, by_statement] = [&scattered, &stated].map(share);
        let by_scatter = (1.0 - 1.0 / phi) * (1.0 - by_replicates - by_statement).max(0.0);
        let replicates = self.design.scattered as f64;
        let spread = by_replicates.powi(2) / (replicates - 1.0).max(1.0)
            + by_statement.powi(2) / STATED_DEGREES
            + by_scatter.powi(2) / degrees.max(1.0);
        let nu = if spread > 0.0 { 1.0 / spread } else { f64::INFINITY };
        let p = f_tail(t / dof, dof, nu);
        let covariance = q_inverse.dot(&v).dot(&q_inverse);
        Some(Test {
            theta: theta.to_vec(),
            covariance,
            noise: q_inverse,
            gain,
            t,
            dof,
            nu,
            p,
            z: strength(t, dof, p),
            phi,
            left: q.diag().sum() / alone,
        })
    }

    /// Scatter of the scores between clusters over that of the noise, for the kind of cluster where it is larger.
    fn scatter(&self, columns: &[usize], r: usize, theta: &Array1<f64>, q_inverse: &Array2<f64>, dof: f64) -> Scatter {
        let mut worst = Scatter { phi: 1.0, degrees: 1e6 };
        for clusters in &self.clusters {
            let mut sum = 0.0;
            for gram in clusters {
                let s = self.projected(gram, columns, &[r]).column(0).to_owned();
                let q = self.projected(gram, columns, columns);
                let u = s - q.dot(theta);
                sum += u.dot(&q_inverse.dot(&u));
            }
            let n = clusters.len() as f64;
            // The estimate uses up one of n clusters.
            let phi = sum / dof * n / (n - 1.0).max(1.0);
            if n > 3.0 && phi > worst.phi {
                worst = Scatter { phi, degrees: n * dof };
            }
        }
        worst
    }

    /// Covariance of the scores by errors of the calibration, given by their rows.
    fn calibration(&self, columns: &[usize], rows: Range<usize>) -> Array2<f64> {
        if rows.is_empty() {
            return Array2::zeros((columns.len(), columns.len()));
        }
        let m = self.projected(&self.sums.gram, columns, &rows.collect::<Vec<_>>());
        m.dot(&m.t())
    }

    /// Squared correlation between the signature of the columns `found` at values `theta` and the closest signature of
    /// the columns `other`, with the given columns projected out: 0 to 1.
    pub fn overlap(&self, found: &[usize], theta: &[f64], other: &[usize]) -> f64 {
        let theta = Array1::from_vec(theta.to_vec());
        let own = theta.dot(&self.projected(&self.sums.gram, found, found).dot(&theta));
        let cross = self.projected(&self.sums.gram, other, found).dot(&theta);
        let inverse = pseudo_inverse(&self.projected(&self.sums.gram, other, other));
        if own > 0.0 { (cross.dot(&inverse.dot(&cross)) / own).clamp(0.0, 1.0) } else { 0.0 }
    }
}

/// Significance of a statistic with `dof` degrees of freedom, standard deviations; by the asymptote for tails below
/// 1e-280.
fn strength(t: f64, dof: f64, p: f64) -> f64 {
    if p > 1e-280 { sigmas(p) } else { (t - (dof - 1.0) * (t / dof).max(1.0).ln()).max(0.0).sqrt() }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::fit::Column;
    use ommatidia_session::rng::stream;
    use rand_distr::{Distribution, StandardNormal};

    /// Cells of made-up columns: a nuisance, two templates, and a residual with a known share of the first template.
    fn made_up(strength: f64, seed: u64) -> Design {
        let mut rng = stream(seed, "score test", 0);
        let mut normal = || -> f32 { StandardNormal.sample(&mut rng) };
        let mut cells = Vec::new();
        for frame in 0..8 {
            for block in 0..9 {
                let mut x = Array2::<f32>::zeros((4, 50));
                for p in 0..50 {
                    let (z, a, b) = (1.0 + normal(), normal(), normal());
                    // The second template resembles the first.
                    for (row, v) in
                        [z, a + 0.5 * z, 0.8 * a + 0.6 * b, 0.3 * z + strength as f32 * a + normal()].iter().enumerate()
                    {
                        x[[row, p]] = *v;
                    }
                }
                cells.push(Cell {
                    frame,
                    block,
                    held_out: frame == 7,
                    pixels: 50.0,
                    gram: x.dot(&x.t()),
                    log_variance: 0.0,
                });
            }
        }
        Design {
            columns: vec![Column::Black; 3],
            scattered: 0,
            stated: 0,
            cells,
            before: Array2::zeros((3, 3)),
            estimated: false,
        }
    }

    #[test]
    fn the_estimate_is_unbiased_and_its_pull_is_one() {
        let mut pulls = Vec::new();
        for seed in 0..60 {
            let design = made_up(0.1, seed);
            let t = Scores::new(&design, vec![0]).test(&[1]).unwrap();
            pulls.push((t.theta[0] - 0.1) / t.covariance[[0, 0]].sqrt());
        }
        let n = pulls.len() as f64;
        let mean = pulls.iter().sum::<f64>() / n;
        let rms = (pulls.iter().map(|p| p * p).sum::<f64>() / n).sqrt();
        assert!(mean.abs() < 0.4 && (0.75..1.25).contains(&rms), "{mean} {rms}");
    }

    #[test]
    fn without_an_effect_tail_probabilities_are_right() {
        let small =
            (0..200).filter(|seed| Scores::new(&made_up(0.0, 1000 + seed), vec![0]).test(&[1, 2]).unwrap().p < 0.1);
        let n = small.count();
        // Binomial of 200 and 0.1: 20 +- 4.2.
        assert!((6..36).contains(&n), "{n}");
    }

    #[test]
    fn similar_columns_overlap_and_a_nuisance_column_is_not_testable() {
        let design = made_up(0.2, 5);
        let scores = Scores::new(&design, vec![0]);
        let t = scores.test(&[1]).unwrap();
        // 11 sigma by the noise; fewer remain, since seven frames determine the scatter between frames poorly.
        assert!(t.z > 4.0 && t.gain > 60.0, "{t:?}");
        assert!((scores.overlap(&[1], &t.theta, &[2]) - 0.64).abs() < 0.05);
        // A column that is the nuisance itself cannot be tested.
        assert!(scores.test(&[0]).is_none());
    }

    #[test]
    fn errors_of_the_calibration_widen_the_variance() {
        let mut design = made_up(0.0, 9);
        let of = |which: [usize; 2], design: &mut Design| {
            [design.scattered, design.stated] = which;
            Scores::new(design, vec![0]).test(&[1]).unwrap()
        };
        for cell in &mut design.cells {
            // Errors along the first template, by -0.1, 0 and 0.1 of it.
            let old = cell.gram.clone();
            let combine = |i: usize| -> Vec<(usize, f32)> {
                match i {
                    0..=2 => vec![(i, 1.0)],
                    3..=5 => vec![(1, 0.1 * (i as f32 - 4.0))],
                    _ => vec![(3, 1.0)],
                }
            };
            cell.gram = Array2::from_shape_fn((7, 7), |(i, j)| {
                combine(i)
                    .iter()
                    .flat_map(|a| combine(j).into_iter().map(move |b| (*a, b)))
                    .map(|(a, b)| a.1 * b.1 * old[[a.0, b.0]])
                    .sum()
            });
        }
        // 0.1^2 + 0 + 0.1^2, beside 1/3150.
        let t = of([3, 0], &mut design);
        assert!((t.covariance[[0, 0]] - 0.02).abs() < 0.002 && t.nu < 3.0, "{t:?}");
        // What is stated is as large, and known better than the scatter of three replicates.
        let stated = of([0, 3], &mut design);
        assert!((stated.covariance[[0, 0]] - t.covariance[[0, 0]]).abs() < 1e-9 && stated.nu > 7.0, "{stated:?}");
    }
}
