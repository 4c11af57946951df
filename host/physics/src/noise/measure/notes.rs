//! Warnings and errors of noise measurements.

use crate::linalg::NotConverged;
use ommatidia_session::SessionError;
use thiserror::Error;

/// A value that the session does not determine, and the consequences.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum NoiseNote {
    /// No darks.
    #[error(
        "no dark frames: the black level, {black_level_dn:.2} DN, is the median of the bead frames and includes \
         any stray light; per-pixel offsets are not corrected. Measure dark frames"
    )]
    NoDarks {
        /// The value in use.
        black_level_dn: f64,
    },
    /// Neither darks nor beads.
    #[error(
        "no dark frames and no bead frames: the black level, {black_level_dn:.2} DN, is the {percent} % quantile \
         of the scenes, a guess that includes any light present in every pixel; per-pixel offsets are not \
         corrected. Measure dark frames"
    )]
    GuessedBlack {
        /// The value in use.
        black_level_dn: f64,
        /// The quantile.
        percent: f64,
    },
    /// A single dark frame.
    #[error(
        "only one dark frame at each exposure: read noise and fixed pattern cannot be separated. Measure two dark \
         frames or more"
    )]
    OneDark,
    /// No flats that determine the gain.
    #[error(
        "the gain is nominal, {gain_dn_per_e} DN/e- ({reason}): light in electrons, simulated noise and chi2 \
         scale with it; geometry, PSFs and predictions in DN do not depend on it. Measure flats at several light \
         levels, with two frames or more each, or set --gain"
    )]
    NominalGain {
        /// The value in use.
        gain_dn_per_e: f64,
        /// Why the session does not determine the gain.
        reason: &'static str,
    },
    /// A gain was given, and the flats determine it.
    #[error(
        "the gain that was given, {given_dn_per_e} DN/e-, is not used: the flats of this session show {gain_dn_per_e:.4} \
         +- {sigma:.4} DN/e-. Where the flats are wrong, take them out of session.toml"
    )]
    GivenGain {
        /// The value that was given.
        given_dn_per_e: f64,
        /// The value in use.
        gain_dn_per_e: f64,
        /// Its standard error.
        sigma: f64,
    },
    /// The light of the flats is not proportional to what the table says.
    #[error(
        "the light of the flats is not proportional to exposure times illumination: it falls short by {:.2} % +- {:.2} % \
         at full scale. The noise of the flats does not show that the sensor bends as much, so that the lamp, the \
         illumination in the table or the exposure may be the cause: no correction is made, and `close` may name this \
         as `nonlinearity` or `exposure_offset`. Measure the light of each level, or take flats at one lamp power with \
         several exposures",
        100.0 * bend, 100.0 * sigma
    )]
    Levels {
        /// Shortfall at full scale, relative.
        bend: f64,
        /// Its standard error.
        sigma: f64,
    },
    /// Gain from a video.
    #[error(
        "the gain, {gain_dn_per_e:.3} +- {sigma:.3} DN/e-, is estimated from differences between the scenes' \
         frames (there are no flats) and assumes a nearly still specimen. Measure flats at several light levels, \
         with two frames or more each, or set --gain"
    )]
    GainOfVideo {
        /// The value in use.
        gain_dn_per_e: f64,
        /// Its standard error.
        sigma: f64,
    },
    /// No frames that determine the read noise.
    #[error(
        "the read noise is nominal, {read_noise_e} e-: simulated noise in dark regions and the weights of faint \
         light depend on it. Measure two dark frames or more, or set --read-noise"
    )]
    NominalReadNoise {
        /// The value in use.
        read_noise_e: f64,
    },
    /// Read noise measured in DN only.
    #[error("the read noise, {read_noise_dn:.3} DN, is measured; its value in electrons depends on the nominal gain")]
    ReadNoiseInDn {
        /// Read noise, DN rms.
        read_noise_dn: f64,
    },
}

/// Why the noise of a session cannot be measured.
#[derive(Debug, Error)]
pub enum NoiseError {
    /// The session cannot be read.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// A fit did not converge.
    #[error(transparent)]
    NotConverged(#[from] NotConverged),
    /// A nominal value is impossible.
    #[error("{field}: expected a finite value above zero, found {found}; correct the value")]
    Nominal {
        /// Name of the value.
        field: &'static str,
        /// The value.
        found: f64,
    },
    /// Flats and darks contradict each other.
    #[error(
        "{path}: photon transfer: expected the variance to grow with the light, found a slope of {slope:.4} +- \
         {sigma:.4} DN/e-; check the light levels in the table, and that the flats are raw and unsaturated"
    )]
    Slope {
        /// File of the flats.
        path: std::path::PathBuf,
        /// Fitted slope, DN per electron.
        slope: f64,
        /// Its standard error.
        sigma: f64,
    },
}
