//! The account as an artifact of kind `closing`.

use super::result::{Account, Closing};
use crate::artifact::{self, ArtifactError, Header, Provenance, Tensors};
use ndarray::{Array3, Ix3};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Kind of the artifact in its header.
pub const KIND: &str = "closing";
/// Version of its layout.
pub const VERSION: u32 = 1;

#[derive(Serialize, Deserialize)]
struct Body {
    closing: Closing,
    frames: Vec<usize>,
}

impl Account {
    /// Writes the artifact, whole or not at all.
    ///
    /// # Errors
    /// See [`artifact::write`].
    pub fn write(&self, path: &Path, provenance: Provenance) -> Result<(), ArtifactError> {
        let mut tensors = Tensors::new();
        for (name, t) in [("measured_dn", &self.measured_dn), ("before", &self.before), ("after", &self.after)] {
            tensors.insert(name.into(), t.clone().into_dyn());
        }
        let body = Body { closing: self.closing.clone(), frames: self.frames.clone() };
        artifact::write(path, &Header { kind: KIND.into(), version: VERSION, provenance, body }, &tensors)
    }

    /// Reads the artifact.
    ///
    /// # Errors
    /// The file is missing or of another kind, or a residual map is missing or has the wrong shape.
    pub fn read(path: &Path) -> Result<Self, ArtifactError> {
        let (header, mut tensors) = artifact::read::<Body>(path, KIND, VERSION)?;
        let shape = [Some(header.body.frames.len()), None, None];
        let mut take = |name: &str| -> Result<Array3<f32>, ArtifactError> {
            let tensor = artifact::take(path, &mut tensors, name, &shape)?;
            let format = |e: ndarray::ShapeError| ArtifactError::Format { path: path.into(), detail: e.to_string() };
            tensor.into_dimensionality::<Ix3>().map_err(format)
        };
        let (measured_dn, before, after) = (take("measured_dn")?, take("before")?, take("after")?);
        Ok(Self { closing: header.body.closing, frames: header.body.frames, measured_dn, before, after })
    }
}
