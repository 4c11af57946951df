//! What came of closing the loop, as other programs and reports read it.

use super::retrain::Retrained;
use crate::closing::data::Fault;
use crate::closing::evidence::{Dependence, Figures};
use crate::closing::search::NEEDS_CALIBRATION;
use crate::instrument::Instrument;
use ndarray::Array3;
use serde::{Deserialize, Serialize};

/// A fitted value.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Value {
    /// Name of the parameter.
    pub name: String,
    /// Its value.
    pub value: f64,
    /// Its standard error: noise, scatter between blocks and frames, and the calibration's own uncertainty.
    pub sigma: f64,
    /// The part of the standard error that the noise alone makes (Fisher).
    pub sigma_noise: f64,
    /// Its unit.
    pub unit: String,
}

/// An effect that was found and added.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Effect {
    /// Its id in the catalogue, or `unknown-1`, ..
    pub id: String,
    /// Whether the catalogue knows it.
    pub known: bool,
    /// `optics`, `charge`, `electronics` or `record`.
    pub stage: String,
    /// Strength of the evidence, standard deviations.
    pub z: f64,
    /// Share of the excess of chi-squared over the noise on held-out data that it explains; None: the excess is within its error.
    pub excess_explained: Option<f64>,
    /// Fall of chi-squared on held-out data.
    pub held_out_gain: f64,
    /// Effects that would explain the data nearly as well.
    pub ambiguity: Vec<String>,
    /// Square of the correlation of its template with that of the closest of them, nuisances taken out.
    pub overlap: f64,
    /// The measurement that would tell them apart.
    pub separate_by: Option<String>,
    /// Its values.
    pub params: Vec<Value>,
    /// In words and numbers.
    pub description: String,
}

/// An effect that was not found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rejected {
    /// Its id.
    pub id: String,
    /// Its first strength.
    pub param: String,
    /// What that is below with 95 % confidence (its absolute value); None: this session cannot tell.
    pub upper_limit: Option<f64>,
    /// Standard error that it would have had: the sensitivity of the session; None: it cannot tell.
    pub sigma: Option<f64>,
    /// Its unit.
    pub unit: String,
    /// Strength of the evidence for it.
    pub z: f64,
    /// What would be needed, where this session cannot tell.
    pub needs: Option<String>,
}

/// What came of closing the loop.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Closing {
    /// Name of the session.
    pub session: String,
    /// The instrument as it was, on held-out frames; scale and black level fitted.
    pub before: Figures,
    /// With what was added.
    pub after: Figures,
    /// Scenes that no fit has seen, as the session numbers them.
    pub held_out_frames: Vec<usize>,
    /// Spatial blocks of the other frames that no fit has seen, of how many.
    pub held_out_blocks: [usize; 2],
    /// What was added, in order.
    pub effects: Vec<Effect>,
    /// What was not.
    pub rejected: Vec<Rejected>,
    /// Whether the residual still shows structure that no effect of the catalogue explains.
    pub catalogue_incomplete: bool,
    /// Faults of the session's records that were put right before the fit.
    pub faults: Vec<Fault>,
    /// The residual against every covariate, before.
    pub dependences_before: Vec<Dependence>,
    /// The same, after.
    pub dependences_after: Vec<Dependence>,
    /// The network before and after, where it was fine-tuned on the closed instrument.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub retrained: Option<Retrained>,
    /// What the user should know.
    pub notes: Vec<String>,
}

/// The account with its pictures.
#[derive(Clone, Debug)]
pub struct Account {
    /// Figures.
    pub closing: Closing,
    /// Frames that are pictured, as the session numbers them.
    pub frames: Vec<usize>,
    /// Measured, DN, [pictured, sensor rows, sensor cols].
    pub measured_dn: Array3<f32>,
    /// Residual before in standard deviations, the same shape; 0 where a pixel says nothing.
    pub before: Array3<f32>,
    /// Residual after.
    pub after: Array3<f32>,
}

/// An instrument that was closed, with the account of it.
pub struct Closed {
    /// The instrument with what was found.
    pub instrument: Instrument,
    /// The account.
    pub account: Account,
}

impl Closed {
    /// Whether the search ended with the need for a new calibration: no single effect explains how the PSFs vary.
    pub fn needs_calibration(&self) -> bool {
        self.account.closing.effects.iter().any(|e| e.id == NEEDS_CALIBRATION)
    }
}
