//! What closing the loop is given beside data and instrument, and why it may fail.

use crate::data::{OtherUnit, ScaledFrames};
use ommatidia_model::forward::ForwardError;
use ommatidia_model::instrument::Instrument;
use ommatidia_physics::effects::EffectError;
use thiserror::Error;

/// Why the loop could not be closed.
#[derive(Debug, Error)]
pub enum CloseError {
    /// The forward model failed.
    #[error(transparent)]
    Forward(#[from] ForwardError),
    /// The instrument holds an effect that is not valid.
    #[error(transparent)]
    Effect(#[from] EffectError),
    /// Instrument and session have different layouts.
    #[error(
        "the instrument was calibrated for {expected}, the session has {found}; calibrate on a session of this \
         instrument"
    )]
    Layout {
        /// Layout of the instrument.
        expected: String,
        /// Layout of the session.
        found: String,
    },
    /// The frames do not show the objects.
    #[error(
        "the frames do not show the objects that are recorded for them: {others} of {scenes} scenes resemble the \
         object of another scene more than their own (median correlation with their own {own:.2}). Check which files \
         of frames and objects belong together; without `truth` a session is closed as one of unknown specimens"
    )]
    OtherObjects {
        /// Number of scenes with a known object.
        scenes: usize,
        /// Number of them that resemble another object more.
        others: usize,
        /// Median correlation with their own.
        own: f64,
    },
    /// The frames are turned or mirrored as a whole.
    #[error(
        "the scenes are {how} against those that the instrument was calibrated on: turned back, they correlate by \
         {turned:.3} with what their objects predict, as they are by {own:.3} (median of {scenes} scenes), and turned \
         objects do not explain it. Write the frames in the orientation of the calibration, or calibrate again as the \
         camera is mounted now"
    )]
    Turned {
        /// How the frames are turned.
        how: &'static str,
        /// Number of scenes with a known object.
        scenes: usize,
        /// Median correlation as they are.
        own: f64,
        /// Median correlation after they were turned back.
        turned: f64,
    },
    /// The frames are in another unit than those of the calibration.
    #[error("the frames are in another unit than those of the calibration: {0}")]
    OtherUnit(OtherUnit),
    /// A program has scaled or shifted frames, or taken the black level from them.
    #[error("{0}")]
    Scaled(ScaledFrames),
    /// There is no frame.
    #[error("the session holds no frame to compare with the model: expected scenes, beads, flats or darks")]
    Empty,
}

/// A stack of the session that the calibration of the instrument has read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CalibratedOn {
    /// Index of the stack in the session.
    pub stack: usize,
    /// Its file.
    pub file: String,
}

/// Settings of [`crate::close()`].
#[derive(Clone, Copy, Debug, Default)]
pub struct CloseOptions<'a> {
    /// Name of the session, for the account.
    pub session_name: &'a str,
    /// Seed of all random draws.
    pub seed: u64,
    /// Files of the session that the calibration of the instrument has read (by hashes).
    pub calibrated_on: &'a [CalibratedOn],
    /// Ids of effects that are not tried, for tests of the loop with the true effect missing from the catalogue.
    pub exclude: &'a [String],
    /// Whether the account says which measurements would separate what this session leaves open ([`crate::plan`]).
    pub plan: bool,
    /// An instrument that was calibrated on the training beads of the session, if it predicts the held-out beads better
    /// than the old one ([`super::search::trial_calibration`]). The search compares effects with what it gains.
    pub trial_calibration: Option<&'a Instrument>,
}
