//! The uncertainty of the calibration: how its replicates change the predicted frames.

use super::model::Model;
use super::refit::Fitted;
use super::state::State;
use ndarray::Array2;
use ommatidia_model::forward::{ForwardError, SceneLight};
use ommatidia_model::instrument::Instrument;
use ommatidia_model::psf::LowRankPsf;

/// The light behind the optics of each replicate of a calibration, for the frames of a session.
pub struct Replicas {
    light: Vec<Vec<Option<SceneLight>>>,
}

impl Replicas {
    /// For each replicate and frame the expected frame minus that of the calibration, DN, [sensor rows, sensor cols].
    /// None for frames without a known object.
    pub fn of(&self, model: &Model<'_>, fitted: &Fitted) -> Vec<Vec<Option<Array2<f32>>>> {
        let one = |scenes: &Vec<Option<SceneLight>>| {
            let predicted = model.predict(&fitted.state, scenes);
            let change = |k: usize| scenes[k].as_ref().map(|_| &predicted[k].dn - &fitted.predicted[k].dn);
            (0..predicted.len()).map(change).collect()
        };
        self.light.iter().map(one).collect()
    }
}

/// The excess of chi-squared on held-out data that the errors of the calibration make, as the scatter of its replicates
/// shows them (delete-a-group jackknife). `replicas` are those of [`Replicas::of`].
pub fn excess_by_calibration(model: &Model<'_>, fitted: &Fitted, replicas: &[Vec<Option<Array2<f32>>>]) -> f64 {
    let (seen, n) = (model.seen, replicas.len() as f64);
    let of_frame = |k: usize| -> f64 {
        let changes: Vec<&Array2<f32>> = replicas.iter().filter_map(|r| r[k].as_ref()).collect();
        let weight = &fitted.predicted[k].inverse_sigma;
        let blocks = seen.blocks.iter().zip(&seen.held_out_blocks);
        let spans = blocks.filter(|(_, held_out)| **held_out || seen.frames[k].held_out).map(|(span, _)| span.clone());
        let pixel = |p: &u32| {
            let at = (*p as usize / seen.sensor[1], *p as usize % seen.sensor[1]);
            let mean = changes.iter().map(|d| f64::from(d[at])).sum::<f64>() / n;
            let square: f64 = changes.iter().map(|d| (f64::from(d[at]) - mean).powi(2)).sum();
            square * f64::from(weight[at]).powi(2)
        };
        if changes.len() < 2 { 0.0 } else { spans.flat_map(|s| seen.pixels[s].iter().map(pixel)).sum() }
    };
    (0..seen.frames.len()).map(of_frame).sum::<f64>() * (n - 1.0) / n.max(1.0)
}

/// Computes the light behind the optics of each replicate of an instrument's calibration.
///
/// # Errors
/// A replicate does not fit the instrument.
pub fn replicas(model: &Model<'_>, instrument: &Instrument, state: &State) -> Result<Replicas, ForwardError> {
    let chain = model.chain(&state.terms);
    let light = |psf: &LowRankPsf| {
        let other = Instrument { psf: psf.clone(), effects: Vec::new(), replicates: Vec::new(), ..instrument.clone() };
        Model::new(&other, model.seen)?.scenes(&chain)
    };
    Ok(Replicas { light: instrument.replicates.iter().map(light).collect::<Result<_, _>>()? })
}
