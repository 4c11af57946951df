//! The result of closing the loop, as files, reports and other programs read it.

use super::retrain::Retrained;
use crate::data::Fault;
use crate::evidence::{Curve, Dependence, Figures, JudgedOn};
use crate::plan::Plan;
use crate::search::NEEDS_CALIBRATION;
use ndarray::Array3;
use ommatidia_model::instrument::Instrument;
use serde::{Deserialize, Serialize};

/// A fitted value.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Value {
    /// Name of the parameter.
    pub name: String,
    /// Its value.
    pub value: f64,
    /// Its standard error: noise, scatter between blocks and frames, uncertainty of the calibration, and what the law
    /// of the effect leaves with structure.
    pub sigma: f64,
    /// Its standard error by the noise alone (Fisher information).
    pub sigma_noise: f64,
    /// Its unit.
    pub unit: String,
}

/// An effect that was found, or a fault of a record.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Effect {
    /// Its id in the catalogue; `unknown-1`, `unknown-2` and so on for terms without a name.
    pub id: String,
    /// Whether it is an effect of the catalogue.
    pub known: bool,
    /// `optics`, `charge`, `electronics` or `record`.
    pub stage: String,
    /// Whether the closed instrument has it. An effect that the session proves and that does not show in held-out data
    /// is named, and not added.
    #[serde(default = "yes")]
    pub added: bool,
    /// Whether the instrument had it already, with another strength.
    #[serde(default)]
    pub changed: bool,
    /// Strength of the evidence, standard deviations.
    pub z: f64,
    /// Share of the excess of chi-squared over the noise that it explains, on held-out data; None: the excess is not
    /// significant.
    pub excess_explained: Option<f64>,
    /// Fall of the deviance of held-out data when it was added.
    pub held_out_gain: f64,
    /// Effects that would explain the data nearly as well.
    pub ambiguity: Vec<String>,
    /// Squared correlation of its signature with the most similar of these, with everything fitted projected out.
    pub overlap: f64,
    /// The measurement that would distinguish them.
    pub separate_by: Option<String>,
    /// Its parameters.
    pub params: Vec<Value>,
    /// Description with values and errors.
    pub description: String,
}

/// Accounts of earlier versions name only what was added.
fn yes() -> bool {
    true
}

impl Effect {
    /// Says that the closed instrument does not have the effect.
    pub(crate) fn is_not_added(&mut self) {
        self.added = false;
        self.description += "; not added to the instrument, because held-out data are predicted no better with it";
    }

    /// Says that the effect belongs to the truths.
    pub(crate) fn is_of_truths(&mut self) {
        self.added = false;
        self.description += "; a property of the truths of this session, so that the instrument does not get it";
    }
}

/// An effect that was not detected.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rejected {
    /// Its id.
    pub id: String,
    /// Name of its first strength.
    pub param: String,
    /// Upper limit on the absolute value of that strength at 95 % confidence; None: not testable with this session.
    pub upper_limit: Option<f64>,
    /// Sensitivity: the standard error of that strength; None: not testable with this session.
    pub sigma: Option<f64>,
    /// Its unit.
    pub unit: String,
    /// Strength of the evidence for it, standard deviations.
    pub z: f64,
    /// The measurement that would make it testable.
    pub needs: Option<String>,
}

/// Where the truths of a stack, or of one frame, lie beside the objects that they are the truths of
/// ([`crate::fit::truth`]).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TruthRegistration {
    /// Index of the stack in the session.
    pub stack: usize,
    /// Index of the only frame in its stack; None: the whole stack shares it.
    pub frame: Option<usize>,
    /// Standard deviation that the session states, object pixels.
    pub stated_px: f64,
    /// `row_px`, `col_px`, `turn_mrad` and `scale`: a point of the truth at x from the centre is the point x + d(x) of
    /// the object.
    pub params: Vec<Value>,
    /// The same as displacements, object pixels: shift along rows and columns, and what the turn and the scale displace
    /// the corner of the field by.
    pub corner_px: [f64; 4],
}

/// Whether the model, with the effects that were found, describes the session.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// No test sees structure in the residual.
    #[default]
    Adequate,
    /// Something is left that no effect of the catalogue explains.
    Incomplete,
    /// Most of the residual is left: the frames are not of an instrument of this kind in the state that the catalogue
    /// can describe.
    NotThisModel,
}

impl Verdict {
    /// The verdict in a sentence.
    pub fn words(self) -> &'static str {
        match self {
            Self::Adequate => "adequate: what is left is noise, or no more than the calibration itself errs by",
            Self::Incomplete => "incomplete: something is left that no effect of the catalogue explains",
            Self::NotThisModel => {
                "not this model: what is left is no noise of this instrument, and no effect that is known here \
                 explains it"
            }
        }
    }
}

