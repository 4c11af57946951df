//! Richardson-Lucy iterations with a spatially varying model: they climb to the maximum of the Poisson likelihood over
//! objects >= 0.
//!
//! `x <- x . A'(y / (A x + b)) / A'1` (W. H. Richardson, J. Opt. Soc. Am. 62, 55 (1972); L. B. Lucy, Astron. J. 79, 745
//! (1974)). Read noise enters as a constant background `b` on both sides: it gives a Poisson variable the variance of
//! the mixed Poisson and Gaussian one (D. L. Snyder et al., J. Opt. Soc. Am. A 10, 1014 (1993)).

use crate::psf::{LowRankOperator, OperatorError};
use ndarray::{Array2, ArrayView2, Zip};
use ommatidia_physics::noise::NoiseModel;
use std::sync::Arc;

/// Smallest background, DN: it keeps quotients finite on a sensor without read noise.
const LEAST_BACKGROUND_DN: f32 = 1e-3;

/// The iterations for one model and one sensor.
#[derive(Clone, Debug)]
pub struct RichardsonLucy {
    operator: Arc<LowRankOperator>,
    /// A'1: light that the sensor receives from each object pixel, DN per unit.
    sensitivity: Array2<f32>,
    background_dn: f32,
}

impl RichardsonLucy {
    /// Plans the iterations.
    ///
    /// # Errors
    /// None that a planned operator can cause.
    pub fn new(operator: impl Into<Arc<LowRankOperator>>, noise: &NoiseModel) -> Result<Self, OperatorError> {
        let operator = operator.into();
        let sensitivity = operator.adjoint(Array2::ones(operator.sensor_shape()).view())?;
        // A variable of variance gain * signal + (gain * read noise)^2 is, up to the gain, Poisson distributed with
        // mean signal + gain * read noise^2.
        let background_dn = (noise.gain_dn_per_e * noise.read_noise_e.powi(2)) as f32;
        Ok(Self { operator, sensitivity, background_dn: background_dn.max(LEAST_BACKGROUND_DN) })
    }

    /// Whether light of any object pixel reaches the sensor.
    pub fn sees(&self) -> bool {
        self.sensitivity.iter().any(|&v| v > 0.0)
    }

    /// The measured light, DN, as the iterations take it: with the background, and not below 0.
    pub fn measured(&self, light_dn: ArrayView2<'_, f32>) -> Array2<f32> {
        light_dn.mapv(|v| (v + self.background_dn).max(0.0))
    }

    /// The even object that explains the light in `y`, which [`RichardsonLucy::measured`] gave.
    pub fn even(&self, y: &Array2<f32>) -> Array2<f32> {
        let light: f64 = y.iter().map(|&v| f64::from(v)).sum();
        let sensitivity: f64 = self.sensitivity.iter().map(|&v| f64::from(v.max(0.0))).sum();
        let even = (light / sensitivity).max(f64::from(f32::MIN_POSITIVE)) as f32;
        Array2::from_elem(self.sensitivity.dim(), even)
    }

    /// One iteration on `x`, in place.
    ///
    /// # Errors
    /// A shape is not that of the model.
    pub fn step(&self, y: &Array2<f32>, x: &mut Array2<f32>) -> Result<(), OperatorError> {
        let mut ratio = self.operator.apply(x.view())?;
        // The truncated basis can give slightly negative light; the background keeps the quotient finite.
        Zip::from(&mut ratio).and(y).for_each(|r, &y| *r = y / (r.max(0.0) + self.background_dn));
        let back = self.operator.adjoint(ratio.view())?;
        Zip::from(x).and(&back).and(&self.sensitivity).for_each(|x, &b, &s| {
            *x = if s > 0.0 { *x * (b / s).max(0.0) } else { 0.0 };
        });
        Ok(())
    }

