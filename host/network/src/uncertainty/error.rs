//! Why intervals cannot be made.

use ommatidia_model::forward::ForwardError;
use ommatidia_physics::effects::EffectError;
use ommatidia_physics::scene::SceneError;
use ommatidia_physics::sensor::FrameError;
use ommatidia_session::artifact::ArtifactError;
use std::path::PathBuf;
use thiserror::Error;

/// Why intervals cannot be calibrated, applied or judged.
#[derive(Debug, Error)]
pub enum UncertaintyError {
    /// A setting is out of range.
    #[error("{field}: expected {expected}, found {found}")]
    Config {
        /// The setting.
        field: &'static str,
        /// What was expected.
        expected: String,
        /// What was found.
        found: String,
    },
    /// The widths belong to another network or instrument.
    #[error(
        "{path}: these widths were calibrated for another {what} than {given} (by their SHA-256); give that {what}, or \
         make widths for this one with `ommatidia uncertainty`"
    )]
    Other {
        /// File of the widths.
        path: PathBuf,
        /// `method file` or `instrument`.
        what: &'static str,
        /// The file that was given.
        given: PathBuf,
        /// First characters of the hash that the widths know.
        expected: String,
        /// First characters of the hash of the file that was given.
        found: String,
    },
    /// The widths belong to another method made from the same file.
    #[error(
        "{path}: these widths were calibrated for the method `{expected}`, not for `{found}`; add --method {expected}, \
         or make widths for `{found}` with `ommatidia uncertainty`"
    )]
    Method {
        /// File of the widths.
        path: PathBuf,
        /// The method of the widths.
        expected: String,
        /// The method that was chosen.
        found: String,
    },
    /// Parts of the file disagree.
    #[error("{path}: {detail}; make the widths again with `ommatidia uncertainty`")]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        detail: String,
    },
    /// The reconstruction has another shape than the object grid of the instrument.
    #[error(
        "expected reconstructions of {} x {} pixels (rows x columns) as the object grid of the instrument, found {} x \
         {}; give the instrument that the network was trained for", expected[0], expected[1], found[0], found[1]
    )]
    Shape {
        /// Rows and columns of the object grid.
        expected: [usize; 2],
        /// Rows and columns of the reconstruction.
        found: [usize; 2],
    },
    /// No light of a specimen reaches the sensor.
    #[error("scene {index}: no light reaches the sensor; calibrate again, or leave out the dead lenses")]
    Black {
        /// The scene.
        index: usize,
    },
    /// The reconstructions hold no light from which widths could be learned.
    #[error("expected reconstructions with light, found none in {scenes} scenes; train the network for longer")]
    Dark {
        /// Number of scenes.
        scenes: usize,
    },
    /// The method cannot reconstruct a scene.
    #[error("scene {index}: {detail}")]
    Reconstruction {
        /// The scene.
        index: usize,
        /// Why.
        detail: String,
    },
    /// The fit of the scale failed.
    #[error(transparent)]
    Fit(#[from] ommatidia_physics::linalg::NotConverged),
    /// The forward model.
    #[error(transparent)]
    Forward(#[from] ForwardError),
    /// An effect.
    #[error(transparent)]
    Effect(#[from] EffectError),
    /// There are no specimens.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The frame does not fit the sensor.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// The file cannot be read or written.
    #[error(transparent)]
    Artifact(#[from] ArtifactError),
}
