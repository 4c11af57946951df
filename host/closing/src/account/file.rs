//! The account as an artifact of kind `closing`.

use super::result::{Account, Closing, SpecimenMaps};
use ndarray::{Array3, Ix3};
use ommatidia_session::artifact::{self, ArtifactError, Header, Provenance, Tensors};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Kind of the artifact in its header.
pub const KIND: &str = "closing";
/// Version of its layout.
pub const VERSION: u32 = 1;

/// Tensors of the specimens before and after.
const SPECIMENS: [&str; 2] = ["specimen_before", "specimen_after"];

#[derive(Serialize, Deserialize)]
struct Body {
    closing: Closing,
    frames: Vec<usize>,
    /// Frames of the specimens; absent where none was estimated, and in accounts written before there were any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    specimens: Option<Vec<usize>>,
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
        if let Some(SpecimenMaps { before, after, .. }) = &self.specimens {
            for (name, t) in SPECIMENS.into_iter().zip([before, after]) {
                tensors.insert(name.into(), t.clone().into_dyn());
            }
        }
        let specimens = self.specimens.as_ref().map(|maps| maps.frames.clone());
        let body = Body { closing: self.closing.clone(), frames: self.frames.clone(), specimens };
        artifact::write(path, &Header { kind: KIND.into(), version: VERSION, provenance, body }, &tensors)
    }

    /// Reads the artifact.
    ///
    /// # Errors
    /// The file is missing or of another kind, or a map is missing or has the wrong shape.
    pub fn read(path: &Path) -> Result<Self, ArtifactError> {
        let (header, mut tensors) = artifact::read::<Body>(path, KIND, VERSION)?;
        let mut take = |name: &str, frames: usize| -> Result<Array3<f32>, ArtifactError> {
            let tensor = artifact::take(path, &mut tensors, name, &[Some(frames), None, None])?;
            let format = |e: ndarray::ShapeError| ArtifactError::Format { path: path.into(), detail: e.to_string() };
            tensor.into_dimensionality::<Ix3>().map_err(format)
        };
        let Body { closing, frames, specimens } = header.body;
        let [measured_dn, before, after] = ["measured_dn", "before", "after"].map(|name| take(name, frames.len()));
        let specimens = specimens.map(|frames| {
            let [before, after] = SPECIMENS.map(|name| take(name, frames.len()));
            Ok::<_, ArtifactError>(SpecimenMaps { frames, before: before?, after: after? })
        });
        let specimens = specimens.transpose()?;
        Ok(Self { closing, frames, measured_dn: measured_dn?, before: before?, after: after?, specimens })
    }
}