    /// The object after `iterations` iterations from an even start, each from a point that is moved on along the last
    /// change (D. S. C. Biggs, M. Andrews, Appl. Opt. 36, 1766 (1997)): far fewer are needed than of plain ones.
    ///
    /// # Errors
    /// As [`RichardsonLucy::step`].
    pub fn accelerated(&self, light_dn: ArrayView2<'_, f32>, iterations: usize) -> Result<Array2<f32>, OperatorError> {
        let y = self.measured(light_dn);
        let mut x = self.even(&y);
        let mut before = x.clone();
        // Changes by the last two iterations.
        let mut changes: [Option<Array2<f32>>; 2] = [None, None];
        for _ in 0..iterations {
            let momentum = match &changes {
                [Some(last), Some(older)] => (dot(last, older) / dot(older, older).max(f64::MIN_POSITIVE)) as f32,
                _ => 0.0,
            };
            let momentum = momentum.clamp(0.0, 1.0);
            let from = Zip::from(&x).and(&before).map_collect(|&x, &b| (x + momentum * (x - b)).max(0.0));
            before = x;
            x = from.clone();
            self.step(&y, &mut x)?;
            let [last, _] = changes;
            changes = [Some(&x - &from), last];
        }
        Ok(x)
    }
}

fn dot(a: &Array2<f32>, b: &Array2<f32>) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::forward::Forward;

    /// Each focus is blurred by a kernel whose transfer function is at least 0.6, so no frequency is lost.
    fn blurred() -> RichardsonLucy {
        let mut instrument = crate::testing::square_array(3, [60, 60], [20, 20]);
        for lens in 0..9 {
            for (i, v) in [0.05f32, 0.1, 0.05, 0.1, 0.8, 0.1, 0.05, 0.1, 0.05].into_iter().enumerate() {
                instrument.psf.basis[[lens, 0, i / 3, i % 3]] = v;
            }
        }
        RichardsonLucy::new(Forward::new(&instrument).unwrap().operator().clone(), &instrument.noise).unwrap()
    }

    fn light(solver: &RichardsonLucy) -> Array2<f32> {
        let object = Array2::from_shape_fn((20, 20), |(r, c)| if (r * 7 + c * 3) % 11 == 0 { 100.0 } else { 2.0 });
        solver.operator.apply(object.view()).unwrap()
    }

    /// Poisson log-likelihood of `y` given the mean `A x + b`, without terms that do not depend on x.
    fn likelihood(solver: &RichardsonLucy, y: &Array2<f32>, x: &Array2<f32>) -> f64 {
        let model = solver.operator.apply(x.view()).unwrap() + solver.background_dn;
        y.iter().zip(&model).map(|(&y, &m)| f64::from(y) * f64::from(m).ln() - f64::from(m)).sum()
    }

    #[test]
    fn each_step_raises_the_likelihood() {
        let solver = blurred();
        let y = solver.measured(light(&solver).view());
        let mut x = Array2::from_elem((20, 20), 10.0f32);
        let mut before = likelihood(&solver, &y, &x);
        for _ in 0..10 {
            solver.step(&y, &mut x).unwrap();
            let after = likelihood(&solver, &y, &x);
            assert!(after > before, "{after} {before}");
            before = after;
        }
    }

    /// Accelerated iterations are ahead of twice as many plain ones. The first one has no momentum.
    #[test]
    fn acceleration_saves_iterations() {
        let solver = blurred();
        let light = light(&solver);
        let y = solver.measured(light.view());
        let plain = |iterations| {
            let mut x = solver.even(&y);
            (0..iterations).for_each(|_| solver.step(&y, &mut x).unwrap());
            x
        };
        let accelerated = |iterations| solver.accelerated(light.view(), iterations).unwrap();
        assert_eq!(accelerated(1), plain(1));
        let [fast, slow] = [accelerated(12), plain(24)].map(|x| likelihood(&solver, &y, &x));
        assert!(fast > slow, "{fast} {slow}");
        assert!(accelerated(12).iter().all(|v| v.is_finite() && *v >= 0.0));
    }
}
