//! The uncertainty of the calibration: how its replicates change the predicted frames.

use super::model::Model;
use super::refit::{Fitted, Scenes};
use super::specimen::held::Specimens;
use super::state::State;
use ndarray::Array2;
use ommatidia_model::forward::ForwardError;
use ommatidia_model::instrument::Instrument;
use ommatidia_model::psf::LowRankPsf;
use rayon::prelude::*;
use std::sync::{Arc, Mutex, PoisonError};

/// The variance that replicates show, times this, is the mean squared error of a calibration: they show its scatter and
/// not its bias, which is about as large where the rank is well chosen.
pub(crate) const BIAS: f64 = 2.0;

/// The replicates of a calibration, and the light behind their optics for the frames of a session.
pub struct Replicas {
    instruments: Vec<Instrument>,
    /// Computed again when the specimens are estimated again.
    light: Mutex<Light>,
}

#[derive(Clone)]
struct Light {
    /// The specimens that it is the light of.
    specimens: Option<Arc<Specimens>>,
    /// For each replicate.
    scenes: Vec<Scenes>,
}

impl Light {
    fn of(model: &Model<'_>, instruments: &[Instrument], state: &State) -> Result<Self, ForwardError> {
        let one = |other: &Instrument| Ok(Model::new(other, model.seen)?.scenes(state)?.into());
        let scenes = instruments.iter().map(one).collect::<Result<_, ForwardError>>()?;
        Ok(Self { specimens: state.specimens.clone(), scenes })
    }

    fn is_of(&self, state: &State) -> bool {
        match (&self.specimens, &state.specimens) {
            (Some(own), Some(other)) => Arc::ptr_eq(own, other),
            (own, other) => own.is_none() && other.is_none(),
        }
    }
}

impl Replicas {
    /// For each replicate and frame the expected frame minus that of the calibration, as far as the frame can show it,
    /// DN, [sensor rows, sensor cols]. None for frames without an object.
    ///
    /// # Errors
    /// An object holds negative or non-finite light.
    pub fn of(&self, model: &Model<'_>, fitted: &Fitted) -> Result<Vec<Vec<Option<Array2<f32>>>>, ForwardError> {
        let light = {
            let mut light = self.light.lock().unwrap_or_else(PoisonError::into_inner);
            if !light.is_of(&fitted.state) {
                *light = Light::of(model, &self.instruments, &fitted.state)?;
            }
            light.clone()
        };
        // Residuals are not needed, and so no specimen has to be taken out of them.
        let plain = State { specimens: None, ..fitted.state.clone() };
        let one = |scenes: &Scenes| {
            let predicted = model.predict(&plain, scenes);
            let change = |k: usize| scenes[k].as_ref().map(|_| &predicted[k].dn - &fitted.predicted[k].dn);
            (0..predicted.len()).map(change).collect::<Vec<_>>()
        };
        let mut changes: Vec<Vec<Option<Array2<f32>>>> = light.scenes.iter().map(one).collect();
        let mut by_frame: Vec<Vec<&mut Array2<f32>>> = model.seen.frames.iter().map(|_| Vec::new()).collect();
        for of_replicate in &mut changes {
            of_replicate.iter_mut().zip(&mut by_frame).for_each(|(change, frame)| frame.extend(change.as_mut()));
        }
        by_frame.par_iter_mut().enumerate().for_each(|(k, images)| model.visible(k, &fitted.state, images));
        Ok(changes)
    }
}

/// Computes the light behind the optics of each replicate of an instrument's calibration.
///
/// # Errors
/// A replicate does not fit the instrument.
pub fn replicas(model: &Model<'_>, instrument: &Instrument, state: &State) -> Result<Replicas, ForwardError> {
    let bare = Instrument { effects: Vec::new(), replicates: Vec::new(), ..instrument.clone() };
    let other = |psf: &LowRankPsf| Instrument { psf: psf.clone(), ..bare.clone() };
    let instruments: Vec<Instrument> = instrument.replicates.iter().map(other).collect();
    let light = Light::of(model, &instruments, state)?;
    Ok(Replicas { instruments, light: Mutex::new(light) })
}
