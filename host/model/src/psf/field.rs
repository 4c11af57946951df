//! Smooth functions over the field from values at scattered places: polyharmonic smoothing splines.
//!
//! This module knows nothing of PSFs. A function is `f(x) = sum_i c_i phi_m(|x - x_i|) + polynomial of degree < m` with
//! `phi_m(r) = +-r^(2m-2) log r`; it minimises the squared misfit + lambda * (m-th derivatives squared, over the plane)
//! (Wahba, *Spline Models for Observational Data*, 1990, ch. 2). Lambda is chosen for each function by generalised
//! cross-validation, `GCV = n |(I - A) y|^2 / tr(I - A)^2`; the order m is given, or chosen in the same way. Positions
//! may be a grid or lie anywhere.
//!
//! Plain GCV now and then takes noise for structure, by far: a function then follows every value. So each degree of
//! freedom that smoothing leaves beyond the polynomials counts 1.2 times (Kim & Gu, J. R. Stat. Soc. B 66, 337,
//! 2004, who recommend 1.2 to 1.4).

use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis, s};
use ommatidia_physics::linalg::{NotConverged, SymmetricEigen, least_squares, symmetric_eigen};

/// Orders m that are tried: 2 is the thin-plate spline; higher orders reproduce polynomials of higher degree.
pub const ORDERS: [usize; 3] = [2, 3, 4];
/// Number of smoothing parameters lambda that are tried: 10^-11 to 10^2 times the largest eigenvalue, in half decades.
const LAMBDAS: std::ops::RangeInclusive<i32> = -22..=4;

/// What a degree of freedom beyond the polynomials counts in cross-validation. Of 1, 1.2 and 1.4 this had the least
/// error
/// on beads that were left out, in each of eight virtual scans of 81 beads.
const COST: f64 = 1.2;

/// Smoothing splines planned for one set of positions, for any number of functions sampled there.
#[derive(Clone, Debug)]
pub struct FieldSmoother {
    positions: Array2<f64>,
    scale: Scale,
    orders: Vec<OrderPlan>,
}

/// Smooth functions over the field.
#[derive(Clone, Debug)]
pub struct Field {
    positions: Array2<f64>,
    scale: Scale,
    functions: Vec<Spline>,
}

/// One function: its kernel weights and polynomial. Without weights it is a constant.
#[derive(Clone, Debug)]
struct Spline {
    order: usize,
    kernel: Array1<f64>,
    polynomial: Array1<f64>,
}

/// Scales positions to coordinates of order one.
#[derive(Clone, Copy, Debug)]
struct Scale {
    centre: [f64; 2],
    half: f64,
}

impl Scale {
    fn of(positions: ArrayView2<'_, f64>) -> Self {
        let range = |a: usize| {
            positions.column(a).iter().fold([f64::INFINITY, f64::NEG_INFINITY], |r, v| [r[0].min(*v), r[1].max(*v)])
        };
        let [y, x] = [range(0), range(1)];
        let half = ((y[1] - y[0]).max(x[1] - x[0]) / 2.0).max(f64::MIN_POSITIVE);
        Self { centre: [(y[0] + y[1]) / 2.0, (x[0] + x[1]) / 2.0], half }
    }

    fn apply(&self, positions: ArrayView2<'_, f64>) -> Array2<f64> {
        Array2::from_shape_fn(positions.dim(), |(i, a)| (positions[[i, a]] - self.centre[a]) / self.half)
    }
}

/// One order m, planned: `K` on the complement of the polynomials, diagonalised.
#[derive(Clone, Debug)]
struct OrderPlan {
    order: usize,
    polynomials: Array2<f64>,
    kernel: Array2<f64>,
    eigenvalues: Array1<f64>,
    /// Its columns span the orthogonal complement of the polynomials, in the eigenbasis of the kernel.
    vectors: Array2<f64>,
}

