//! Predicts the frames of reconstructions, for the passes of a network with feedback.

use super::ops::predicted::Linear;
use super::weights::{BASIS, COEFFICIENTS, NODES};
use super::{NetworkConfig, TrainError};
use ndarray::{ArrayView2, Axis, Ix1, Ix4};
use ommatidia_model::psf::{CalibratedOptics, ChiefRays, LowRankOperator, LowRankPsf, OperatorConfig};
use ommatidia_session::artifact::Tensors;
use std::sync::Arc;

/// The short low-rank model of the calibrated PSFs. Clones share one plan.
#[derive(Clone, Debug)]
pub struct Predictor {
    operator: Arc<LowRankOperator>,
}

impl Predictor {
    /// The predictor of a network with feedback, from its tensors; None without feedback.
    ///
    /// # Errors
    /// A tensor is missing or has the wrong shape, or nodes do not ascend.
    pub fn of(config: &NetworkConfig, tensors: &Tensors) -> Result<Option<Self>, TrainError> {
        let Some(feedback) = &config.feedback else { return Ok(None) };
        let wrong = |expected: String, found: String| TrainError::Config { field: "weights", expected, found };
        let take = |name: &str, shape: &[usize]| {
            let found = tensors.get(name).filter(|t| t.shape() == shape).cloned();
            found.ok_or_else(|| {
                let found = tensors.get(name).map_or("none".into(), |t| format!("{:?}", t.shape()));
                wrong(format!("`{name}` of shape {shape:?}"), found)
            })
        };
        let nodes = |name: &str, n: usize| -> Result<Vec<f64>, TrainError> {
            let nodes = take(name, &[n])?.into_dimensionality::<Ix1>().unwrap_or_default();
            let nodes: Vec<f64> = nodes.iter().map(|&v| f64::from(v)).collect();
            match nodes.windows(2).find(|w| w[0] >= w[1]) {
                Some(w) => Err(wrong(format!("ascending numbers in `{name}`"), format!("{} before {}", w[0], w[1]))),
                None => Ok(nodes),
            }
        };
        let ([lenses, terms], [rows, cols]) = ([feedback.corners.len(), feedback.terms], feedback.nodes);
        let basis = take(BASIS, &[lenses, terms, feedback.window, feedback.window])?;
        let coefficients = take(COEFFICIENTS, &[lenses, terms, rows, cols])?;
        let psf = LowRankPsf {
            basis: basis.into_dimensionality::<Ix4>().unwrap_or_default(),
            coefficients: coefficients.into_dimensionality::<Ix4>().unwrap_or_default().insert_axis(Axis(2)),
            node_depths_um: vec![0.0],
            node_rows_px: nodes(NODES[0], rows)?,
            node_cols_px: nodes(NODES[1], cols)?,
            exposure_ms: 1.0,
        };
        let centre = config.object.map(|n| (n as f64 - 1.0) / 2.0);
        let rays = ChiefRays {
            anchors_px: feedback.corners.iter().map(|c| [0, 1].map(|a| f64::from(c[a]) + centre[a])).collect(),
            magnification: 1.0,
            dead: vec![false; lenses],
        };
        let optics = CalibratedOptics { psf: &psf, rays: &rays, object: config.object, sensor: config.frame };
        let plan = LowRankOperator::plan(optics, &rays, OperatorConfig::exact(0));
        let operator = plan.map_err(|source| wrong("terms of a low-rank operator".into(), source.to_string()))?;
        Ok(Some(Self { operator: Arc::new(operator) }))
    }
}

impl Predictor {
    /// The operator from objects to frames.
    pub fn operator(&self) -> &Arc<LowRankOperator> {
        &self.operator
    }
}

impl Linear for Predictor {
    fn apply(&self, object: &[f32]) -> Vec<f32> {
        let [rows, cols] = self.operator.object_shape();
        let frame = ArrayView2::from_shape((rows, cols), object).ok().and_then(|x| self.operator.apply(x).ok());
        frame.map_or_else(|| unreachable!("networks give objects of their size"), |y| y.into_iter().collect())
    }

    fn adjoint(&self, frame: &[f32]) -> Vec<f32> {
        let [rows, cols] = self.operator.sensor_shape();
        let object = ArrayView2::from_shape((rows, cols), frame).ok().and_then(|y| self.operator.adjoint(y).ok());
        object.map_or_else(|| unreachable!("filters give frames of their size"), |x| x.into_iter().collect())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::{Lenses, Preset, weights};
    use super::*;
    use ndarray::Array2;
    use ommatidia_model::forward::Forward;

    /// With all terms a prediction is, up to its scale, the frame of the instrument.
    #[test]
    fn predictions_are_those_of_the_instrument() {
        let instrument = ommatidia_model::testing::instrument([10, 12], [30, 34], 5, 3);
        let lenses = Lenses::of(&instrument).unwrap();
        let network = lenses.with_feedback(Preset::Nano.network([30, 34], [10, 12]), [2, 0], 99);
        assert_eq!((network.passes(), network.feedback.as_ref().unwrap().terms), (2, 3));
        let tensors = lenses.feedback(network.feedback.as_ref().unwrap());
        let predictor = Predictor::of(&network, &tensors).unwrap().unwrap();
        let object = Array2::from_shape_fn((10, 12), |(r, c)| ((r * 5 + c * 3) % 7) as f32);
        let want = Forward::new(&instrument).unwrap().operator().apply(object.view()).unwrap();
        let got = predictor.apply(object.as_slice().unwrap());
        let scale = want.sum() / got.iter().sum::<f32>();
        let most = want.fold(0.0f32, |m, v| m.max(*v));
        assert!(got.iter().zip(&want).all(|(g, w)| (g * scale - w).abs() < 1e-4 * most));
    }

    #[test]
    fn tensors_that_do_not_fit_are_refused_by_name() {
        let instrument = ommatidia_model::testing::instrument([10, 12], [30, 34], 5, 3);
        let lenses = Lenses::of(&instrument).unwrap();
        let network = lenses.with_feedback(Preset::Nano.network([30, 34], [10, 12]), [2, 0], 2);
        let good = lenses.feedback(network.feedback.as_ref().unwrap());
        let refused = |change: &dyn Fn(&mut Tensors)| {
            let mut tensors = good.clone();
            change(&mut tensors);
            Predictor::of(&network, &tensors).err().unwrap().to_string()
        };
        for name in weights::shapes(&network).into_iter().map(|(name, _)| name).filter(|n| weights::is_calibrated(n)) {
            assert!(refused(&|t| drop(t.remove(&name))).contains(&name));
        }
        assert!(refused(&|t| t.get_mut(NODES[0]).unwrap().fill(1.0)).contains("ascending"));
    }
}
