//! The uncertainty of the calibration: how its replicates change the predicted frames.

use super::model::Model;
use super::refit::Fitted;
use super::scene::Scene;
use super::state::State;
use ndarray::Array2;
use ommatidia_model::forward::ForwardError;
use ommatidia_model::instrument::Instrument;
use ommatidia_model::psf::LowRankPsf;

/// The variance that replicates show, times this, is the mean squared error of a calibration: they show its scatter and
/// not its bias, which is about as large where the rank is well chosen.
pub(crate) const BIAS: f64 = 2.0;

/// The light behind the optics of each replicate of a calibration, for the frames of a session.
pub struct Replicas {
    light: Vec<Vec<Option<Scene>>>,
}

impl Replicas {
    /// For each replicate and frame the expected frame minus that of the calibration, DN, [sensor rows, sensor cols].
    /// None for frames without a known object.
    pub fn of(&self, model: &Model<'_>, fitted: &Fitted) -> Vec<Vec<Option<Array2<f32>>>> {
        let one = |scenes: &Vec<Option<Scene>>| {
            let predicted = model.predict(&fitted.state, scenes);
            let change = |k: usize| scenes[k].as_ref().map(|_| &predicted[k].dn - &fitted.predicted[k].dn);
            (0..predicted.len()).map(change).collect()
        };
        self.light.iter().map(one).collect()
    }
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