impl FieldSmoother {
    /// Plans for positions [n, (row, col)], with each of `orders` for which there are enough positions.
    ///
    /// # Errors
    /// A position is not finite.
    pub fn plan(positions: ArrayView2<'_, f64>, orders: &[usize]) -> Result<Self, NotConverged> {
        let scale = Scale::of(positions);
        let scaled = scale.apply(positions);
        let fits = orders.iter().filter(|m| terms(**m) < positions.nrows());
        let orders = fits.map(|m| OrderPlan::new(*m, &scaled)).collect::<Result<_, _>>()?;
        Ok(Self { positions: scaled, scale, orders })
    }

    /// Fits smooth functions to `values` [n, functions].
    ///
    /// Where there are too few positions for any order, each function is the mean of its values.
    ///
    /// # Errors
    /// A value is not finite.
    pub fn fit(&self, values: ArrayView2<'_, f64>) -> Result<Field, NotConverged> {
        let functions = values.axis_iter(Axis(1)).map(|y| self.fit_one(y)).collect::<Result<_, _>>()?;
        Ok(Field { positions: self.positions.clone(), scale: self.scale, functions })
    }

    fn fit_one(&self, y: ArrayView1<'_, f64>) -> Result<Spline, NotConverged> {
        let choices = self.orders.iter().filter_map(|plan| plan.choose(y).map(|(gcv, lambda)| (gcv, plan, lambda)));
        let best = choices.min_by(|a, b| a.0.total_cmp(&b.0));
        match best {
            Some((_, plan, lambda)) => plan.solve(y, lambda),
            None => Ok(Spline {
                order: 1,
                kernel: Array1::zeros(0),
                polynomial: Array1::from_elem(1, y.mean().unwrap_or(0.0)),
            }),
        }
    }
}

impl OrderPlan {
    fn new(order: usize, positions: &Array2<f64>) -> Result<Self, NotConverged> {
        let polynomials = polynomials(positions, order);
        // An orthonormal basis of the polynomials, then of what they leave.
        let SymmetricEigen { values, vectors } = symmetric_eigen(&polynomials.dot(&polynomials.t()))?;
        let largest = values[values.len() - 1];
        let rank = values.iter().filter(|v| **v > 1e-12 * largest).count();
        let rest = vectors.slice(s![.., ..positions.nrows() - rank]);
        let kernel = kernel_matrix(positions, positions, order);
        let SymmetricEigen { values: eigenvalues, vectors: turn } = symmetric_eigen(&rest.t().dot(&kernel).dot(&rest))?;
        Ok(Self { order, polynomials, kernel, eigenvalues: eigenvalues.mapv(|e| e.max(0.0)), vectors: rest.dot(&turn) })
    }

    /// The least GCV and its lambda; None where the polynomials fit exactly.
    fn choose(&self, y: ArrayView1<'_, f64>) -> Option<(f64, f64)> {
        let z = self.vectors.t().dot(&y);
        let largest = self.eigenvalues.iter().fold(0.0f64, |m, e| m.max(*e));
        if largest <= 0.0 {
            return None;
        }
        LAMBDAS
            .filter_map(|i| {
                let lambda = largest * 10f64.powf(f64::from(i) / 2.0);
                let kept = self.eigenvalues.mapv(|e| lambda / (e + lambda));
                let misfit: f64 = z.iter().zip(&kept).map(|(z, k)| (z * k).powi(2)).sum();
                let most = z.len() as f64;
                let free = most - COST * (most - kept.sum());
                (free > 0.0).then(|| (y.len() as f64 * misfit / (free * free), lambda))
            })
            .min_by(|a, b| a.0.total_cmp(&b.0))
    }

    fn solve(&self, y: ArrayView1<'_, f64>, lambda: f64) -> Result<Spline, NotConverged> {
        let z = self.vectors.t().dot(&y) / self.eigenvalues.mapv(|e| e + lambda);
        let kernel = self.vectors.dot(&z);
        let rest = &y - &self.kernel.dot(&kernel) - &(&kernel * lambda);
        let polynomial = least_squares(&self.polynomials, &rest.insert_axis(Axis(1)))?.remove_axis(Axis(1));
        Ok(Spline { order: self.order, kernel, polynomial })
    }
}

