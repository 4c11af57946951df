//! Score tests: how much better columns would make the model, and how sure that is.
//!
//! With templates X in units of the noise, nuisances Z and residual r: s = X'(1 - P_Z) r and Q = X'(1 - P_Z) X give the estimate
//! theta = Q^-1 s without a fit. Its variance is Q^-1 V Q^-1 with
//! ```text
//! V = phi Q + C
//! ```
//! phi >= 1: scatter of the scores between spatial blocks (or frames) beyond the noise (White, Econometrica 48, 817, 1980, clustered);
//! C: what the calibration's own uncertainty does to the score, from its delete-a-group replicates. T = s' V^-1 s is compared
//! with F(d, nu), nu counting how well V itself is known.

use super::design::{Design, Sums};
use super::stats::{f_tail, sigmas};
use crate::linalg::{SymmetricEigen, symmetric_eigen};
use ndarray::{Array1, Array2};

/// A score test of some columns, given others.
#[derive(Clone, Debug)]
pub struct Test {
    /// Estimated values.
    pub theta: Vec<f64>,
    /// Their covariance.
    pub covariance: Array2<f64>,
    /// The part of it that the noise alone makes.
    pub noise: Array2<f64>,
    /// Fall of chi-squared that they would bring, by the noise alone.
    pub gain: f64,
    /// The same with all that is known of the errors: the test statistic.
    pub t: f64,
    /// Degrees of freedom: columns that the data can tell.
    pub dof: f64,
    /// How well the variance is known.
    pub nu: f64,
    /// Probability of a larger statistic without the effect.
    pub p: f64,
    /// The same as standard deviations of a normal variable.
    pub z: f64,
    /// Scatter between clusters over the noise.
    pub phi: f64,
    /// Share of the columns' own size that what is taken out leaves of them.
    pub left: f64,
}

/// The design around a state, with what is taken out of every column.
pub struct Scores<'d> {
    design: &'d Design,
    sums: Sums,
    given: Vec<usize>,
    /// (Z'Z)^-1.
    inverse: Array2<f64>,
    /// Sums by cluster: spatial blocks over frames, and frames over blocks.
    clusters: [Vec<Array2<f64>>; 2],
}

impl<'d> Scores<'d> {
    /// Takes the columns `given` out, over the cells that may be fitted.
    pub fn new(design: &'d Design, given: Vec<usize>) -> Self {
        let sums = design.training();
        let z = sums.gram.select(ndarray::Axis(0), &given).select(ndarray::Axis(1), &given);
        let inverse = pseudo_inverse(&z);
        let by = |key: &dyn Fn(&super::design::Cell) -> usize| {
            let mut keys: Vec<usize> = design.cells.iter().filter(|c| !c.held_out).map(key).collect();
            keys.sort_unstable();
            keys.dedup();
            let sum = |k: usize| design.sums(|c| !c.held_out && key(c) == k).gram;
            keys.into_iter().map(sum).collect::<Vec<_>>()
        };
        let clusters = [by(&|c| c.block), by(&|c| c.frame)];
        Self { design, sums, given, inverse, clusters }
    }

    /// Rows of a Gram matrix with the nuisances taken out: (columns or replicates) by (columns, replicates, residual).
    fn projected(&self, gram: &Array2<f64>, rows: &[usize], cols: &[usize]) -> Array2<f64> {
        let pick = |r: &[usize], c: &[usize]| Array2::from_shape_fn((r.len(), c.len()), |(i, j)| gram[[r[i], c[j]]]);
        let total = |r: &[usize]| {
            Array2::from_shape_fn((r.len(), self.given.len()), |(i, j)| self.sums.gram[[r[i], self.given[j]]])
        };
        let (b, c) = (total(rows).dot(&self.inverse), total(cols).dot(&self.inverse));
        pick(rows, cols) - b.dot(&pick(&self.given, cols)) - pick(rows, &self.given).dot(&c.t())
            + b.dot(&pick(&self.given, &self.given)).dot(&c.t())
    }

