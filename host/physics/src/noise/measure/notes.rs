//! Warnings and errors of noise measurements.

use crate::linalg::NotConverged;
use ommatidia_session::{SessionError, with_error};
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
        "the gain is {}, {gain_dn_per_e} DN/e- ({reason}): light in electrons, simulated noise and chi2 scale with it; \
         geometry, PSFs and predictions in DN do not depend on it. {}",
        if *given { "the one that was given" } else { "nominal" },
        measure("flats at several light levels, with two frames or more each", (!given).then_some("--gain"))
    )]
    NominalGain {
        /// The value in use.
        gain_dn_per_e: f64,
        /// Whether the user gave it.
        given: bool,
        /// Why the session does not determine the gain.
        reason: &'static str,
    },
    /// A gain was given, and the flats determine it.
    #[error(
        "the gain that was given, {given_dn_per_e} DN/e-, is not used: the flats of this session show {} DN/e-. Where \
         the flats are wrong, take them out of session.toml",
        with_error(*gain_dn_per_e, *sigma, 4)
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
        "the light of the flats is not proportional to exposure times illumination: it falls short by {:.2} % +- {:.2} \
         % at full scale. The noise of the flats does not show that the sensor bends as much, so that the lamp, the \
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
        "the gain, {} DN/e-, is estimated from differences between the scenes' frames (there are no flats) and assumes \
         a nearly still specimen. Measure flats at several light levels, with two frames or more each, or set --gain",
        with_error(*gain_dn_per_e, *sigma, 3)
    )]
    GainOfVideo {
        /// The value in use.
        gain_dn_per_e: f64,
        /// Its standard error.
        sigma: f64,
    },
    /// No frames that determine the read noise.
    #[error(
        "the read noise is {}, {read_noise_e} e-: simulated noise in dark regions and the weights of faint light \
         depend on it. {}",
        if *given { "the one that was given" } else { "nominal" },
        measure("two dark frames or more", (!given).then_some("--read-noise"))
    )]
    NominalReadNoise {
        /// The value in use.
        read_noise_e: f64,
        /// Whether the user gave it.
        given: bool,
    },
    /// A read noise was given, and darks or flats determine it.
    #[error(
        "the read noise that was given, {given_e} e-, is not used: the {frames} of this session show {} e-. Where the \
         {frames} are wrong, take them out of session.toml",
        with_error(*read_noise_e, *sigma, 3)
    )]
    GivenReadNoise {
        /// The value that was given.
        given_e: f64,
        /// The value in use.
        read_noise_e: f64,
        /// Its standard error.
        sigma: f64,
        /// The frames that show it.
        frames: &'static str,
    },
    /// Read noise measured in DN only.
    #[error(
        "the read noise, {read_noise_dn:.3} DN, is measured; its value in electrons depends on the gain, which is not"
    )]
    ReadNoiseInDn {
        /// Read noise, DN rms.
        read_noise_dn: f64,
    },
}

/// What to measure, or to set where it was not given.
fn measure(what: &str, option: Option<&str>) -> String {
    match option {
        Some(option) => format!("Measure {what}, or set {option}"),
        None => format!("Measure {what}, to know it"),
    }
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