impl Field {
    /// Number of functions.
    pub fn functions(&self) -> usize {
        self.functions.len()
    }

    /// The functions evaluated at positions [m, (row, col)]: [m, functions].
    pub fn at(&self, positions: ArrayView2<'_, f64>) -> Array2<f64> {
        let scaled = self.scale.apply(positions);
        let mut out = Array2::zeros((positions.nrows(), self.functions.len()));
        let mut orders: Vec<usize> = self.functions.iter().map(|f| f.order).collect();
        orders.sort_unstable();
        orders.dedup();
        for order in orders {
            let polynomials = polynomials(&scaled, order);
            let kernel = (order > 1).then(|| kernel_matrix(&scaled, &self.positions, order));
            for (f, mut column) in
                self.functions.iter().zip(out.axis_iter_mut(Axis(1))).filter(|(f, _)| f.order == order)
            {
                column.assign(&polynomials.dot(&f.polynomial));
                if let Some(kernel) = &kernel {
                    column += &kernel.dot(&f.kernel);
                }
            }
        }
        out
    }
}

/// Number of monomials of degree < m in two variables.
fn terms(m: usize) -> usize {
    m * (m + 1) / 2
}

/// The monomials y^i x^j with i + j < m at n positions, [n, terms].
fn polynomials(positions: &Array2<f64>, m: usize) -> Array2<f64> {
    let powers: Vec<[i32; 2]> = (0..m as i32).flat_map(|i| (0..m as i32 - i).map(move |j| [i, j])).collect();
    Array2::from_shape_fn((positions.nrows(), powers.len()), |(n, t)| {
        positions[[n, 0]].powi(powers[t][0]) * positions[[n, 1]].powi(powers[t][1])
    })
}

