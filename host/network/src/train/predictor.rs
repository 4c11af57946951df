//! Predicts the frames of reconstructions, for the passes of a network with feedback.

use super::ops::portable::Terms;
use super::ops::predicted::Linear;
use super::weights::{BASIS, COEFFICIENTS, NODES};
use super::{NetworkConfig, TrainError};
use ndarray::{ArrayView2, Axis, Ix1, Ix4, s};
use ommatidia_model::psf::nodes::Taps;
use ommatidia_model::psf::{CalibratedOptics, ChiefRays, LowRankOperator, LowRankPsf, OperatorConfig};
use ommatidia_session::artifact::Tensors;
use std::sync::{Arc, OnceLock};

/// The short low-rank model of the calibrated PSFs. Clones share one plan.
#[derive(Clone, Debug)]
pub struct Predictor {
    operator: Arc<LowRankOperator>,
    psf: Arc<LowRankPsf>,
    /// Made of `psf` where a device other than the CPU asks for them: their maps are as large as the object.
    terms: Arc<OnceLock<Terms>>,
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
        Ok(Some(Self { operator: Arc::new(operator), psf: Arc::new(psf), terms: Arc::default() }))
    }
}

/// The terms of all lenses, one after the other, with coefficients at each pixel of the object.
fn dense_terms(psf: &LowRankPsf, operator: &LowRankOperator) -> Terms {
    let [rows, cols] = operator.object_shape();
    let corners = operator.corners();
    let (lenses, count, window, _) = psf.basis.dim();
    let [down, across] =
        [(&psf.node_rows_px, rows), (&psf.node_cols_px, cols)].map(|(nodes, n)| Taps::for_pixels(nodes, n));
    let map = |nodes: ArrayView2<'_, f32>| {
        let along: Vec<Vec<f32>> = nodes.outer_iter().map(|row| interpolate(&across, &row.to_vec())).collect();
        let column = |c: usize| interpolate(&down, &along.iter().map(|row| row[c]).collect::<Vec<_>>());
        let columns: Vec<Vec<f32>> = (0..cols).map(column).collect();
        (0..rows).flat_map(|r| columns.iter().map(move |column| column[r])).collect::<Vec<_>>()
    };
    let each = (0..lenses).flat_map(|l| (0..count).map(move |k| (l, k)));
    Terms {
        object: [rows, cols],
        frame: operator.sensor_shape(),
        window,
        corners: each.clone().map(|(l, _)| corners[l].unwrap_or_default()).collect(),
        kernels: psf.basis.iter().copied().collect(),
        maps: each.flat_map(|(l, k)| map(psf.coefficients.slice(s![l, k, 0, .., ..]))).collect(),
        on_device: OnceLock::new(),
    }
}

fn interpolate(taps: &[Taps], values: &[f32]) -> Vec<f32> {
    taps.iter().map(|taps| taps.apply(values)).collect()
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

    fn terms(&self) -> &Terms {
        self.terms.get_or_init(|| dense_terms(&self.psf, &self.operator))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::ops::fourier::Fourier;
    use super::super::ops::portable::{self, testing::alike};
    use super::super::ops::predicted::filter_predicted;
    use super::super::{Lenses, Preset, weights};
    use super::*;
    use burn_tensor::Tensor;
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

    /// What runs on a graphics card gives the values and gradients of what runs on the cores, also where light falls
    /// beside the frame.
    #[test]
    fn the_terms_are_the_operator() {
        let instrument = ommatidia_model::testing::instrument([10, 12], [30, 34], 5, 3);
        let lenses = Lenses::of(&instrument).unwrap();
        let mut network = lenses.with_feedback(Preset::Nano.network([30, 34], [10, 12]), [2, 0], 2);
        let feedback = network.feedback.as_mut().unwrap();
        (feedback.corners[0], *feedback.corners.last_mut().unwrap()) = ([-4, -1], [23, 29]);
        let tensors = lenses.feedback(feedback);
        let predict: Arc<dyn Linear> = Arc::new(Predictor::of(&network, &tensors).unwrap().unwrap());
        let plan = Arc::new(Fourier::new(network.fourier()));
        let filters = network.channels * network.filter_size * (network.filter_size / 2 + 1);
        let parts = |l: &[Tensor<1>]| (l[0].clone().reshape([2, 1, 10, 12]), [l[1].clone(), l[2].clone()]);
        alike(
            &[("x", 240), ("re", filters), ("im", filters)],
            |l| {
                let (x, filters) = parts(l);
                filter_predicted(&plan, &predict, x, filters)
            },
            |l| {
                let (x, filters) = parts(l);
                portable::filter_predicted(&plan, predict.terms(), x, filters)
            },
        );
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
