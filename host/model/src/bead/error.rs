//! Errors and warnings of a bead scan.

use ommatidia_physics::sensor::MapShapeError;
use ommatidia_session::SessionError;
use std::path::PathBuf;
use thiserror::Error;

/// Why a bead scan cannot be used.
#[derive(Debug, Error)]
pub enum BeadError {
    /// The session.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// Too few frames.
    #[error(
        "{path}: expected at least {expected} bead frames that are not marked as damaged, found {found}; scan \
         more positions"
    )]
    TooFew {
        /// The file.
        path: PathBuf,
        /// Smallest number of frames.
        expected: usize,
        /// Frames of the stack.
        found: usize,
    },
    /// A focus is overexposed.
    #[error(
        "{path}: frame {frame}, focus of lens {lens}: expected at most {allowed} saturated pixels, found {found}; \
         measure the bead again with less light or a shorter exposure"
    )]
    Saturated {
        /// The file.
        path: PathBuf,
        /// Frame.
        frame: usize,
        /// Lens.
        lens: usize,
        /// Largest number of saturated pixels that are masked.
        allowed: usize,
        /// Saturated pixels in the window.
        found: usize,
    },
    /// No lens shows a focus.
    #[error(
        "{path}: no focus found near any chief ray: the brightest of {lenses} lenses has a contrast of {found:.1} \
         robust standard deviations, expected at least {expected}; check that the bead was lit, and \
         array.pitch_px and optics.magnification in session.toml"
    )]
    NoFocus {
        /// The file.
        path: PathBuf,
        /// Number of lenses.
        lenses: usize,
        /// Smallest contrast of a focus, robust standard deviations.
        expected: f64,
        /// Best contrast found.
        found: f64,
    },
    /// A bead frame without light.
    #[error(
        "{path}: frame {frame}: no light in any focus (total {found:.1} DN, noise {sigma:.1} DN); \
         remove the frame and its row, or measure it again"
    )]
    Dark {
        /// The file.
        path: PathBuf,
        /// Frame.
        frame: usize,
        /// Light in all windows, DN.
        found: f64,
        /// Its standard error, DN.
        sigma: f64,
    },
    /// An exposure or an illumination that is zero, negative or not finite.
    #[error(
        "{path}: frame {frame}: expected an exposure and an illumination above zero, found {exposure_ms} ms and \
         {illumination}"
    )]
    NoExposure {
        /// The file.
        path: PathBuf,
        /// Frame.
        frame: usize,
        /// Exposure, ms.
        exposure_ms: f64,
        /// Relative light level.
        illumination: f64,
    },
    /// A sensor map has another shape than the session's sensor.
    #[error(transparent)]
    Maps(#[from] MapShapeError),
    /// One object pixel is not one sensor pixel.
    #[error(
        "session.toml: object.pixel_um: expected sensor.pixel_pitch_um / optics.magnification = {expected:.4} um \
         within 2 %, \
         found {found:.4}; one object pixel must map to one sensor pixel"
    )]
    Grid {
        /// Pixel pitch over magnification, um.
        expected: f64,
        /// What the manifest says, um.
        found: f64,
    },
    /// The fitted magnification is far from the nominal one.
    #[error(
        "{path}: magnification: expected about {expected:.4} (session.toml), fitted from the foci {found:.4}; \
         correct optics.magnification (and object.pixel_um), \
         or the positions in the table"
    )]
    Magnification {
        /// The file.
        path: PathBuf,
        /// Nominal.
        expected: f64,
        /// Fitted.
        found: f64,
    },
}

/// The warning of dead lenses in words.
fn dead_lenses(lenses: &[usize]) -> String {
    if let [lens] = lenses {
        return format!(
            "lens {lens} shows no focus in any bead frame and is marked dead: predictions leave it out; clean or \
             unblock it and measure again"
        );
    }
    let names: Vec<String> = lenses.iter().map(usize::to_string).collect();
    format!(
        "lenses {} show no focus in any bead frame and are marked dead: predictions leave them out; clean or unblock \
         them and measure again, or correct [array] in session.toml (`ommatidia check` says what the foci form)",
        names.join(", ")
    )
}

/// A problem that does not stop the calibration.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum Warning {
    /// Lenses without light.
    #[error("{}", dead_lenses(lenses))]
    DeadLenses {
        /// Lenses, counted row by row from 0.
        lenses: Vec<usize>,
    },
    /// A lens much dimmer than the others.
    #[error("lens {lens} passes {share:.0} % of the light of the median lens: it is used, with more noise")]
    DimLens {
        /// Lens, counted row by row from 0.
        lens: usize,
        /// Light relative to the median lens, percent.
        share: f64,
    },
    /// Single saturated pixels.
    #[error("{pixels} saturated pixels in {frames} bead frames were left out; a shorter exposure avoids this")]
    SaturatedPixels {
        /// Pixels.
        pixels: usize,
        /// Frames.
        frames: usize,
    },
    /// Frames that were cropped and padded.
    #[error(
        "{frames} bead frames were cropped and padded: outside a box all their pixels are equal, and count as not \
         measured"
    )]
    CutOut {
        /// Frames.
        frames: usize,
    },
    /// Windows that extend beyond the sensor.
    #[error(
        "{windows} windows extend beyond the edge of the sensor: the low-rank model of the other windows fills them in"
    )]
    Truncated {
        /// Windows.
        windows: usize,
    },
}