    /// Tests columns. None: the data cannot tell them from the nuisances.
    pub fn test(&self, columns: &[usize]) -> Option<Test> {
        let r = self.design.residual();
        let q = self.projected(&self.sums.gram, columns, columns);
        let alone: f64 = columns.iter().map(|c| self.sums.gram[[*c, *c]]).sum();
        let q_inverse = pseudo_inverse(&q);
        let dof = q_inverse.dot(&q).diag().sum().round();
        if dof < 0.5 || q.diag().sum() < 1e-6 * alone {
            return None;
        }
        let s = self.projected(&self.sums.gram, columns, &[r]).column(0).to_owned();
        let theta = q_inverse.dot(&s);
        let gain = s.dot(&theta);
        let (phi, clusters) = self.scatter(columns, r, &theta, &q_inverse, dof);
        let c = self.calibration(columns);
        let v = &q * phi + &c;
        let t = s.dot(&pseudo_inverse(&v).dot(&s)).max(0.0);
        // How well V is known: its parts weighted by what they add (Satterthwaite).
        let replicates = self.design.replicates as f64;
        let by_calibration = (pseudo_inverse(&v).dot(&c).diag().sum() / dof).clamp(0.0, 1.0);
        let by_scatter = (1.0 - 1.0 / phi) * (1.0 - by_calibration);
        let spread = by_calibration.powi(2) / (replicates - 1.0).max(1.0) + by_scatter.powi(2) / clusters.max(1.0);
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

    /// Scatter of the scores between clusters over what the noise makes, at least 1, and the number of clusters that tell it.
    fn scatter(
        &self,
        columns: &[usize],
        r: usize,
        theta: &Array1<f64>,
        q_inverse: &Array2<f64>,
        dof: f64,
    ) -> (f64, f64) {
        let mut worst = (1.0, 1e6);
        for clusters in &self.clusters {
            let mut sum = 0.0;
            for gram in clusters {
                let s = self.projected(gram, columns, &[r]).column(0).to_owned();
                let q = self.projected(gram, columns, columns);
                let u = s - q.dot(theta);
                sum += u.dot(&q_inverse.dot(&u));
            }
            let n = clusters.len() as f64;
            // The estimate takes a share of the scatter with it.
            let phi = sum / dof * n / (n - 1.0).max(1.0);
            if n > 3.0 && phi > worst.0 {
                worst = (phi, n * dof);
            }
        }
        worst
    }

    /// Covariance of a score that the calibration's uncertainty makes: delete-a-group jackknife.
    fn calibration(&self, columns: &[usize]) -> Array2<f64> {
        let rows: Vec<usize> = self.design.replicate_rows().collect();
        let n = rows.len() as f64;
        if rows.len() < 2 {
            return Array2::zeros((columns.len(), columns.len()));
        }
        let mut m = self.projected(&self.sums.gram, columns, &rows);
        let mean = m.mean_axis(ndarray::Axis(1)).unwrap_or_else(|| Array1::zeros(columns.len()));
        m -= &mean.insert_axis(ndarray::Axis(1));
        m.dot(&m.t()) * ((n - 1.0) / n)
    }

    /// Share of what `found` columns at values `theta` explain that `other` columns could explain as well: the square of the
    /// correlation of the two, everything given taken out.
    pub fn overlap(&self, found: &[usize], theta: &[f64], other: &[usize]) -> f64 {
        let theta = Array1::from_vec(theta.to_vec());
        let own = theta.dot(&self.projected(&self.sums.gram, found, found).dot(&theta));
        let cross = self.projected(&self.sums.gram, other, found).dot(&theta);
        let inverse = pseudo_inverse(&self.projected(&self.sums.gram, other, other));
        if own > 0.0 { (cross.dot(&inverse.dot(&cross)) / own).clamp(0.0, 1.0) } else { 0.0 }
    }
}

/// Standard deviations that a statistic of `dof` degrees of freedom stands for; for tails beyond all tables by their asymptote.
fn strength(t: f64, dof: f64, p: f64) -> f64 {
    if p > 1e-280 { sigmas(p) } else { (t - (dof - 1.0) * (t / dof).max(1.0).ln()).max(0.0).sqrt() }
}

/// Inverse of a symmetric matrix; directions that its scaled form does not tell are left out.
pub fn pseudo_inverse(a: &Array2<f64>) -> Array2<f64> {
    let scale = a.diag().mapv(|v| if v > 0.0 { 1.0 / v.sqrt() } else { 0.0 });
    let n = a.nrows();
    let scaled = Array2::from_shape_fn((n, n), |(i, j)| 0.5 * (a[[i, j]] + a[[j, i]]) * scale[i] * scale[j]);
    let Ok(SymmetricEigen { values, vectors }) = symmetric_eigen(&scaled) else { return Array2::zeros((n, n)) };
    // Gram matrices are summed from f32 products: below this a direction is rounding.
    let floor = 3e-6;
    let inverse = values.mapv(|v| if v > floor { 1.0 / v } else { 0.0 });
    let full = (&vectors * &inverse).dot(&vectors.t());
    Array2::from_shape_fn((n, n), |(i, j)| full[[i, j]] * scale[i] * scale[j])
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::super::design::Cell;
    use super::super::state::Column;
    use super::*;
    use crate::rng::stream;
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
                    pixels: 50,
                    gram: x.dot(&x.t()),
                    log_variance: 0.0,
                });
            }
        }
        Design { columns: vec![Column::Black; 3], replicates: 0, cells }
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
    fn without_an_effect_tails_are_what_they_say() {
        let small =
            (0..200).filter(|seed| Scores::new(&made_up(0.0, 1000 + seed), vec![0]).test(&[1, 2]).unwrap().p < 0.1);
        let n = small.count();
        // Binomial of 200 and 0.1: 20 +- 4.2.
        assert!((6..36).contains(&n), "{n}");
    }

    #[test]
    fn lookalikes_overlap_and_a_nuisance_tells_nothing() {
        let design = made_up(0.2, 5);
        let scores = Scores::new(&design, vec![0]);
        let t = scores.test(&[1]).unwrap();
        // 11 sigma by the noise; fewer are told, since seven frames say little of the scatter between frames.
        assert!(t.z > 4.0 && t.gain > 60.0, "{t:?}");
        assert!((scores.overlap(&[1], &t.theta, &[2]) - 0.64).abs() < 0.05);
        // A column that is the nuisance itself tells nothing.
        assert!(scores.test(&[0]).is_none());
    }

    #[test]
    fn replicates_widen_the_variance() {
        let mut design = made_up(0.0, 9);
        design.replicates = 3;
        for cell in &mut design.cells {
            // Replicates that err along the first template, by -0.1, 0 and 0.1 of it.
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
        let t = Scores::new(&design, vec![0]).test(&[1]).unwrap();
        // 2/3 (0.1^2 + 0 + 0.1^2) beside 1/3150.
        assert!((t.covariance[[0, 0]] - 0.0133).abs() < 0.002 && t.nu < 3.0, "{t:?}");
    }
}
