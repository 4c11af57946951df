//! The maps: least squares over specimens of random points.
//!
//! Let theta hold the displacements and gains of all lenses, with variances sigma_k^2 about what was calibrated, and
//! let a specimen be [`SOURCES`] points of equal light at random places. With f the sums of its frame over the
//! functions of the basis, divided by the light of the frame, phi those of the calibrated instrument and Phi_k their
//! changes, the map w of parameter j minimises
//!
//! ```text
//! E |w . f - t_j|^2,   f = phi + sum_k theta_k Phi_k + noise,   t_j = theta_j - mean of the others of its kind
//! (E phi phi' + sum_k sigma_k^2 E Phi_k Phi_k' + N + O) w = sum_k sigma_k^2 T_jk E Phi_k
//! ```
//! For sums of random points E phi phi' = (mean of phi_p phi_p') / M + (1 - 1/M) (mean of phi_p)(mean of phi_p)', and
//! so on. N is the noise at [`LIGHT`] of full scale, O an even background and the offsets of the pixels. Then w is
//! scaled so that the mean response to its own lens is 1. A displacement common to all lenses is a displacement of
//! the specimen, which nobody can tell from it: t_j holds only what is left.

use super::WatchError;
use super::figures::LIGHT;
use super::points::{Basis, Point, points_of};
use ndarray::{Array1, Array2, Axis, s};
use ommatidia_model::forward::Forward;
use ommatidia_model::instrument::Instrument;
use ommatidia_physics::linalg::symmetric_eigen;
use ommatidia_shared::blob::Size;
use ommatidia_shared::watch::MOMENTS;
use rayon::prelude::*;
use std::ops::Range;

/// Points of a specimen.
const SOURCES: f64 = 30.0;
/// Standard deviations of displacements, px, and of gains, for the maps of displacements: a gain moves the balance of
/// the views of a specimen that does not lie in the middle, which no map can tell from a displacement.
const FOR_SHIFTS: [f64; 2] = [0.05, 0.001];
/// The same for the maps of gains.
const FOR_GAINS: [f64; 2] = [0.1, 0.05];
/// Share of an even background in the light.
const BACKGROUND: f64 = 0.02;
/// Variance that is added everywhere, as a share of the largest variance by noise: it holds maps where no light falls.
const RIDGE: f64 = 0.01;
/// Eigenvalues below this share of the largest one count as zero.
const NOTHING: f64 = 1e-13;

/// Maps as coefficients of the basis.
#[derive(Clone, Debug)]
pub struct Fitted {
    /// The basis.
    pub(super) basis: Basis,
    /// Maps, [statistic, function], in pixels or 1 for a light of 1; zeros where a lens gives no light. Those of gains
    /// are constant in each block.
    pub(super) maps: Array2<f64>,
}

impl Fitted {
    /// Finds the maps.
    ///
    /// # Errors
    /// The model holds values that are not finite.
    pub(super) fn of(i: &Instrument, forward: &Forward, frame: Size, block: u8) -> Result<Self, WatchError> {
        let basis = Basis { frame, block };
        let points = points_of(i, forward, basis);
        let lenses = forward.operator().corners().len();
        let mut maps = Array2::zeros((3 * lenses, basis.len()));
        let others: Vec<Vec<Point>> = (0..i.replicates.len())
            .into_par_iter()
            .filter_map(|j| Some(points_of(&i.replicate(j)?, forward, basis)))
            .filter(|others| others.len() == points.len())
            .collect();
        // What the calibration errs by, as it would be in the frame of each point.
        let errors: Vec<Vec<Point>> =
            others.iter().map(|others| points.iter().zip(others).map(difference).collect()).collect();
        let fit = Fit { i, forward, basis };
        let shifts = fit.solve(&points, &errors, FOR_SHIFTS, 0..2 * lenses)?;
        maps.slice_mut(s![..2 * lenses, ..]).assign(&shifts);
        let flat = |points: &Vec<Point>| -> Vec<Point> {
            points.iter().map(|point| point.mapped(|sums| sums.slice(s![..;MOMENTS]).to_owned())).collect()
        };
        let (points, errors) = (flat(&points), errors.iter().map(flat).collect::<Vec<_>>());
        let gains = fit.solve(&points, &errors, FOR_GAINS, 2 * lenses..3 * lenses)?;
        maps.slice_mut(s![2 * lenses.., ..;MOMENTS]).assign(&gains);
        Ok(Self { basis, maps })
    }
}

/// What the normal equations are made of.
struct Fit<'a> {
    i: &'a Instrument,
    forward: &'a Forward,
    basis: Basis,
}

