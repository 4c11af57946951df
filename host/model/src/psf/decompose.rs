//! Truncated singular value decomposition (TSVD) of one lens's bead windows (Eq. 2 of the paper), with pixel weights
//! and missing pixels.
//!
//! ```text
//! H(p; n) ~ sum_k M_k(n) B_k(p)
//! ```
//! The decomposition minimises the misfit in units of each pixel's noise: windows are divided by `sigma(p)`, decomposed
//! through the eigenvectors of their [bead, bead] Gram matrix, and the basis is multiplied by `sigma(p)` again. Pixels
//! that were not measured (off the sensor, saturated) are filled from the model itself until it no longer changes
//! (expectation maximisation; Srebro & Jaakkola, ICML 2003).

use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis, Zip, s};
use ommatidia_physics::linalg::{NotConverged, SymmetricEigen, symmetric_eigen};
use ommatidia_session::rng;
use rand_distr::{Distribution, StandardNormal};

/// Iterations that fill in missing pixels.
const FILL_ROUNDS: usize = 30;
/// Oversampling: directions of the subspace beyond the requested rank (Halko, Martinsson & Tropp, SIAM Review 53,
/// 2011).
const OVERSAMPLING: usize = 8;
/// Pixels per chunk of a sum in f64.
const CHUNK_PX: usize = 4096;

/// A truncated decomposition of bead windows.
#[derive(Clone, Debug)]
pub struct Decomposition {
    /// Basis PSFs as rows of unit norm, by descending singular value, [k, px].
    pub basis: Array2<f32>,
    /// Coefficient of each basis PSF in each window, [bead, k].
    pub coefficients: Array2<f64>,
    /// All singular values of the weighted windows, in descending order.
    pub singular_values: Vec<f64>,
    /// Gram matrix of the weighted windows, [bead, bead].
    pub gram: Array2<f64>,
}

impl Decomposition {
    /// The windows reconstructed from the first `rank` basis PSFs, [bead, px].
    pub fn windows(&self, rank: usize) -> Array2<f32> {
        let rank = rank.min(self.basis.nrows());
        let coefficients = self.coefficients.slice(s![.., ..rank]).mapv(|c| c as f32);
        coefficients.dot(&self.basis.slice(s![..rank, ..]))
    }
}

/// Decomposes `windows` [bead, px] into at most `rank` terms.
///
/// `sigma`, one value for each pixel, is the standard deviation of the noise of each pixel, in any unit. `known`
/// [bead, px] marks the measured pixels (None: all).
///
/// # Errors
/// The windows hold non-finite values.
pub fn decompose(
    windows: ArrayView2<'_, f32>,
    known: Option<ArrayView2<'_, bool>>,
    sigma: ArrayView1<'_, f32>,
    rank: usize,
) -> Result<Decomposition, NotConverged> {
    let Some(known) = known else {
        return decompose_whole(windows, sigma, rank);
    };
    let mut filled = windows.to_owned();
    fill(&mut filled, known, sigma, rank)?;
    decompose_whole(filled.view(), sigma, rank)
}

/// Fills in the pixels that were not measured (`known` is false) from the low-rank model of at most `rank` terms of
/// `windows` [bead, px].
///
/// # Errors
/// The windows hold non-finite values.
pub(super) fn fill(
    filled: &mut Array2<f32>,
    known: ArrayView2<'_, bool>,
    sigma: ArrayView1<'_, f32>,
    rank: usize,
) -> Result<(), NotConverged> {
    let means = known_means(filled.view(), known);
    let broken: Vec<usize> = (0..known.nrows()).filter(|n| known.row(*n).iter().any(|k| !k)).collect();
    Zip::indexed(&mut *filled).and(known).for_each(|(_, p), v, k| {
        if !k {
            *v = means[p];
        }
    });
    let mut weighted = &*filled / &sigma.insert_axis(Axis(0));
    let mut space = Subspace::start(weighted.view(), rank)?;
    // Few terms first: what is missing follows the broad shape before it follows details.
    for round in 0..FILL_ROUNDS {
        space.turn(weighted.view())?;
        let basis = space.leading(rank.min(1 + round / 2));
        for n in &broken {
            let model = basis.dot(&weighted.row(*n)).dot(&basis);
            Zip::from(weighted.row_mut(*n)).and(known.row(*n)).and(&model).for_each(|v, k, m| {
                if !k {
                    *v = *m;
                }
            });
        }
    }
    for n in broken {
        let row = filled.row_mut(n);
        Zip::from(row).and(known.row(n)).and(weighted.row(n)).and(sigma).for_each(|v, k, w, s| {
            if !k {
                *v = w * s;
            }
        });
    }
    Ok(())
}