/// An effect whose form is like that of the residual without being shown as its cause.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Nearest {
    /// Its id.
    pub id: String,
    /// Strength of the evidence that something of this form is there, standard deviations.
    pub z: f64,
    /// Why it is not named as a cause.
    pub why: String,
}

/// The result of closing the loop.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Closing {
    /// Name of the session.
    pub session: String,
    /// Figures of the instrument as given, on held-out data; light and black level are fitted to the other data.
    pub before: Figures,
    /// Figures with the added effects.
    pub after: Figures,
    /// Files of the session that the calibration of the instrument has read, by their hashes: what they show is no
    /// independent test of it.
    #[serde(default)]
    pub calibrated_on: Vec<String>,
    /// Whether all frames of the figures are bead frames that the calibration has read.
    #[serde(default)]
    pub own_beads: bool,
    /// What the figures are computed from.
    #[serde(default)]
    pub judged_on: JudgedOn,
    /// Whether the model describes the session now.
    #[serde(default)]
    pub verdict: Verdict,
    /// Effects that are like what was seen, and are not shown as its cause. They are not among `effects`.
    #[serde(default)]
    pub nearest: Vec<Nearest>,
    /// Held-out scenes or beads: indices in their stack.
    pub held_out_frames: Vec<usize>,
    /// Number of held-out spatial blocks of the other frames, and of all blocks.
    pub held_out_blocks: [usize; 2],
    /// Frames whose specimens were estimated: (stack, frame), indices in the session and in the stack.
    #[serde(default)]
    pub estimated_frames: Vec<(usize, usize)>,
    /// Frames of unknown specimens that the session holds.
    #[serde(default)]
    pub recorded_frames: usize,
    /// Strengths of effects in each of the estimated frames, over time.
    #[serde(default)]
    pub curves: Vec<Curve>,
    /// Faults of the records, then the effects that were found, in order.
    pub effects: Vec<Effect>,
    /// Effects that were not detected.
    pub rejected: Vec<Rejected>,
    /// Whether the residual still shows structure that no effect of the catalogue explains.
    pub catalogue_incomplete: bool,
    /// Faults of the session's records, which were corrected before the fit.
    pub faults: Vec<Fault>,
    /// Tests of the residual against every covariate, before.
    pub dependences_before: Vec<Dependence>,
    /// The same with the added effects.
    pub dependences_after: Vec<Dependence>,
    /// Figures of a network before and after its fine-tuning on the closed instrument, if there was one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub retrained: Option<Retrained>,
    /// Places of the truths, where the session states that they are uncertain.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub registrations: Vec<TruthRegistration>,
    /// Which measurements would separate what is ambiguous and make testable what is not, where that was asked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plan: Option<Plan>,
    /// Notes for the user.
    pub notes: Vec<String>,
}

impl Closing {
    /// The figures that `residual` prints as JSON, without a search for effects.
    pub fn residual_figures(&self) -> serde_json::Value {
        serde_json::json!({
            "chi2_ndf": self.before.chi2_ndf, "nrmse": self.before.nrmse, "pcc": self.before.pcc,
            "held_out_frames": self.held_out_frames, "faults": self.faults, "dependences": self.dependences_before,
            "structured": self.catalogue_incomplete, "calibrated_on": self.calibrated_on,
            "own_beads": self.own_beads, "registrations": self.registrations, "notes": self.notes,
            "estimated_frames": self.estimated_frames, "recorded_frames": self.recorded_frames,
        })
    }
}

/// The account: the result with residual maps.
#[derive(Clone, Debug)]
pub struct Account {
    /// The result.
    pub closing: Closing,
    /// Frames of the maps: indices in their stack.
    pub frames: Vec<usize>,
    /// Measured frames, DN, [frames, sensor rows, sensor cols].
    pub measured_dn: Array3<f32>,
    /// Residual before, standard deviations, same shape; 0 at pixels that are not used.
    pub before: Array3<f32>,
    /// Residual after, likewise.
    pub after: Array3<f32>,
    /// Up to four specimens; None where none was estimated.
    pub specimens: Option<SpecimenMaps>,
}

/// Specimens that were estimated from frames whose objects nobody knows, each from its own frame with the PSFs of all
/// lenses: [frames, object rows, object cols], >= 0, in one unit of light before and after.
///
/// They are estimates with a model, not truths: what a change of the specimen imitates, such as a displacement common
/// to all lenses, is in them.
#[derive(Clone, Debug)]
pub struct SpecimenMaps {
    /// Indices of the frames in their stack, which need not be those of the residual maps.
    pub frames: Vec<usize>,
    /// With the instrument as it was.
    pub before: Array3<f32>,
    /// With the effects that were added.
    pub after: Array3<f32>,
}

/// A closed instrument with its account.
pub struct Closed {
    /// The instrument with the added effects.
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
