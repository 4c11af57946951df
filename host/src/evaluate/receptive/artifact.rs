//! The artifact of receptive fields.

use crate::artifact::{self, ArtifactError, Header, Provenance, Tensors};
use ndarray::Array3;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Kind of the artifact.
pub const KIND: &str = "receptive-field";
/// Version of its layout.
pub const VERSION: u32 = 1;

/// Figures of the receptive field of one object pixel.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FieldPoint {
    /// `centre`, `edge`, `corner` or `beyond`.
    pub name: String,
    /// Object pixel, [row, col]; negative beyond the field.
    pub pixel: [i64; 2],
    /// Pearson correlation of the positive part with the PSF of this pixel, over the frame.
    pub pcc: f64,
    /// The same with the PSF of the pixel mirrored through the centre of the field: what any localised pattern would
    /// reach.
    pub pcc_elsewhere: f64,
    /// Share of the positive weight that lies where the PSF exceeds a hundredth of its maximum.
    pub on_foci: f64,
    /// Share of the frame where the PSF exceeds a hundredth of its maximum.
    pub foci_area: f64,
    /// Negative weight relative to all weight, both as magnitudes.
    pub negative: f64,
}

/// Figures of one learned filter.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FilterFigures {
    /// Highest magnitude of the Pearson correlation with a pseudo-inverse.
    pub pcc: f64,
    /// Share of the energy near lags at which foci can lie: within a quarter of the lens pitch of multiples of the
    /// pitch, up to two each way.
    pub on_lattice: f64,
}

/// The header of the artifact: everything but the images.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Name of the network's architecture.
    pub network: String,
    /// Number of frames averaged over.
    pub frames: usize,
    /// Figures of each object pixel.
    pub places: Vec<FieldPoint>,
    /// Figures of each filter; empty for a network without filters.
    pub filters: Vec<FilterFigures>,
    /// Share of the filters' energy that lies in the span of the pseudo-inverses.
    pub in_span: f64,
}

/// Receptive fields beside PSFs, and learned filters beside pseudo-inverses.
#[derive(Clone, Debug)]
pub struct ReceptiveFields {
    /// Figures.
    pub summary: Summary,
    /// Receptive fields, [point, frame rows, frame cols], each divided by its largest magnitude.
    pub fields: Array3<f32>,
    /// PSFs of the points, in the same form.
    pub psfs: Array3<f32>,
    /// Learned filters in space, [filter, T, T], lag 0 in the middle, each divided by its largest magnitude.
    pub filters: Array3<f32>,
    /// Pseudo-inverses of as many calibrated PSFs, in the same form.
    pub inverses: Array3<f32>,
}

const FIELDS: &str = "fields";
const PSFS: &str = "psfs";
const FILTERS: &str = "filters";
const INVERSES: &str = "inverses";

impl ReceptiveFields {
    /// Writes the artifact: whole, or not at all.
    ///
    /// # Errors
    /// See [`artifact::write`].
    pub fn write(&self, path: &Path, provenance: Provenance) -> Result<(), ArtifactError> {
        let stacks = [(FIELDS, &self.fields), (PSFS, &self.psfs), (FILTERS, &self.filters), (INVERSES, &self.inverses)];
        let full = stacks.into_iter().filter(|(_, stack)| !stack.is_empty());
        let tensors: Tensors = full.map(|(name, stack)| (name.into(), stack.clone().into_dyn())).collect();
        let header = Header { kind: KIND.into(), version: VERSION, provenance, body: &self.summary };
        artifact::write(path, &header, &tensors)
    }

    /// Reads the artifact.
    ///
    /// # Errors
    /// The file is missing or another artifact, or a tensor is missing or has the wrong shape.
    pub fn read(path: &Path) -> Result<Self, ArtifactError> {
        let (header, mut tensors) = artifact::read::<Summary>(path, KIND, VERSION)?;
        let summary = header.body;
        let mut take = |name: &str, count: usize| -> Result<Array3<f32>, ArtifactError> {
            if count == 0 {
                return Ok(Array3::zeros((0, 0, 0)));
            }
            let stack = artifact::take(path, &mut tensors, name, &[Some(count), None, None])?;
            Ok(stack.into_dimensionality().unwrap_or_default())
        };
        let (places, filters) = (summary.places.len(), summary.filters.len());
        let (fields, psfs) = (take(FIELDS, places)?, take(PSFS, places)?);
        let (filters, inverses) = (take(FILTERS, filters)?, take(INVERSES, filters)?);
        Ok(Self { summary, fields, psfs, filters, inverses })
    }
}
