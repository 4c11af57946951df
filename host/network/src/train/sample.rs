//! Held-out pictures in a checkpoint: for people to look at while a network trains.

use super::checkpoint::{FRAMES, KIND, OBJECTS, SAMPLES, VERSION};
use ndarray::Array2;
use ommatidia_model::metrics::Case;
use ommatidia_session::artifact::{self, ArtifactError};
use std::path::Path;

/// A held-out frame, its object, and its reconstruction by the best weights so far.
#[derive(Clone, Debug)]
pub struct Sample {
    /// The frame and its object.
    pub case: Case,
    /// The reconstruction, scaled to the object.
    pub found: Array2<f32>,
}

impl Sample {
    /// The samples that the checkpoint at `path` keeps. Nothing else of the file is read.
    ///
    /// # Errors
    /// The file is missing, cut short, not a checkpoint, or of another version.
    pub fn of(path: &Path) -> Result<Vec<Self>, ArtifactError> {
        let index = artifact::Index::<serde_json::Value>::open(path, KIND, VERSION)?;
        // Imported weights have no samples, nor have runs before their first validation.
        let count = index.shape(SAMPLES).ok().and_then(|shape| shape.first().copied()).unwrap_or(0);
        let image = |name, i| Ok(index.read_entry(name, i)?.into_dimensionality().unwrap_or_default());
        let sample = |i| {
            Ok(Self {
                case: Case { frame_dn: image(FRAMES, i)?, truth: image(OBJECTS, i)? },
                found: image(SAMPLES, i)?,
            })
        };
        (0..count).map(sample).collect()
    }
}
