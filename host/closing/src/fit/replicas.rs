//! The uncertainty of the calibration: how its replicates, and light that its windows do not hold, change the predicted
//! frames.

use super::errors::Errors;
use super::model::Model;
use super::projection::Specimens;
use super::refit::Fitted;
use super::scenes::Scenes;
use super::state::{Predicted, State};
use super::wings::{rings, spread};
use crate::data::{Frame, Shown};
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
    /// Rings round the windows that may hold light.
    wings: Vec<(usize, usize, f64)>,
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
        let one = |other: &Instrument| {
            let own = Model::new(other, model.seen)?;
            let scenes = own.scenes(state)?;
            // The model of the instrument predicts with them.
            scenes.iter().flatten().for_each(|scene| own.forward.make_all_planes(scene));
            Ok(scenes)
        };
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
    /// The errors of the calibration in the frames of a session: by the scatter of its replicates (delete-a-group
    /// jackknife, with their bias), and by light outside its windows.
    ///
    /// # Errors
    /// An object holds negative or non-finite light.
    pub fn of(&self, model: &Model<'_>, fitted: &Fitted) -> Result<Errors, ForwardError> {
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
        let scattered = changes.len();
        standardised(&mut changes);
        changes.extend(self.wings.iter().map(|ring| wing(model, &fitted.predicted, *ring)));
        let of_frames = changes.iter_mut().flat_map(|of| of.iter_mut().enumerate());
        model.visible(&fitted.state, of_frames.filter_map(|(k, change)| Some((k, change.as_mut()?))));
        Ok(Errors { changes, scattered })
    }
}

/// Makes the changes of replicates deviations from their mean whose squares sum to the covariance.
fn standardised(changes: &mut [Vec<Option<Array2<f32>>>]) {
    let n = changes.len() as f32;
    let factor = (BIAS as f32 * (n - 1.0).max(0.0) / n).sqrt();
    for k in 0..changes.first().map_or(0, Vec::len) {
        let mut mean: Option<Array2<f32>> = None;
        for change in changes.iter().filter_map(|c| c[k].as_ref()) {
            match &mut mean {
                Some(mean) => mean.scaled_add(1.0 / n, change),
                None => mean = Some(change / n),
            }
        }
        let Some(mean) = mean else { continue };
        for change in changes.iter_mut().filter_map(|c| c[k].as_mut()) {
            change.zip_mut_with(&mean, |v, m| *v = factor * (*v - m));
        }
    }
}

/// The light of a ring round each focus, DN, for each frame of a specimen or bead.
fn wing(
    model: &Model<'_>,
    predicted: &[Predicted],
    (inner, outer, share): (usize, usize, f64),
) -> Vec<Option<Array2<f32>>> {
    let dn = (share * model.forward.noise().gain_dn_per_e) as f32;
    let shows = |k: usize| errs(model, &model.seen.frames[k]);
    let one = |k: usize| shows(k).then(|| spread(&predicted[k].sum_e, inner, outer) * dn);
    (0..predicted.len()).into_par_iter().map(one).collect()
}

/// Whether light outside the windows is an error of the calibration in a frame: where it is fitted it is none.
fn errs(model: &Model<'_>, f: &Frame) -> bool {
    match f.shown {
        Shown::Object(_) => model.rings.is_empty(),
        Shown::Estimated | Shown::Bead(_) => true,
        _ => false,
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
    let wings = match model.seen.frames.iter().any(|f| errs(model, f)) {
        true => rings(model.window_px / 2, instrument.quality.outside_window),
        false => Vec::new(),
    };
    Ok(Replicas { instruments, wings, light: Mutex::new(light) })
}
