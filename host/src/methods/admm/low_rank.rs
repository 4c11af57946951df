//! ADMM with the spatially varying model.
//!
//! The splits are u = grad x and w = x, with scaled duals a and b. A few conjugate-gradient steps from the last x solve
//! the x-step, `(A'A + mu (grad'grad + 1)) x = A'y + mu (grad'(u - a) + w - b)`, approximately. The method still
//! converges if the errors of all x-steps have a finite sum (J. Eckstein, D. Bertsekas, Math. Program. 55, 293 (1992),
//! theorem 8).

use super::tv::{Edge, gradient, gradient_transposed, shrink};
use super::{AdmmConfig, scaled};
use crate::forward::Forward;
use crate::instrument::Instrument;
use crate::methods::frame::frame_input;
use crate::methods::{MethodError, Reconstruct};
use crate::noise::NoiseModel;
use crate::psf::{LowRankOperator, OperatorError};
use crate::sensor::FrameInput;
use ndarray::{Array2, ArrayView2, Zip};

/// Number of power iterations that estimate the norm of A.
const POWER: usize = 12;

/// ADMM with the low-rank model, planned for one instrument.
#[derive(Clone, Debug)]
pub struct LowRankAdmm {
    config: AdmmConfig,
    input: FrameInput,
    noise: NoiseModel,
    pub(super) operator: LowRankOperator,
    /// Norm of the operator, DN per unit.
    pub(super) norm: f32,
}

impl LowRankAdmm {
    pub(super) fn new(config: AdmmConfig, instrument: &Instrument) -> anyhow::Result<Self> {
        let operator = Forward::new(instrument)?.operator().clone();
        let [rows, cols] = operator.object_shape();
        let mut x = Array2::from_elem((rows, cols), 1.0f32);
        let mut norm = 0.0;
        for _ in 0..POWER {
            let length = dot(&x, &x).sqrt();
            if length <= 0.0 {
                return Err(MethodError::NoLens.into());
            }
            x /= length as f32;
            let image = operator.apply(x.view())?;
            norm = dot(&image, &image).sqrt() as f32;
            x = operator.adjoint(image.view())?;
        }
        if norm <= 0.0 {
            return Err(MethodError::NoLens.into());
        }
        let input = frame_input(instrument)?;
        Ok(Self { config, input, noise: instrument.noise, operator, norm })
    }

    /// A x, where A is divided by its norm.
    pub(super) fn apply(&self, x: &Array2<f32>) -> Result<Array2<f32>, OperatorError> {
        Ok(self.operator.apply(x.view())? / self.norm)
    }

    /// A' y, where A is divided by its norm.
    pub(super) fn adjoint(&self, y: &Array2<f32>) -> Result<Array2<f32>, OperatorError> {
        Ok(self.operator.adjoint(y.view())? / self.norm)
    }

    /// Solves for the object of scaled light `y`, [sensor rows, sensor cols]; `watch` receives w after each iteration.
    pub(super) fn solve(
        &self,
        y: &Array2<f32>,
        tau: f32,
        mut watch: impl FnMut(&Array2<f32>),
    ) -> Result<Array2<f32>, OperatorError> {
        let mu = self.config.penalty as f32;
        let back = self.adjoint(y)?;
        let zero = || Array2::<f32>::zeros(back.dim());
        let (mut x, mut w, mut dual) = (zero(), zero(), zero());
        let (mut u, mut dual_u) = ([zero(), zero()], [zero(), zero()]);
        for _ in 0..self.config.iterations.max(1) {
            let difference = [&u[0] - &dual_u[0], &u[1] - &dual_u[1]];
            let right = &back + (gradient_transposed(&difference, Edge::Mirror) + &w - &dual) * mu;
            self.descend(&mut x, &right, mu)?;
            let slope = gradient(x.view(), Edge::Mirror);
            for a in 0..2 {
                u[a] = &slope[a] + &dual_u[a];
            }
            shrink(&mut u, tau / mu);
            for a in 0..2 {
                dual_u[a] += &(&slope[a] - &u[a]);
            }
            let before = w.clone();
            Zip::from(&mut w).and(&mut dual).and(&x).for_each(|w, dual, &x| {
                *w = (x + *dual).max(0.0);
                *dual += x - *w;
            });
            watch(&w);
            if self.config.has_settled(before.view(), w.view()) {
                break;
            }
        }
        Ok(w)
    }

    /// The matrix of the x-step times `v`.
    fn normal(&self, v: &Array2<f32>, mu: f32) -> Result<Array2<f32>, OperatorError> {
        let data = self.adjoint(&self.apply(v)?)?;
        Ok(data + (gradient_transposed(&gradient(v.view(), Edge::Mirror), Edge::Mirror) + v) * mu)
    }

    /// A few conjugate-gradient steps of the x-step, in place on `x`.
    fn descend(&self, x: &mut Array2<f32>, right: &Array2<f32>, mu: f32) -> Result<(), OperatorError> {
        let mut residual = right - &self.normal(x, mu)?;
        let mut direction = residual.clone();
        let mut square = dot(&residual, &residual);
        for _ in 0..self.config.inner.max(1) {
            if square <= 0.0 {
                break;
            }
            let image = self.normal(&direction, mu)?;
            let step = (square / dot(&direction, &image)) as f32;
            x.scaled_add(step, &direction);
            residual.scaled_add(-step, &image);
            let next = dot(&residual, &residual);
            direction = &residual + direction * (next / square) as f32;
            square = next;
        }
        Ok(())
    }
}

fn dot(a: &Array2<f32>, b: &Array2<f32>) -> f64 {
    a.iter().zip(b).map(|(&a, &b)| f64::from(a) * f64::from(b)).sum()
}

impl Reconstruct for LowRankAdmm {
    fn name(&self) -> &str {
        "admm"
    }

    fn reconstruct(&self, frame_dn: ArrayView2<'_, f32>) -> anyhow::Result<Array2<f32>> {
        let [rows, cols] = self.operator.object_shape();
        match scaled(&self.input, &self.noise, self.config.tv, frame_dn)? {
            None => Ok(Array2::zeros((rows, cols))),
            Some(s) => Ok(self.solve(&s.y, s.tau, |_| ())?),
        }
    }
}