impl Fit<'_> {
    /// The maps of some statistics, [statistic, function], over the functions that the points hold: all, or the
    /// constants.
    fn solve(
        &self,
        points: &[Point],
        errors: &[Vec<Point>],
        spread: [f64; 2],
        wanted: Range<usize>,
    ) -> Result<Array2<f64>, WatchError> {
        let count = points.first().map_or(0, |point| point.whole.len());
        let every = if count == self.basis.len() { 1 } else { MOMENTS };
        let held = |sums: &Array1<f64>| sums.slice(s![..;every]).to_owned();
        let (frame, noise) = (self.basis.frame, self.forward.noise());
        let pixels = f64::from(frame.rows) * f64::from(frame.cols);
        let light_dn = LIGHT * (noise.saturation_dn - noise.black_level_dn) * pixels;
        let living: Vec<bool> = self.forward.operator().corners().iter().map(Option::is_some).collect();
        let lenses = living.len();
        let mut normal = moment(points, |point| vec![(1.0, &point.whole)]);
        normal += &moment(points, |point| {
            let changes = point.change.iter().enumerate();
            changes.map(|(k, change)| (spread[usize::from(k >= 2 * lenses)], change)).collect()
        });
        for replicate in errors {
            // The covariance of the jackknife: (J - 1)/J times the sum over the replicates.
            let factor = (errors.len() - 1) as f64 / errors.len() as f64;
            normal.scaled_add(factor, &moment(replicate, |point| vec![(1.0, &point.whole)]));
        }
        let variance = held(&self.noise(light_dn));
        let ridge = RIDGE * variance.fold(0.0f64, |m, v| m.max(*v));
        normal += &Array2::from_diag(&variance.mapv(|v| v + ridge));
        let even = self.i.response.clone().unwrap_or_else(|| Array2::ones([frame.rows.into(), frame.cols.into()]));
        add_outer(&mut normal, &(held(&self.basis.of(&even)) * (BACKGROUND / pixels)), 1.0);
        if let Some(offset) = &self.i.offset_dn {
            add_outer(&mut normal, &(held(&self.basis.of(offset)) / light_dn), 1.0);
        }
        let mean: Vec<Array1<f64>> = (0..3 * lenses).map(|k| average(points, |point| &point.change[k])).collect();
        let mut right = Array2::zeros((count, wanted.len()));
        for (j, mut column) in wanted.clone().zip(right.columns_mut()).filter(|(j, _)| living[j % lenses]) {
            let others: Vec<usize> = (0..lenses).filter(|l| living[*l] && *l != j % lenses).collect();
            column += &mean[j];
            others.iter().for_each(|l| column.scaled_add(-1.0 / others.len() as f64, &mean[j / lenses * lenses + l]));
        }
        let eigen = symmetric_eigen(&normal)?;
        let floor = NOTHING * eigen.values.iter().fold(0.0f64, |m, v| m.max(*v));
        let inverse = eigen.values.mapv(|v| if v > floor { 1.0 / v } else { 0.0 });
        let projected = &eigen.vectors.t().dot(&right) * &inverse.insert_axis(Axis(1));
        let mut maps = eigen.vectors.dot(&projected).reversed_axes();
        for (j, mut map) in wanted.zip(maps.outer_iter_mut()) {
            let response = map.dot(&mean[j]);
            map.mapv_inplace(|v| if response > 0.0 { v / response } else { 0.0 });
        }
        Ok(maps)
    }

    /// Variance of the sums over all functions by noise, for an even specimen whose frame has this light. Functions of
    /// a block are orthogonal where its light is even.
    fn noise(&self, light_dn: f64) -> Array1<f64> {
        let Self { forward, basis, .. } = self;
        let even = Array2::ones(forward.operator().object_shape());
        let light = forward.operator().apply(even.view()).unwrap_or_default();
        let light = basis.of(&light);
        let total = light.iter().step_by(MOMENTS).sum::<f64>().max(f64::MIN_POSITIVE);
        let noise = forward.noise();
        let reading = (noise.gain_dn_per_e * noise.read_noise_e).powi(2) + 1.0 / 12.0;
        let (mut squares, mut pixels) = (Array1::<f64>::zeros(basis.len()), Array1::<f64>::zeros(basis.len()));
        for (r, c) in (0..usize::from(basis.frame.rows)).flat_map(|r| (0..basis.frame.cols.into()).map(move |c| (r, c)))
        {
            let (first, values, _) = basis.at(r, c);
            for (m, v) in values.iter().enumerate() {
                squares[first + m] += v * v;
                pixels[first + m] += 1.0;
            }
        }
        Array1::from_shape_fn(basis.len(), |k| {
            let share = light[k - k % MOMENTS].max(0.0) / total / pixels[k];
            squares[k] * (noise.gain_dn_per_e * share / light_dn + reading / light_dn.powi(2))
        })
    }
}

/// What a replicate makes of a point, less what the calibration makes of it.
fn difference((point, other): (&Point, &Point)) -> Point {
    Point { whole: &other.whole - &point.whole, change: Vec::new() }
}

/// Expected outer product over specimens of random points of some vectors of each point, each with its weight.
fn moment<'a>(points: &'a [Point], of: impl Fn(&'a Point) -> Vec<(f64, &'a Array1<f64>)>) -> Array2<f64> {
    let Some(first) = points.first() else { return Array2::zeros((0, 0)) };
    let (n, count) = (first.whole.len(), of(first).len());
    let mut sum = Array2::zeros((n, n));
    for k in 0..count {
        let mut all = Array2::zeros((points.len(), n));
        for (point, mut row) in points.iter().zip(all.outer_iter_mut()) {
            let (weight, vector) = of(point)[k];
            row.scaled_add(weight, vector);
        }
        let mean = all.mean_axis(Axis(0)).unwrap_or_default();
        sum.scaled_add(1.0 / (SOURCES * points.len() as f64), &all.t().dot(&all));
        add_outer(&mut sum, &mean, 1.0 - 1.0 / SOURCES);
    }
    sum
}

fn average<'a>(points: &'a [Point], of: impl Fn(&'a Point) -> &'a Array1<f64>) -> Array1<f64> {
    let mut sum = Array1::zeros(points.first().map_or(0, |point| point.whole.len()));
    points.iter().for_each(|point| sum += of(point));
    sum / points.len().max(1) as f64
}

fn add_outer(to: &mut Array2<f64>, vector: &Array1<f64>, factor: f64) {
    let column = vector.view().insert_axis(Axis(1));
    to.scaled_add(factor, &column.dot(&vector.view().insert_axis(Axis(0))));
}