/// `(-1)^m r^(2m-2) log r` between two sets of positions.
fn kernel_matrix(to: &Array2<f64>, from: &Array2<f64>, m: usize) -> Array2<f64> {
    let sign = if m.is_multiple_of(2) { 0.5 } else { -0.5 };
    Array2::from_shape_fn((to.nrows(), from.nrows()), |(i, j)| {
        let r2 = (to[[i, 0]] - from[[j, 0]]).powi(2) + (to[[i, 1]] - from[[j, 1]]).powi(2);
        if r2 > 0.0 { sign * r2.powi(m as i32 - 1) * r2.ln() } else { 0.0 }
    })
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use rand_distr::{Distribution, StandardNormal};

    /// 169 places: a 13 x 13 grid, or the same number scattered.
    fn places(grid: bool) -> Array2<f64> {
        let mut rng = ommatidia_session::rng::stream(1, "places", 0);
        Array2::from_shape_fn((169, 2), |(i, a)| {
            let node = [i / 13, i % 13][a] as f64 * 8.0;
            let jitter: f64 = StandardNormal.sample(&mut rng);
            if grid { node } else { node + 2.0 * jitter }
        })
    }

    fn truth(y: f64, x: f64) -> f64 {
        (0.03 * y + 0.5).sin() * (0.02 * x).cos() + 1e-4 * (x - 40.0) * (y - 50.0)
    }

    fn values(at: &Array2<f64>) -> Array2<f64> {
        Array2::from_shape_fn((at.nrows(), 1), |(i, _)| truth(at[[i, 0]], at[[i, 1]]))
    }

    fn rms(a: &Array2<f64>) -> f64 {
        (a.iter().map(|v| v * v).sum::<f64>() / a.len() as f64).sqrt()
    }

    #[test]
    fn smooth_functions_are_followed_between_the_places() {
        let between = Array2::from_shape_fn((144, 2), |(i, a)| [i / 12, i % 12][a] as f64 * 8.0 + 4.0);
        for grid in [true, false] {
            let at = places(grid);
            let field = FieldSmoother::plan(at.view(), &ORDERS).unwrap().fit(values(&at).view()).unwrap();
            let error = rms(&(field.at(between.view()) - values(&between)));
            assert!(error < if grid { 1e-4 } else { 1e-3 }, "{grid} {error}");
        }
    }

    #[test]
    fn noise_is_averaged_away_not_followed() {
        let at = places(true);
        let mut rng = ommatidia_session::rng::stream(1, "noise", 0);
        let noisy = values(&at)
            + Array2::from_shape_fn((169, 1), |_| 0.1 * Distribution::<f64>::sample(&StandardNormal, &mut rng));
        let field = FieldSmoother::plan(at.view(), &ORDERS).unwrap().fit(noisy.view()).unwrap();
        // About a dozen degrees of freedom out of 169 remain: 0.1 * sqrt(12 / 169) = 0.027.
        let error = rms(&(field.at(at.view()) - values(&at)));
        assert!(error < 0.045, "{error}");
    }

    /// Of many functions of noise alone, none may be followed: one such coefficient map spoils a PSF model.
    #[test]
    fn noise_is_never_followed() {
        let at = Array2::from_shape_fn((81, 2), |(i, a)| [i / 9, i % 9][a] as f64 * 5.0);
        let mut rng = ommatidia_session::rng::stream(2, "noise", 0);
        let noise = Array2::from_shape_fn((81, 400), |_| Distribution::<f64>::sample(&StandardNormal, &mut rng));
        let field = FieldSmoother::plan(at.view(), &ORDERS[..1]).unwrap().fit(noise.view()).unwrap();
        // A plane fitted to noise of 81 values has sqrt(3 / 81) = 0.19 rms, and 0.4 at most; following it all, 1.
        let found = field.at(at.view());
        let rms: Vec<f64> = found.columns().into_iter().map(|c| (c.dot(&c) / 81.0).sqrt()).collect();
        let worst = rms.iter().fold(0.0f64, |m, v| m.max(*v));
        let far = rms.iter().filter(|r| **r > 0.5).count();
        assert!(worst < 0.9 && far <= 12, "worst {worst}, {far} of 400 above a half");
    }

    #[test]
    fn quadratics_come_back_exactly_and_few_places_are_no_failure() {
        let at = places(false);
        let y = Array2::from_shape_fn((169, 2), |(i, f)| if f == 0 { 3.0 } else { at[[i, 0]] * at[[i, 1]] });
        let field = FieldSmoother::plan(at.view(), &ORDERS).unwrap().fit(y.view()).unwrap();
        let far = ndarray::arr2(&[[30.0, 60.0], [-5.0, 99.0]]);
        let got = field.at(far.view());
        assert!(
            (got[[0, 1]] - 1800.0).abs() < 1e-4
                && (got[[1, 1]] + 495.0).abs() < 1e-2
                && (got[[1, 0]] - 3.0).abs() < 1e-6
        );
        for n in [1, 2, 3, 4, 5] {
            let few = at.slice(s![..n, ..]);
            let field = FieldSmoother::plan(few, &ORDERS).unwrap().fit(Array2::from_elem((n, 1), 7.0).view()).unwrap();
            assert!((field.at(far.view())[[0, 0]] - 7.0).abs() < 1e-6, "{n}");
        }
    }

    #[test]
    fn a_scan_along_one_line_is_no_failure() {
        let line = Array2::from_shape_fn((20, 2), |(i, a)| if a == 0 { i as f64 } else { 5.0 });
        let y = Array2::from_shape_fn((20, 1), |(i, _)| 2.0 * i as f64);
        let field = FieldSmoother::plan(line.view(), &ORDERS).unwrap().fit(y.view()).unwrap();
        assert!((field.at(ndarray::arr2(&[[7.5, 5.0]]).view())[[0, 0]] - 15.0).abs() < 1e-3);
    }
}