/// The leading right singular vectors of windows that change little between iterations. Subspace iteration costs two
/// products with the windows an iteration instead of a whole decomposition.
struct Subspace {
    /// Orthonormal rows, by descending energy in the windows, [q, px].
    basis: Array2<f32>,
}

impl Subspace {
    /// A random start, followed by two iterations.
    fn start(windows: ArrayView2<'_, f32>, rank: usize) -> Result<Self, NotConverged> {
        let q = (rank + OVERSAMPLING).min(windows.nrows());
        let mut rng = rng::stream(0, "psf/subspace", 0);
        let mix: Array2<f32> = Array2::from_shape_simple_fn((q, windows.nrows()), || StandardNormal.sample(&mut rng));
        let mut space = Self { basis: orthonormal(mix.dot(&windows))? };
        (0..2).try_for_each(|_| space.turn(windows))?;
        Ok(space)
    }

    /// One iteration towards the leading vectors of `windows` [bead, px].
    fn turn(&mut self, windows: ArrayView2<'_, f32>) -> Result<(), NotConverged> {
        let seen = orthonormal(self.basis.dot(&windows.t()))?;
        self.basis = orthonormal(seen.dot(&windows))?;
        Ok(())
    }

    fn leading(&self, terms: usize) -> ArrayView2<'_, f32> {
        self.basis.slice(s![..terms.min(self.basis.nrows()), ..])
    }
}

/// Orthonormal rows that span those of `rows`, along their principal axes, largest first; directions below rounding
/// error are dropped.
fn orthonormal(rows: Array2<f32>) -> Result<Array2<f32>, NotConverged> {
    let SymmetricEigen { values, vectors } = symmetric_eigen(&gram(rows.view()))?;
    let n = values.len();
    let largest = values.last().copied().unwrap_or(0.0);
    let kept = values.iter().filter(|v| **v > 1e-10 * largest).count();
    let turn = Array2::from_shape_fn((kept, n), |(i, j)| {
        (vectors[[j, n - 1 - i]] / values[n - 1 - i].max(f64::MIN_POSITIVE).sqrt()) as f32
    });
    Ok(turn.dot(&rows))
}

/// The decomposition of windows without missing pixels.
fn decompose_whole(
    windows: ArrayView2<'_, f32>,
    sigma: ArrayView1<'_, f32>,
    rank: usize,
) -> Result<Decomposition, NotConverged> {
    let weighted = &windows / &sigma.insert_axis(Axis(0));
    let gram = gram(weighted.view());
    let SymmetricEigen { values, vectors } = symmetric_eigen(&gram)?;
    let n = windows.nrows();
    let singular_values: Vec<f64> = values.iter().rev().map(|v| v.max(0.0).sqrt()).collect();
    // What lies below rounding of the largest is nothing.
    let floor = 1e-6 * singular_values.first().copied().unwrap_or(0.0);
    let rank = rank.min(singular_values.iter().filter(|s| **s > floor).count());
    let left = Array2::from_shape_fn((n, rank), |(i, k)| vectors[[i, n - 1 - k]]);
    let mut basis = left.mapv(|v| v as f32).t().dot(&weighted) * sigma;
    let mut coefficients = left;
    for k in 0..rank {
        let norm = basis.row(k).iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
        // The sign is free: let each basis PSF hold more light than shadow, so that runs are alike.
        let sign = if basis.row(k).sum() < 0.0 { -1.0 } else { 1.0 };
        basis.row_mut(k).mapv_inplace(|v| (f64::from(v) * sign / norm) as f32);
        coefficients.column_mut(k).mapv_inplace(|c| c * norm * sign);
    }
    Ok(Decomposition { basis, coefficients, singular_values, gram })
}

