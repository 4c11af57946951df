//! Why a session cannot be calibrated.

use crate::bead::BeadError;
use crate::check::Finding;
use crate::forward::ForwardError;
use ommatidia_physics::linalg::NotConverged;
use ommatidia_physics::noise::NoiseError;
use ommatidia_session::SessionError;
use thiserror::Error;

/// Why a session cannot be calibrated.
#[derive(Debug, Error)]
pub enum CalibrateError {
    /// The session.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The noise measurement.
    #[error(transparent)]
    Noise(#[from] NoiseError),
    /// The bead scan.
    #[error(transparent)]
    Bead(#[from] BeadError),
    /// The forward model of the calibrated instrument.
    #[error(transparent)]
    Forward(#[from] ForwardError),
    /// A decomposition failed.
    #[error(transparent)]
    NotConverged(#[from] NotConverged),
    /// The session cannot be right.
    #[error("{}", check_text(.0))]
    Check(Vec<Finding>),
    /// The model does not predict what it was not fitted to.
    #[error(
        "off-grid error: expected at most {most:.3} for the noise of this session, found {found:.3}: positions that \
         were left out are not predicted from their neighbours. Check the table of positions, array.pitch_px and \
         optics.psf_window_px (`ommatidia check SESSION`), or scan more positions; --accept calibrates all the same"
    )]
    OffGrid {
        /// Largest error that is believed.
        most: f64,
        /// The error.
        found: f64,
    },
    /// The window has an even side.
    #[error("window: expected an odd number of pixels, found {found}")]
    Window {
        /// The requested value.
        found: usize,
    },
    /// The rank is zero or larger than the number of beads.
    #[error("rank: expected 1 to {most} (the number of bead frames), found {found}")]
    Rank {
        /// Largest rank that the data allow.
        most: usize,
        /// The requested value.
        found: usize,
    },
}

fn check_text(findings: &[Finding]) -> String {
    let lines: Vec<String> = findings.iter().map(|f| format!("{}: {}", f.topic, f.text)).collect();
    format!(
        "{}\nnothing was calibrated; `ommatidia check SESSION` shows more, --accept calibrates all the same",
        lines.join("\n")
    )
}