/// `windows windows'`, summed in f64 over chunks of pixels.
fn gram(windows: ArrayView2<'_, f32>) -> Array2<f64> {
    let n = windows.nrows();
    windows.axis_chunks_iter(Axis(1), CHUNK_PX).fold(Array2::zeros((n, n)), |sum, chunk| {
        let chunk = chunk.mapv(f64::from);
        sum + chunk.dot(&chunk.t())
    })
}

/// Mean of each pixel over the beads that show it.
fn known_means(windows: ArrayView2<'_, f32>, known: ArrayView2<'_, bool>) -> Array1<f32> {
    Zip::from(windows.columns()).and(known.columns()).map_collect(|w, k| {
        let (sum, count) = w.iter().zip(k).filter(|(_, k)| **k).fold((0.0, 0.0), |(s, c), (v, _)| (s + v, c + 1.0));
        sum / f32::max(count, 1.0)
    })
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// Gaussians that widen and stretch over 40 beads, 11 x 11 px.
    fn windows() -> Array2<f32> {
        Array2::from_shape_fn((40, 121), |(n, p)| {
            let (y, x) = ((p / 11) as f64 - 5.0, (p % 11) as f64 - 5.0);
            let (a, b) = (1.5 + 0.03 * n as f64, 2.5 - 0.02 * n as f64);
            (-(y * y / (2.0 * a * a) + x * x / (2.0 * b * b))).exp() as f32
        })
    }

    fn nrmse(got: &Array2<f32>, want: &Array2<f32>) -> f64 {
        let norm = |a: &Array2<f32>| a.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
        norm(&(got - want)) / norm(want)
    }

    #[test]
    fn truncation_error_is_what_the_left_out_singular_values_say() {
        let x = windows();
        let even = Array1::ones(121);
        let d = decompose(x.view(), None, even.view(), 40).unwrap();
        let total: f64 = d.singular_values.iter().map(|s| s * s).sum();
        for rank in [1, 2, 3] {
            let tail: f64 = d.singular_values[rank..].iter().map(|s| s * s).sum();
            let error = nrmse(&d.windows(rank), &x);
            assert!((error - (tail / total).sqrt()).abs() < 1e-5, "{rank} {error}");
        }
        assert!(nrmse(&d.windows(40), &x) < 1e-5);
        let overlap = d.basis.dot(&d.basis.t()) - Array2::<f32>::eye(d.basis.nrows());
        assert!(overlap.slice(s![..4, ..4]).iter().all(|v| v.abs() < 1e-3));
    }

    #[test]
    fn missing_corners_are_filled_from_the_others() {
        let x = windows();
        let known = Array2::from_shape_fn(x.dim(), |(n, p)| !(n % 5 == 0 && p % 11 < 5));
        let broken = Zip::from(&x).and(&known).map_collect(|v, k| if *k { *v } else { 99.0 });
        let even = Array1::ones(121);
        let d = decompose(broken.view(), Some(known.view()), even.view(), 4).unwrap();
        assert!(nrmse(&d.windows(4), &x) < 0.01, "{}", nrmse(&d.windows(4), &x));
    }

    #[test]
    fn weights_keep_noisy_pixels_out_of_the_basis() {
        use rand_distr::{Distribution, StandardNormal};
        let x = windows();
        let sigma = Array1::from_shape_fn(121, |p| if p % 11 == 10 { 1.0 } else { 0.01 });
        let mut rng = rng::stream(2, "weights", 0);
        let noisy = &x
            + &Array2::from_shape_fn(x.dim(), |(_, p)| {
                let z: f32 = StandardNormal.sample(&mut rng);
                z * sigma[p]
            });
        let error = |sigma: ArrayView1<'_, f32>| {
            let model = decompose(noisy.view(), None, sigma, 2).unwrap().windows(2);
            let quiet = Array2::from_shape_fn(x.dim(), |(_, p)| if p % 11 == 10 { 0.0 } else { 1.0 });
            nrmse(&(&model * &quiet), &(&x * &quiet))
        };
        let (weighted, even) = (error(sigma.view()), error(Array1::ones(121).view()));
        assert!(weighted < 0.02 && weighted < 0.5 * even, "{weighted} {even}");
    }
}
